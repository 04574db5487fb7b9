"""Action maps: the actions of a policy at positions and headings all over a world."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import Scene
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.simulation.simulator import batch_simulator
from tb2rl.worlds import World

HEADINGS = 16  # number of headings at each position
UNVISITED, ENDED = -1, -2  # values of `ActionMap.actions` that are not indices
_NUM_POSITIONS = 900  # approximate number of positions on a map


@dataclass(frozen=True)
class ActionMap:
    """The greedy actions of a policy in a world."""

    world: World
    side: float  # [m] side of the square that is drawn around each position
    positions: np.ndarray  # x, y [m], shape (positions, 2)
    # Index into `Actions.names`, shape (headings, positions); `UNVISITED` where training never visited the state,
    # `ENDED` where an episode ends at once.
    actions: np.ndarray
    visited_share: float = 1.0  # share of the map's states, without ENDED, that training visited; 1: no Q-table


def action_map(policy: BaseAlgorithm, scene: Scene) -> ActionMap | None:
    """The greedy actions of a robot at rest, at positions and headings in the free space of the scene's first world.

    The kinematic simulator computes the observations, without laser noise and dynamic obstacles. Returns None if
    this simulator lacks one of the task's sensors.
    """
    simulator_type = batch_simulator()
    try:
        scene.check(simulator_type)
    except InputError:
        return None
    q_table: Any = policy.policy  # a Q-table only if it has `visits`
    scene = scene.in_worlds(scene.spec.worlds, laser_noise=0.0)  # the same worlds, without laser noise
    positions, side = _square_centres(scene.world, scene.robot.radius)
    simulator = simulator_type.open(scene.spec.without_dynamic_obstacles(), len(positions))
    actions_by_heading, states_by_heading = [], []
    for heading in range(HEADINGS):
        random = GeneratorSource(np.random.default_rng(0), len(positions))
        initial_state = scene.task.initial_state(scene.spec.for_world(0), random)
        initial_state.pose[:, :2], initial_state.pose[:, 2] = positions, heading * math.tau / HEADINGS
        robot_state = simulator.reset(initial_state, np.random.default_rng(0))
        observations = scene.observation_pipeline().reset(robot_state)
        greedy_actions = np.array(policy.predict(observations, deterministic=True)[0])
        has_ended = scene.task.outcome(robot_state, np.zeros_like(greedy_actions), robot_state).terminated
        actions_by_heading.append(np.where(has_ended, ENDED, scene.actions.kinds(greedy_actions)))
        if hasattr(q_table, "visits"):
            states_by_heading.append(q_table.states(observations))
    actions, visited_share = np.stack(actions_by_heading), 1.0
    if states_by_heading:
        states, is_running = np.stack(states_by_heading), actions != ENDED  # both of shape (headings, positions)
        is_visited = q_table.visits.numpy().any(axis=1)  # by state
        actions[is_running & ~is_visited[states]] = UNVISITED
        running_states = np.unique(states[is_running])
        visited_share = float(is_visited[running_states].mean()) if len(running_states) else 0.0
    return ActionMap(scene.world, side, positions, actions, visited_share)


def _square_centres(world: World, clearance: float) -> tuple[np.ndarray, float]:
    """The centres of squares in the free space, shape (positions, 2), and the side of a square [m]."""
    free_space = world.free_space(clearance)
    side = math.sqrt(free_space.area / _NUM_POSITIONS)
    x0, y0, x1, y1 = world.bounds
    x, y = np.meshgrid(np.arange(x0 + side / 2, x1, side), np.arange(y0 + side / 2, y1, side))
    centres = np.column_stack([x.ravel(), y.ravel()])
    free_centres = centres[shapely.contains_xy(free_space, centres)]
    # If the free space is narrower than a square, it may contain no centre.
    return (free_centres if len(free_centres) else np.array(free_space.representative_point().coords)), side
