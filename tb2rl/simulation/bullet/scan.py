"""The laser of one robot, cast exactly, with its errors; the kinematic simulator does the same for thousands."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.robots import Laser
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.outlines import cast_at_obstacles
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_beams, limit_ranges


class Scanner:
    """A laser that measures the walls of a world, and dynamic obstacles.

    Args:
        laser: Its beams and its range.
    """

    def __init__(self, laser: Laser) -> None:
        self._laser = laser
        self._beams = np.cos(laser.angles), np.sin(laser.angles)
        self._scratch = np.empty(len(laser.angles)), np.empty(len(laser.angles))

    def scan(
        self,
        pose: tuple[float, float, float],
        world: World,
        initial_state: InitialState,
        rng: np.random.Generator,
        obstacles: np.ndarray | None = None,
    ) -> tuple[np.ndarray, bool]:
        """Ranges [m], shape (1, beams), and whether the shortest one is to a dynamic obstacle.

        Args:
            pose: Of the robot: x [m], y [m], yaw [rad].
            world: Its world.
            initial_state: Of its episode, with the errors of the laser.
            rng: Source of noise and dropped beams.
            obstacles: Records, shape (1, obstacles), see `ObstacleArrays`.
        """
        (x, y, yaw), row = pose, initial_state.rows[0]
        if row["mount_x"] or row["mount_y"]:
            ahead, aside, cos, sin = float(row["mount_x"]), float(row["mount_y"]), math.cos(yaw), math.sin(yaw)
            x, y = x + ahead * cos - aside * sin, y + ahead * sin + aside * cos
        yaw, ranges = yaw + float(row["mount_yaw"]), np.empty((1, len(self._laser.angles)))
        cast_beams(x, y, yaw, self._beams, world.index, 0, self._scratch, ranges, 0)
        nearest_is_dynamic = obstacles is not None and cast_at_obstacles(x, y, yaw, self._beams, obstacles, 0, ranges)
        noise = self._laser.noise if row["laser_noise"] < 0.0 else row["laser_noise"]
        if noise:
            ranges += noise * rng.standard_normal(ranges.shape)
        if row["bias"]:
            ranges += row["bias"]
        limit_ranges(ranges, 0, self._laser.min_range, self._laser.max_range)
        if row["dropped"]:
            ranges[rng.random(ranges.shape) < row["dropped"]] = np.inf
        return ranges, nearest_is_dynamic
