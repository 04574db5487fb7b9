"""What a policy does: its actions by name, and which of them it takes at each place of a maze."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.config import Config
from tb2rl.maze import Maze, box_shape
from tb2rl.observations import prepare
from tb2rl.robot import BASE_RADIUS
from tb2rl.simulation.kinematic import KinematicSimulation

HEADINGS = 16
UNMET, OVER = -1, -2  # in place of an action
_PLACES = 900  # on a map, about


@dataclass(frozen=True)
class ActionMap:
    """What a policy does at places all over a maze.

    Attributes:
        maze: Which one.
        side: Of the square around each place [m].
        places: x, y [m], shape (places, 2).
        actions: At each heading and place, shape (headings, places); `UNMET` where training never met the state,
            `OVER` where an episode ends at once.
        known: Share of the states of a table, of those that the other poses lead to, that training met.
    """

    maze: Maze
    side: float
    places: np.ndarray
    actions: np.ndarray
    known: float = 1.0

    @property
    def walls(self) -> list[list[tuple[float, ...]]]:
        """The corners of each box of the maze [m]."""
        return [list(box_shape(row).exterior.coords) for row in self.maze.boxes]


def action_map(policy: BaseAlgorithm, config: Config) -> ActionMap:
    """What the greedy policy does, at rest, at places all over the free space and at headings all around."""
    maze, task, observe, laser = prepare(replace(config.task_settings, noise=0.0), config.observation)
    places, side = _places(maze)
    headings = np.arange(HEADINGS) * math.tau / HEADINGS
    poses = np.column_stack([np.tile(places, (HEADINGS, 1)), np.repeat(headings, len(places))])
    reading = KinematicSimulation(maze, laser, len(poses)).reset(poses, np.random.default_rng(0))
    observations = observe(reading)
    actions = np.array(policy.predict(observations, deterministic=True)[0])
    over, known = task.judge(reading, np.zeros_like(actions), reading).terminated, 1.0
    table: Any = policy.policy
    if hasattr(table, "visits"):
        states, met = table.states(observations), table.visits.numpy().any(axis=1)
        actions[~met[states]] = UNMET
        known = float(met[np.unique(states[~over])].mean()) if not over.all() else 0.0
    actions[over] = OVER
    return ActionMap(maze, side, places, actions.reshape(HEADINGS, -1), known)


def _places(maze: Maze) -> tuple[np.ndarray, float]:
    """The middles of a grid's squares that lie in the free space, and the side of a square [m]."""
    free = maze.free_space(BASE_RADIUS)
    side = math.sqrt(free.area / _PLACES)
    x0, y0, x1, y1 = maze.bounds
    x, y = np.meshgrid(np.arange(x0 + side / 2, x1, side), np.arange(y0 + side / 2, y1, side))
    places = np.column_stack([x.ravel(), y.ravel()])
    inside = places[shapely.contains_xy(free, *places.T)]
    if not len(inside):  # narrower than a square
        inside = np.array([free.representative_point().coords[0]])
    return inside, side


def action_names(commands: np.ndarray) -> list[str]:
    """A short name of each action from its v [m/s] and w [rad/s], shape (actions, 2); with both where two are alike."""
    short = [_direction(v, w) for v, w in commands]
    full = [f"{name} at {v:g} m/s, {w:g} rad/s" for name, (v, w) in zip(short, commands, strict=True)]
    return [full[i] if short.count(name) > 1 else name for i, name in enumerate(short)]


def _direction(v: float, w: float) -> str:
    if w == 0.0:
        return "forward" if v > 0.0 else "backward" if v < 0.0 else "stand"
    side = "left" if w > 0.0 else "right"
    return f"back {side}" if v < 0.0 else side
