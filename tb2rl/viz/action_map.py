"""Action maps: the kind of action that a policy takes at positions all over a world."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import Scene
from tb2rl.simulation import batch_simulator
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.worlds import World
from tb2rl.worlds.world import box_polygons

HEADINGS = 16
UNVISITED, ENDED = -1, -2  # in place of an action
_POSITIONS = 900  # on a map, about


@dataclass(frozen=True)
class ActionMap:
    """The greedy actions of a policy in a world.

    Attributes:
        world: The world.
        side: Of the square around each position [m].
        positions: x, y [m], shape (positions, 2).
        actions: Kind of action (an index into `Actions.names`) by heading and position, shape (headings, positions);
            `UNVISITED` where training never visited the state, `ENDED` where an episode ends at once.
        visited: Share of the states on the map that training visited, for a policy with a table; else 1.
    """

    world: World
    side: float
    positions: np.ndarray
    actions: np.ndarray
    visited: float = 1.0

    @property
    def walls(self) -> list[list[tuple[float, ...]]]:
        """The corners of each box of the world [m]."""
        return [list(box.exterior.coords) for box in box_polygons(self.world.boxes)]


def action_map(policy: BaseAlgorithm, scene: Scene) -> ActionMap | None:
    """The greedy actions of a robot at rest, at positions all over the free space and at headings all around.

    The map is of the first world, without laser noise and dynamic obstacles. The kinematic simulator computes all
    positions at once; None if it lacks one of the sensors.
    """
    simulator_type = batch_simulator()
    try:
        scene.check(simulator_type)
    except InputError:
        return None
    table: Any = policy.policy
    scene = scene.changed(laser_noise=0.0)
    positions, side = _grid(scene.world, scene.robot.radius)
    simulator = simulator_type.open(scene.spec.without_dynamic_obstacles(), len(positions))
    actions, states = [], []
    for heading in range(HEADINGS):
        draws = GeneratorDraws(np.random.default_rng(0), len(positions))
        initial_state = scene.task.initial_state(scene.spec.within(0), draws)
        initial_state.pose[:, :2], initial_state.pose[:, 2] = positions, heading * math.tau / HEADINGS
        robot_state = simulator.reset(initial_state, np.random.default_rng(0))
        observations = scene.observation_pipeline().reset(robot_state)
        greedy = np.array(policy.predict(observations, deterministic=True)[0])
        ended = scene.task.outcome(robot_state, np.zeros_like(greedy), robot_state).terminated
        actions.append(np.where(ended, ENDED, scene.actions.kinds(greedy)))
        if hasattr(table, "visits"):
            states.append(table.states(observations))
    shown, visited = np.stack(actions), 1.0
    if states:
        rows = np.stack(states)  # of the table, shape (headings, positions)
        is_visited, is_running = table.visits.numpy().any(axis=1), shown != ENDED
        shown[is_running & ~is_visited[rows]] = UNVISITED
        visited = float(is_visited[np.unique(rows[is_running])].mean()) if is_running.any() else 0.0
    return ActionMap(scene.world, side, positions, shown, visited)


def _grid(world: World, clearance: float) -> tuple[np.ndarray, float]:
    """The centres of squares in the free space, shape (positions, 2), and their side [m]."""
    free = world.free_space(clearance)
    side = math.sqrt(free.area / _POSITIONS)
    x0, y0, x1, y1 = world.bounds
    x, y = np.meshgrid(np.arange(x0 + side / 2, x1, side), np.arange(y0 + side / 2, y1, side))
    centres = np.column_stack([x.ravel(), y.ravel()])
    inside = centres[shapely.contains_xy(free, *centres.T)]
    if not len(inside):  # the free space is narrower than a square
        inside = np.array([free.representative_point().coords[0]])
    return inside, side
