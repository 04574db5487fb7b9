"""Records of dynamic obstacles: what compiled code reads and writes of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tb2rl.simulation.obstacles.outlines import OUTLINE_FIELDS

FIELDS = (
    *OUTLINE_FIELDS,
    "vx", "vy",  # [m/s]
    "target_x", "target_y",  # [m], unless on a path
    "speed",  # [m/s] wanted
    "patience",  # [s] until another target is chosen
    "next", "stride",  # number of the path's next point; 1, or -1 on the way back
    "force_x", "force_y",  # [m/s^2] on a person
    "room",  # [m] that a person can walk before walls matter
    # The rest is constant:
    "kind", "first", "count", "closed",  # first point among those of all paths, number of points, whether it is a loop
    "avoids",  # whether a person walks around the robot
    "min_speed", "max_speed",  # [m/s]
)  # fmt: skip
OBSTACLE = np.dtype([(name, np.float64) for name in FIELDS])
EMPTY, PATH, STRAIGHT, PERSON = range(4)  # kinds


class ObstacleArrays(NamedTuple):
    """The dynamic obstacles of all environments.

    Attributes:
        obstacles: Records, shape (num_envs, obstacles).
        streams: Key of each environment's random numbers and how many were drawn, shape (num_envs, 2), uint64.
        path_points: Points of all paths [m], shape (points, 2).
    """

    obstacles: np.ndarray
    streams: np.ndarray
    path_points: np.ndarray
