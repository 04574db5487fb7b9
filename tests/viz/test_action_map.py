"""The map shows the action that a policy takes at each place, and where an episode is over or training never was."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch as th

from tb2rl.envs.make import make_env
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.config import config_from
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.viz.action_map import HEADINGS, OVER, UNMET, action_map
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles
from tb2rl.worlds.registry import find_world


def test_the_map_shows_what_the_policy_does_where_training_met_the_state(seeds):
    policy = load(seeds / "seed-0")
    actions = action_map(policy, policy.trained_with.scene)
    free = find_world("loop").free_space(0.0)
    assert 700 < len(actions.places) < 1100
    assert actions.actions.shape == (HEADINGS, len(actions.places))
    assert all(free.contains(shapely.Point(place)) for place in actions.places)
    assert set(np.unique(actions.actions)) == {OVER, UNMET, 0, 1, 2}
    assert 0.0 < actions.known < 1.0
    policy.policy.visits[:] = 1
    policy.policy.q[:] = 0.0
    policy.policy.q[:, 2] = 1.0
    learned = action_map(policy, policy.trained_with.scene)
    assert (learned.actions == np.where(actions.actions == OVER, OVER, 2)).all()
    assert learned.known == 1.0


def test_known_is_a_share_of_the_states_that_the_robot_can_go_on_from():
    task = {
        "name": "maze",
        "beam_indices": [3],
        "collision_range": 0.8,
    }  # one beam, four classes: 0.7, 1.0, 1.7 m between
    config = config_from({"agent": {"name": "qlearn"}, "task": task})
    policy = make_algorithm(config, Spaces.vectorised(config))
    assert action_map(policy, config.scene).known == 0.0
    policy.policy.visits[:2, 1] = 1
    shown = action_map(policy, config.scene)
    assert shown.known == pytest.approx(1 / 3), "of classes 1, 2 and 3 it met 1; in class 0 an episode is over"
    assert (shown.actions >= 0).sum() < 0.1 * (shown.actions != OVER).sum(), "which few poses lead to"


def test_the_map_is_of_the_world_without_what_moves_there():
    config = resolve("qlearn", settings={"task.range_bins": [1, 3, 5], "task.beams": 5})  # classes of what is far away
    policy, scene = make_algorithm(config, Spaces.vectorised(config)), config.scene
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(np.random.default_rng(0).random(policy.policy.q.shape))
    shown = action_map(policy, scene).actions
    world = replace(scene.world, dynamic_obstacles=find_dynamic_obstacles({"posts": 9}, "dynamic_obstacles"))
    crowded = replace(scene, spec=replace(scene.spec, worlds=(world, *scene.spec.worlds[1:])))
    for other in (crowded, scene.changed(dynamic_obstacles={"people": 9})):
        np.testing.assert_array_equal(action_map(policy, other).actions, shown)


def test_what_pybullet_alone_can_show_has_no_map():
    colours = {"task.observe": [{"camera": {"colour": True}}]}
    config = resolve("stable_baselines3:DQN", "maze", settings={"agent.buffer_size": 9, **colours})
    assert action_map(make_algorithm(config, Spaces.vectorised(config)), config.scene) is None


def test_the_map_shows_the_action_that_the_policy_takes_there(seeds):
    policy, rng = load(seeds / "seed-0"), np.random.default_rng(0)
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(rng.random(policy.policy.q.shape))
    shown = action_map(policy, policy.trained_with.scene)
    with closing(make_env(policy)) as env:
        for heading, place in rng.permutation(np.argwhere(shown.actions != OVER))[:30]:
            observation, _ = env.reset(options={"pose": pose_of(shown, heading, place)})
            assert policy.predict(observation, deterministic=True)[0] == shown.actions[heading, place]


def pose_of(shown, heading: int, place: int) -> tuple[float, float, float]:
    return (*shown.places[place], heading * math.tau / len(shown.actions))


def test_the_map_shows_a_network_at_a_task_with_a_goal(goal_run):
    policy = load(goal_run)
    shown = set(np.unique(action_map(policy, policy.trained_with.scene).actions))
    assert OVER in shown
    assert {OVER} < shown <= {OVER, 0, 1, 2}


def test_the_map_shows_the_kind_of_velocities_that_a_policy_takes_there(cruise):
    config = resolve("stable_baselines3:SAC", cruise)
    policy = make_algorithm(config, Spaces.vectorised(config))
    shown = action_map(policy, config.scene)
    names = config.scene.actions.names
    below = shown.places[:, 1] <= 0.0
    assert (shown.actions[:, ~below] == OVER).all(), "the upper half counts as failed"
    assert (shown.actions[:, below] >= 0).all()
    assert shown.known == 1.0
    with closing(make_env(cruise, "raw")) as env:
        for heading, place in np.random.default_rng(0).permutation(np.argwhere(shown.actions != OVER))[:30]:
            observation, _ = env.reset(options={"pose": pose_of(shown, heading, place)})
            action, _ = policy.predict(observation, deterministic=True)
            v, w = config.scene.actions.commands(action[None])[0]
            expected = "left" if w > 0.25 else "right" if w < -0.25 else "forward" if v > 0.125 else "stand"
            assert names[shown.actions[heading, place]] == expected


@pytest.mark.parametrize("task", ["maze", pytest.param("wall", marks=pytest.mark.slow)])
def test_the_map_is_empty_just_where_an_episode_ends_at_once(task, seeds, goal_run):
    policy = load({"maze": seeds / "seed-0", "wall": goal_run}[task])
    shown = action_map(policy, policy.trained_with.scene)
    over = []
    with closing(make_env(policy)) as env:
        goal = env.scene.goal or (math.inf, math.inf)
        for heading, place in np.ndindex(shown.actions.shape):
            _, info = env.reset(options={"pose": pose_of(shown, heading, place)})
            at_goal = np.abs(shown.places[place] - goal).max() <= getattr(env.task, "goal_tolerance", 0.0)
            over.append(info["min_range"] < env.task.collision_range or at_goal)
    assert 0 < sum(over) < len(over)
    assert ((shown.actions == OVER).ravel() == over).all()


SLIT = """
boxes: [{centre: [0, 0.58925], size: [10, 0.8215]}, {centre: [0, -0.58925], size: [10, 0.8215]}]
start: [0, 0, 0]
bounds: [-5, -1.002, 5, 1]
"""  # 1 mm wider than the robot, and between two rows of squares


def test_a_world_that_is_narrower_than_a_square_of_the_map_has_one_place(tmp_path):
    (tmp_path / "slit.yaml").write_text(SLIT)
    settings = {"task.world": str(tmp_path / "slit.yaml"), "task.start_clearance": 0.178, "task.collision_range": 0.0}
    config = resolve("qlearn", settings=settings)
    shown = action_map(make_algorithm(config, Spaces.vectorised(config)), config.scene)
    assert shown.actions.shape == (HEADINGS, 1)
    assert abs(shown.places[0, 1]) <= 0.0005
    assert len(shown.walls) == 2
