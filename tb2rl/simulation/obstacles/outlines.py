"""Outlines of dynamic obstacles, circles and turned boxes: what the laser measures of them, and their distances.

A table of dynamic obstacles has a row for each obstacle of each environment. Its first columns are the outline, which
pictures, PyBullet's bodies and robot states show. Compiled code reads the rows as records. A row of length 0 is empty.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.worlds.grid import PARALLEL

OUTLINE_FIELDS = (
    "x", "y",  # [m]
    "cos", "sin",  # of the heading
    "length", "width",  # half those of a box [m]; of a circle its radius, and 0
)  # fmt: skip
X, Y, COS, SIN, LENGTH, WIDTH = range(6)
OUTLINE = slice(0, 6)
_RECORD = np.dtype([(name, np.float64) for name in OUTLINE_FIELDS])
_TINY = 1e-9  # [m]


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def gap_to(east, north, obstacle):
    """Distance from a point, relative to an obstacle's centre [m], to its outline [m]; below 0 inside a circle."""
    if obstacle.width == 0.0:
        return math.sqrt(east * east + north * north) - obstacle.length
    along = max(abs(obstacle.cos * east + obstacle.sin * north) - obstacle.length, 0.0)
    across = max(abs(obstacle.cos * north - obstacle.sin * east) - obstacle.width, 0.0)
    return math.sqrt(along * along + across * across)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def outer_radius(obstacle):
    """Radius of the circle around an obstacle [m], however it turns."""
    return math.sqrt(obstacle.length**2 + obstacle.width**2)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def nearest_gap(x, y, obstacles, i):
    """Distance from a point to the nearest obstacle of environment `i` [m]; inf if there is none."""
    nearest = np.inf
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.length > 0.0:
            nearest = min(nearest, gap_to(x - obstacle.x, y - obstacle.y, obstacle))
    return nearest


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def cast_at_obstacles(x, y, yaw, beams, obstacles, i, ranges):
    """Shorten the ranges of a laser where a dynamic obstacle is nearer than the walls.

    Args:
        x, y, yaw: Pose of the laser [m, m, rad].
        beams: Cosines and sines of the beam directions in the laser's frame, each of shape (beams,).
        obstacles: Records, shape (num_envs, obstacles).
        i: Environment.
        ranges: To the walls [m], shape (num_envs, beams); row `i` is changed in place.

    Returns:
        Whether the shortest range is that to a dynamic obstacle.
    """
    cos_beams, sin_beams = beams
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    to_wall, to_obstacle = np.inf, np.inf
    for beam in range(cos_beams.size):
        to_wall = min(to_wall, ranges[i, beam])
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        length, width, cos, sin = obstacle.length, obstacle.width, obstacle.cos, obstacle.sin
        if length == 0.0:
            continue
        east, north = x - obstacle.x, y - obstacle.y
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
                to_obstacle = min(to_obstacle, hit)
                ranges[i, beam] = min(ranges[i, beam], hit)
    return to_obstacle < to_wall


def cast_at_outlines(poses: np.ndarray, beams: tuple[np.ndarray, np.ndarray], outlines: np.ndarray, ranges: np.ndarray):
    """`cast_at_obstacles` for poses (num_envs, 3), outlines (num_envs, obstacles, 6) and ranges (num_envs, beams)."""
    _cast_all(poses, beams, as_records(outlines, _RECORD), ranges)


@njit(cache=True)
def _cast_all(poses, beams, obstacles, ranges):
    for i in range(poses.shape[0]):
        cast_at_obstacles(poses[i, 0], poses[i, 1], poses[i, 2], beams, obstacles, i, ranges)


def as_records(table: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """View the rows along the last axis of a table of floats as records."""
    return table.view(dtype)[..., 0]


def directions_to_nearest(points: np.ndarray, outlines: np.ndarray) -> np.ndarray:
    """Direction from each point to the nearest dynamic obstacle of its environment.

    Args:
        points: x, y [m], shape (num_envs, 2).
        outlines: Shape (num_envs, obstacles, 6).

    Returns:
        Unit vectors, shape (num_envs, 2).
    """
    cos, sin, size = outlines[..., COS], outlines[..., SIN], outlines[..., [LENGTH, WIDTH]]
    east, north = np.moveaxis(points[:, None] - outlines[..., [X, Y]], -1, 0)
    relative = np.stack([cos * east + sin * north, cos * north - sin * east], axis=-1)  # in the obstacle's frame
    is_box = outlines[..., [WIDTH]] > 0.0
    offset = np.where(is_box, np.clip(relative, -size, size), 0.0) - relative  # to the nearest point, or the centre
    length = np.hypot(*np.moveaxis(offset, -1, 0))
    gap = length - np.where(is_box[..., 0], 0.0, outlines[..., LENGTH])
    nearest = np.arange(len(points)), np.where(outlines[..., LENGTH] > 0.0, gap, np.inf).argmin(axis=1)
    along, across = (offset[nearest] / np.maximum(length[nearest], _TINY)[:, None]).T
    cos, sin = cos[nearest], sin[nearest]
    return np.stack([cos * along - sin * across, sin * along + cos * across], axis=1)
