"""The map shows the action that a policy takes at each position, and where an episode ends or training never was."""

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch as th

from tb2rl.envs.make import make_env
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.config import config_from, resolve
from tb2rl.runs.loading import load
from tb2rl.viz.action_map import ENDED, HEADINGS, UNVISITED, action_map
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles
from tb2rl.worlds.registry import find_world


def poses(shown, count: int):
    """Some headings and positions of a map, with their poses."""
    for heading, position in np.random.default_rng(0).permutation(list(np.ndindex(shown.actions.shape)))[:count]:
        yield heading, position, (*shown.positions[position], heading * math.tau / HEADINGS)


def test_the_map_shows_the_action_where_training_visited_the_state(seeds):
    policy = load(seeds / "seed-0")
    actions = action_map(policy, policy.trained_with.scene)
    free = find_world("loop").free_space(0.0)
    assert 700 < len(actions.positions) < 1100
    assert actions.actions.shape == (HEADINGS, len(actions.positions))
    assert shapely.contains_xy(free, *actions.positions.T).all()
    assert set(np.unique(actions.actions)) == {ENDED, UNVISITED, 0, 1, 2}
    assert 0.0 < actions.visited_share < 1.0
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(np.random.default_rng(0).random(policy.policy.q.shape))
    shown = action_map(policy, policy.trained_with.scene)
    assert shown.visited_share == 1.0
    with closing(make_env(policy)) as env:
        for heading, position, pose in poses(shown, 60):
            observation, info = env.reset(options={"pose": pose})
            ended = info["min_range"] < env.task.collision_range
            action = ENDED if ended else policy.predict(observation, deterministic=True)[0]
            assert shown.actions[heading, position] == action


def test_the_visited_share_counts_the_states_that_an_episode_can_leave():
    # One beam and four bins, with borders at 0.7, 1.0 and 1.7 m.
    task = {"name": "maze", "beam_indices": [3], "collision_range": 0.8}
    config = config_from({"agent": {"name": "qlearn"}, "task": task})
    policy = make_algorithm(config)
    assert action_map(policy, config.scene).visited_share == 0.0
    policy.policy.visits[:2, 1] = 1
    shown = action_map(policy, config.scene)
    assert shown.visited_share == pytest.approx(1 / 3), (
        "of bins 1, 2 and 3 it visited 1; in bin 0 the episode has ended"
    )
    assert (shown.actions >= 0).sum() < 0.1 * (shown.actions != ENDED).sum()


def test_the_map_ignores_dynamic_obstacles():
    config = resolve("qlearn", settings={"task.range_bins": [1, 3, 5], "task.beams": 5})
    policy, scene = make_algorithm(config), config.scene
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(np.random.default_rng(0).random(policy.policy.q.shape))
    world = replace(scene.world, dynamic_obstacles=parse_dynamic_obstacles({"posts": 9}, "dynamic_obstacles"))
    crowded = replace(scene, spec=replace(scene.spec, worlds=(world, *scene.spec.worlds[1:])))
    for other in (crowded, scene.in_worlds(scene.spec.worlds, dynamic_obstacles={"people": 9})):
        np.testing.assert_array_equal(action_map(policy, other).actions, action_map(policy, scene).actions)


def test_a_sensor_that_the_kinematic_simulator_lacks_leaves_no_map(make):
    assert action_map(None, make.config(observe=[{"camera": {"colour": True}}], observation="raw").scene) is None


def test_the_map_shows_a_network_at_a_task_with_a_goal(goal_run):
    policy = load(goal_run)
    shown = action_map(policy, policy.trained_with.scene)
    assert {ENDED} < set(np.unique(shown.actions)) <= {ENDED, 0, 1, 2}
    at_goal = np.abs(shown.positions - policy.trained_with.scene.goal_in(0)).max(axis=1) <= 0.1
    assert (shown.actions[:, at_goal] == ENDED).all()


def test_the_map_shows_the_kind_of_velocities(cruise):
    config = resolve("stable_baselines3:SAC", cruise)
    policy = make_algorithm(config)
    shown = action_map(policy, config.scene)
    below = shown.positions[:, 1] <= 0.0
    assert (shown.actions[:, ~below] == ENDED).all(), "the upper half counts as failed"
    assert (shown.actions[:, below] >= 0).all()
    with closing(make_env(cruise, "raw")) as env:
        for heading, position, pose in poses(shown, 30):
            observation, _ = env.reset(options={"pose": pose})
            v, w = config.scene.actions.commands(policy.predict(observation, deterministic=True)[0][None])[0]
            expected = "left" if w > 0.25 else "right" if w < -0.25 else "forward" if v > 0.125 else "stand"
            assert not below[position] or config.scene.actions.names[shown.actions[heading, position]] == expected
