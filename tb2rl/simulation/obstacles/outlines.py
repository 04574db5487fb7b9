"""The table of dynamic obstacles, and distances and laser ranges to their outlines (circles and oriented boxes).

The table has a row for each obstacle of each environment. The first columns are the outline, which pictures, PyBullet's
bodies and robot states also use. Compiled code reads the rows as records. A row whose `length` is 0 is empty.
"""

import math
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.worlds.geometry import chord_interval, slab_interval

FIELDS = (
    # The outline:
    "x", "y",  # [m]
    "cos", "sin",  # of the heading
    "length", "width",  # [m] half length and half width of a box; radius of a circle, and 0
    # The motion:
    "vx", "vy",  # [m/s]
    "target_x", "target_y",  # [m] target of an obstacle without a path
    "speed",  # [m/s] target speed
    "patience",  # [s] time until another target is chosen
    "next",  # number of the next point on the path
    "force_x", "force_y",  # [m/s^2] social force on a person
    "room",  # [m] distance that a person can walk before walls matter
    # Constants of an episode:
    "kind",  # `EMPTY`, `PATH`, `TO_TARGETS` or `PERSON`
    "first", "count",  # first point of the path in `ObstacleArrays.path_points`, and number of its points
    "avoids_robot",  # whether a person avoids the robot
    "min_speed", "max_speed",  # [m/s] range of the random target speed
)  # fmt: skip
X, Y, COS, SIN, LENGTH, WIDTH = range(6)
OUTLINE = slice(0, 6)
OBSTACLE_TYPE, _OUTLINE_TYPE = (np.dtype([(name, np.float64) for name in FIELDS[:end]]) for end in (None, OUTLINE.stop))
EMPTY, PATH, TO_TARGETS, PERSON = range(4)  # values of "kind": no obstacle, and three kinds of motion
_MIN_DISTANCE = 1e-9  # [m] avoids a division by 0


class ObstacleArrays(NamedTuple):
    """Dynamic obstacles of all environments, for compiled code."""

    obstacles: np.ndarray  # records of type `OBSTACLE_TYPE`, shape (num_envs, obstacles)
    streams: np.ndarray  # random stream of each environment: its key, and count of draws; shape (num_envs, 2), uint64
    path_points: np.ndarray  # [m] x, y of the points of all paths, which are loops; shape (points, 2)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def distance_to_outline(dx, dy, obstacle):
    """Distance [m] to an outline from a point at dx, dy [m] from its centre; inside, negative (circle) or 0 (box)."""
    if obstacle.width == 0.0:
        return math.sqrt(dx * dx + dy * dy) - obstacle.length
    outside_x = max(abs(obstacle.cos * dx + obstacle.sin * dy) - obstacle.length, 0.0)
    outside_y = max(abs(obstacle.cos * dy - obstacle.sin * dx) - obstacle.width, 0.0)
    return math.sqrt(outside_x * outside_x + outside_y * outside_y)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def outer_radius(obstacle):
    """Radius of the circle around an obstacle [m], which contains it in any orientation."""
    return math.sqrt(obstacle.length**2 + obstacle.width**2)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def distance_to_nearest(x, y, obstacles, i):
    """Distance from a point to the nearest obstacle of environment `i` [m]; inf without obstacles."""
    nearest = np.inf
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.length > 0.0:
            nearest = min(nearest, distance_to_outline(x - obstacle.x, y - obstacle.y, obstacle))
    return nearest


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def cast_at_obstacles(x, y, yaw, beams, obstacles, i, ranges):
    """Shorten the ranges of a laser where a dynamic obstacle is nearer than the walls.

    Args:
        x, y, yaw: Pose of the laser [m, m, rad].
        beams: Cosines and sines of the beam directions in the laser's frame, each of shape (beams,).
        obstacles: Records that begin with the outline, shape (num_envs, obstacles).
        i: Environment.
        ranges: Ranges to the walls [m], shape (num_envs, beams); row `i` is changed in place.

    Returns:
        Whether the shortest range is a range to a dynamic obstacle.
    """
    cos_beams, sin_beams = beams
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    nearest_wall, nearest_obstacle = np.inf, np.inf
    for beam in range(cos_beams.size):
        nearest_wall = min(nearest_wall, ranges[i, beam])
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        length, width, cos, sin = obstacle.length, obstacle.width, obstacle.cos, obstacle.sin
        if length == 0.0:
            continue
        # Obstacle's position relative to the laser, and laser's direction, in a frame along the obstacle's sides.
        dx, dy = obstacle.x - x, obstacle.y - y
        relative_x, relative_y = cos * dx + sin * dy, cos * dy - sin * dx
        laser_cos, laser_sin = cos_yaw * cos + sin_yaw * sin, sin_yaw * cos - cos_yaw * sin
        for beam in range(cos_beams.size):
            ray_x = laser_cos * cos_beams[beam] - laser_sin * sin_beams[beam]
            ray_y = laser_sin * cos_beams[beam] + laser_cos * sin_beams[beam]
            if width == 0.0:
                enter, leave = chord_interval(relative_x, relative_y, ray_x, ray_y, length)
            else:
                enter, leave = slab_interval(relative_x, relative_y, ray_x, ray_y, length, width)
            hit = max(enter, 0.0)
            if leave >= hit:
                nearest_obstacle = min(nearest_obstacle, hit)
                ranges[i, beam] = min(ranges[i, beam], hit)
    return nearest_obstacle < nearest_wall


def cast_at_outlines(poses: np.ndarray, beams: tuple[np.ndarray, np.ndarray], outlines: np.ndarray, ranges: np.ndarray):
    """`cast_at_obstacles` for poses (num_envs, 3), outlines (num_envs, obstacles, 6) and ranges (num_envs, beams)."""
    _cast_all(poses, beams, as_records(outlines, _OUTLINE_TYPE), ranges)


@njit(cache=True)
def _cast_all(poses, beams, obstacles, ranges):
    for i in range(poses.shape[0]):
        cast_at_obstacles(poses[i, 0], poses[i, 1], poses[i, 2], beams, obstacles, i, ranges)


def as_records(table: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """View the rows of a table of floats, along its last axis, as records."""
    return table.view(dtype)[..., 0]


def directions_to_nearest(poses: np.ndarray, outlines: np.ndarray) -> np.ndarray:
    """Directions (num_envs, 2) in the world's frame, from poses to the nearest of outlines (num_envs, obstacles, 6)."""
    cos, sin, half_sizes = outlines[..., COS], outlines[..., SIN], outlines[..., [LENGTH, WIDTH]]
    dx, dy = np.moveaxis(poses[:, None, :2] - outlines[..., [X, Y]], -1, 0)
    position = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)  # in the obstacle's frame
    is_box = outlines[..., [WIDTH]] > 0.0
    # Vector to the nearest point of a box, or to the centre of a circle.
    offset = np.where(is_box, np.clip(position, -half_sizes, half_sizes), 0.0) - position
    norm = np.hypot(*np.moveaxis(offset, -1, 0))
    distance = norm - np.where(is_box[..., 0], 0.0, outlines[..., LENGTH])
    nearest = np.arange(len(poses)), np.where(outlines[..., LENGTH] > 0.0, distance, np.inf).argmin(axis=1)
    x, y = (offset[nearest] / np.maximum(norm[nearest], _MIN_DISTANCE)[:, None]).T
    cos, sin = cos[nearest], sin[nearest]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
