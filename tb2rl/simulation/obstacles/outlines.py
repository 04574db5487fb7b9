"""The outlines of what moves: circles and turned rectangles, what the laser sees of them, and how far they are off.

A table of movers has a block for each robot and a row for each of its movers, shape (num_envs, movers, n). The first
six
columns are their outlines, which pictures, bodies and readings show; a row without a size is of no mover.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.worlds.grid import PARALLEL

X, Y, COS, SIN = range(4)  # [m, m] and the direction that a box looks in
LENGTH, WIDTH = 4, 5  # [m] half of a box's; of what is round its radius, and 0
OUTLINE = slice(0, 6)
_TINY = 1e-9  # [m]


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def gap_to(east, north, dynamic_obstacles, i, k):
    """Distance of a point from mover `k` of robot `i` [m]; below 0 inside a round one.

    `east`, `north` [m] are where the point is, seen from the middle of the mover.
    """
    if dynamic_obstacles[i, k, WIDTH] == 0.0:
        return math.sqrt(east * east + north * north) - dynamic_obstacles[i, k, LENGTH]
    cos, sin = dynamic_obstacles[i, k, COS], dynamic_obstacles[i, k, SIN]
    along = max(abs(cos * east + sin * north) - dynamic_obstacles[i, k, LENGTH], 0.0)
    across = max(abs(cos * north - sin * east) - dynamic_obstacles[i, k, WIDTH], 0.0)
    return math.sqrt(along * along + across * across)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def reach_of(dynamic_obstacles, i, k):
    """Radius of the circle [m] in which mover `k` of robot `i` is, wherever it turns."""
    return math.sqrt(dynamic_obstacles[i, k, LENGTH] ** 2 + dynamic_obstacles[i, k, WIDTH] ** 2)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def nearest_mover(x, y, dynamic_obstacles, i):
    """Distance of a point [m] from the nearest mover of robot `i`; inf where there is none."""
    nearest = np.inf
    for k in range(dynamic_obstacles.shape[1]):
        if dynamic_obstacles[i, k, LENGTH] > 0.0:
            nearest = min(
                nearest, gap_to(x - dynamic_obstacles[i, k, X], y - dynamic_obstacles[i, k, Y], dynamic_obstacles, i, k)
            )
    return nearest


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def cast_at_movers(x, y, yaw, cos_beams, sin_beams, dynamic_obstacles, i, ranges, robot):
    """Shorten the ranges [m] of a laser at a pose where the movers of robot `i` are nearer than the walls.

    Args:
        x, y, yaw: Pose of the laser [m, m, rad].
        cos_beams, sin_beams: Beam directions in the laser's frame, shape (beams,).
        dynamic_obstacles: The table.
        i: Whose movers.
        ranges: What the walls leave [m], shape (num_envs, beams); changed in place.
        robot: Index of its row.

    Returns:
        Whether the shortest range is that to a mover.
    """
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    to_wall, direction_to_obstacle = np.inf, np.inf
    for beam in range(cos_beams.size):
        to_wall = min(to_wall, ranges[robot, beam])
    for k in range(dynamic_obstacles.shape[1]):
        length, width = dynamic_obstacles[i, k, LENGTH], dynamic_obstacles[i, k, WIDTH]
        if length == 0.0:
            continue
        east, north, cos, sin = (
            x - dynamic_obstacles[i, k, X],
            y - dynamic_obstacles[i, k, Y],
            dynamic_obstacles[i, k, COS],
            dynamic_obstacles[i, k, SIN],
        )
        ox, oy = cos * east + sin * north, cos * north - sin * east
        c, s = cos_yaw * cos + sin_yaw * sin, sin_yaw * cos - cos_yaw * sin
        for beam in range(cos_beams.size):
            dx, dy = c * cos_beams[beam] - s * sin_beams[beam], s * cos_beams[beam] + c * sin_beams[beam]
            if width == 0.0:
                along, across = -(ox * dx + oy * dy), ox * dy - oy * dx
                half_chord = length * length - across * across
                if half_chord < 0.0:
                    continue
                near, far = along - math.sqrt(half_chord), along + math.sqrt(half_chord)
            else:
                over_x = 1.0 / (dx if abs(dx) > PARALLEL else PARALLEL)
                over_y = 1.0 / (dy if abs(dy) > PARALLEL else PARALLEL)
                near = max(-ox * over_x - length * abs(over_x), -oy * over_y - width * abs(over_y))
                far = min(-ox * over_x + length * abs(over_x), -oy * over_y + width * abs(over_y))
            hit = max(near, 0.0)
            if far >= hit:
                direction_to_obstacle = min(direction_to_obstacle, hit)
                ranges[robot, beam] = min(ranges[robot, beam], hit)
    return direction_to_obstacle < to_wall


@njit(cache=True)
def cast_all_at_movers(poses, cos_beams, sin_beams, dynamic_obstacles, ranges):
    """`cast_at_movers` for all robots: poses (num_envs, 3), ranges (num_envs, beams)."""
    for i in range(poses.shape[0]):
        cast_at_movers(poses[i, 0], poses[i, 1], poses[i, 2], cos_beams, sin_beams, dynamic_obstacles, i, ranges, i)


def directions_to_nearest(points: np.ndarray, dynamic_obstacles: np.ndarray) -> np.ndarray:
    """Which way from each point the nearest of its movers is.

    Args:
        points: x, y [m], shape (num_envs, 2).
        dynamic_obstacles: Their outlines, shape (num_envs, movers, 6).

    Returns:
        Unit vectors, shape (num_envs, 2).
    """
    cos, sin, size = dynamic_obstacles[..., COS], dynamic_obstacles[..., SIN], dynamic_obstacles[..., [LENGTH, WIDTH]]
    east, north = np.moveaxis(points[:, None] - dynamic_obstacles[..., [X, Y]], -1, 0)
    seen = np.stack([cos * east + sin * north, cos * north - sin * east], axis=-1)  # from the middle of the mover
    is_box = dynamic_obstacles[..., [WIDTH]] > 0.0
    off = np.where(is_box, np.clip(seen, -size, size), 0.0) - seen  # to a box's nearest point, or a circle's middle
    length = np.hypot(*np.moveaxis(off, -1, 0))
    gap = np.where(
        dynamic_obstacles[..., LENGTH] > 0.0,
        length - np.where(is_box[..., 0], 0.0, dynamic_obstacles[..., LENGTH]),
        np.inf,
    )
    nearest = np.arange(len(points)), gap.argmin(axis=1)
    along, across = (off[nearest] / np.maximum(length[nearest], _TINY)[:, None]).T
    return np.stack(
        [cos[nearest] * along - sin[nearest] * across, sin[nearest] * along + cos[nearest] * across], axis=1
    )
