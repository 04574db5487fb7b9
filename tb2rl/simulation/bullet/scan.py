"""The laser of one robot, cast exactly, with its flaws; the twin's kernel does the same for thousands."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.robots import Laser
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.outlines import cast_at_movers
from tb2rl.simulation.spec import BIAS, DROPPED, MOUNT, NOISE
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_one, limit_ranges


class Scanner:
    """A laser that reads the walls of a world, and what moves there.

    Args:
        laser: Its beams and how far they reach.
    """

    def __init__(self, laser: Laser) -> None:
        self._laser = laser
        self._directions = np.cos(laser.angles), np.sin(laser.angles)
        self._scratch = tuple(np.empty((2, len(laser.angles))))

    def scan(
        self,
        pose: tuple[float, float, float],
        world: World,
        initial_state: InitialState,
        rng: np.random.Generator,
        dynamic_obstacles: np.ndarray | None = None,
    ) -> tuple[np.ndarray, bool]:
        """Ranges [m], shape (1, beams), and whether the shortest one is to something that moves.

        Args:
            pose: Of the robot: x [m], y [m], yaw [rad].
            world: What it is in.
            start: How its episode began: with which flaws.
            rng: Where noise and dropped beams come from.
            dynamic_obstacles: What moves, see `RobotState.dynamic_obstacles`.
        """
        x, y, yaw = pose
        flaws = initial_state.table[0]
        ahead, aside, turned = flaws[MOUNT].tolist()
        if ahead or aside:
            cos, sin = math.cos(yaw), math.sin(yaw)
            x, y = x + ahead * cos - aside * sin, y + ahead * sin + aside * cos
        ranges = np.empty((1, len(self._laser.angles)))
        cast_one(x, y, yaw + turned, *self._directions, *world.index, 0, *self._scratch, ranges, 0)
        nearest_is_dynamic = dynamic_obstacles is not None and cast_at_movers(
            x, y, yaw + turned, *self._directions, dynamic_obstacles, 0, ranges, 0
        )
        noise = self._laser.noise if flaws[NOISE] < 0.0 else flaws[NOISE]
        if noise:
            ranges += noise * rng.standard_normal(ranges.shape)
        if flaws[BIAS]:
            ranges += flaws[BIAS]
        limit_ranges(ranges, 0, self._laser.min_range, self._laser.max_range)
        if flaws[DROPPED]:
            ranges[rng.random(ranges.shape) < flaws[DROPPED]] = np.inf
        return ranges, nearest_is_dynamic
