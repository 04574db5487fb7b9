"""The wall follower drives any robot along walls without a collision, by named actions or velocities."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from tb2rl import evaluate, make_env
from tb2rl.agents.wallfollower import WallFollower
from tb2rl.core.plugins import robot_names
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve


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
    envs = [
        make_env("wall", "raw", simulation="kinematic", start="fixed", frame_stack=frame_stack)
        for frame_stack in (1, 3)
    ]
    rules = [WallFollower(env.observation_space, env.action_space) for env in envs]
    seen = [env.reset(seed=0)[0] for env in envs]
    actions = set()
    for _ in range(200):
        one, other = (int(rule.predict(at)[0]) for rule, at in zip(rules, seen, strict=True))
        assert one == other
        actions.add(one)
        steps = [env.step(one) for env in envs]
        seen = [step[0] for step in steps]
        np.testing.assert_array_equal(seen[0], seen[1][-len(seen[0]) :])
        if steps[0][2] or steps[0][3]:
            break
    assert len(actions) > 1


def test_it_avoids_collisions_with_named_actions_and_with_velocities():
    speeds = []
    for task in ("maze", "drive"):
        config = resolve("wallfollower", task)
        summary = evaluate(make_baseline(config), config, episodes=3, steps=200, workers=1).summary()
        assert summary["failure_free_rate"] == 1.0
        speeds.append(summary["mean_speed"])
    assert speeds[1] == pytest.approx(speeds[0], rel=0.1)
    assert speeds[1] > 0.3
