"""The wall follower drives any robot along walls without a collision, by named actions or velocities."""

from contextlib import closing

import numpy as np
import pytest

from tb2rl import evaluate, make_env
from tb2rl.agents.wallfollower import WallFollower
from tb2rl.core.plugins import robot_names
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve


@pytest.mark.parametrize("robot", robot_names())
def test_it_drives_any_robot_without_a_collision(robot):
    config = resolve("wallfollower", settings={"task.robot": robot})
    policy, max_speed = make_baseline(config), config.scene.actions.max_speed
    with closing(TurtleBot2Env(config.scene, simulation="kinematic")) as env:
        observation, _ = env.reset(seed=3)
        for _ in range(250):
            observation, _, _, _, info = env.step(policy.predict(observation, deterministic=True)[0])
            assert info["ended"] == ""
    assert info["distance"] > 0.7 * max_speed * 250 * config.task.control_period


def test_it_drives_by_the_latest_of_stacked_frames():
    rules = []
    for frame_stack in (1, 3):
        with closing(make_env("wall", "raw", simulation="kinematic", frame_stack=frame_stack)) as env:
            rules.append(WallFollower(env.observation_space, env.action_space))
    before, now = np.random.default_rng(0).uniform(0.3, 3.0, (2, 200, *rules[0].observation_space.shape))
    actions = rules[0].predict(now)[0]
    np.testing.assert_array_equal(rules[1].predict(np.concatenate([before, before, now], axis=1))[0], actions)
    assert len(np.unique(actions)) > 1


def test_it_avoids_collisions_with_named_actions_and_with_velocities():
    speeds = []
    for task in ("maze", "drive"):
        config = resolve("wallfollower", task)
        summary = evaluate(make_baseline(config), config, episodes=2, steps=150, workers=1).summary()
        assert summary["failure_free_rate"] == 1.0
        speeds.append(summary["mean_speed"])
    assert speeds[1] == pytest.approx(speeds[0], rel=0.1)
    assert speeds[1] > 0.3
