"""Exact laser ranges against the boxes and posts of a world, compiled.

Slab test against oriented boxes (Kay & Kajiya 1986) and the quadratic for circles; the inner loops over beams have no
branches, so that the compiler vectorizes them. All simulators share this laser. Worlds with many obstacles use a grid
(`tb2rl.worlds.grid`).
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.worlds.grid import PARALLEL, clearance_in_grid, first_hit, gap_to_post, squared_gap_to_box
from tb2rl.worlds.index import BOXES, BOXES_END, COLUMNS, POSTS, POSTS_END, WorldIndex, index_of

_FAST = {"nsz", "nnan", "arcp", "contract", "reassoc"}  # for loops over beams


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def cast_beams(x, y, yaw, beams, index, world, scratch, ranges, row):
    """Write the distance to the nearest obstacle along each beam into one row of `ranges`; inf without an obstacle.

    Args:
        x, y, yaw: Pose of the laser [m, m, rad].
        beams: Cosines and sines of the beam directions in the laser's frame, each of shape (beams,).
        index: `WorldIndex` of all worlds.
        world: Number of the world in it.
        scratch: Two arrays of shape (beams,); allocating them here would cost as much as the work.
        ranges: Result [m], shape (num_envs, beams).
        row: A view of the row instead would be reference-counted, which makes threads wait for each other.
    """
    if index.parts[world, COLUMNS] == 0.0:
        _cast_at_all(x, y, yaw, beams, index, world, scratch, ranges, row)
        return
    cos_beams, sin_beams = beams
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    for i in range(cos_beams.size):
        dx = cos_yaw * cos_beams[i] - sin_yaw * sin_beams[i]
        dy = sin_yaw * cos_beams[i] + cos_yaw * sin_beams[i]
        ranges[row, i] = first_hit(x, y, dx, dy, index, world)


@njit(cache=True, **UNCOUNTED, fastmath=_FAST, error_model="numpy", forceinline=True)
def _cast_at_all(x, y, yaw, beams, index, world, scratch, ranges, row):
    """Test each obstacle of a world against all beams; see `cast_beams`."""
    (cos_beams, sin_beams), (over_x, over_y) = beams, scratch
    boxes, posts, parts, _ = index
    first_box, last_box = int(parts[world, BOXES]), int(parts[world, BOXES_END])
    first_post, last_post = int(parts[world, POSTS]), int(parts[world, POSTS_END])
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    count = cos_beams.size
    for i in range(count):
        ranges[row, i] = np.inf
    # Inverse beam directions in the frame of a box: divisions dominate the cost, and boxes share orientations.
    for k in range(first_box, last_box):
        half_length, half_width, cos_box, sin_box = boxes[k, 2], boxes[k, 3], boxes[k, 4], boxes[k, 5]
        if k == first_box or cos_box != boxes[k - 1, 4] or sin_box != boxes[k - 1, 5]:
            c = cos_yaw * cos_box + sin_yaw * sin_box
            s = sin_yaw * cos_box - cos_yaw * sin_box
            for i in range(count):
                dx = c * cos_beams[i] - s * sin_beams[i]
                dy = s * cos_beams[i] + c * sin_beams[i]
                over_x[i] = 1.0 / (dx if abs(dx) > PARALLEL else PARALLEL)
                over_y[i] = 1.0 / (dy if abs(dy) > PARALLEL else PARALLEL)
        east, north = x - boxes[k, 0], y - boxes[k, 1]
        ox, oy = cos_box * east + sin_box * north, cos_box * north - sin_box * east
        for i in range(count):
            mid_x, mid_y = -ox * over_x[i], -oy * over_y[i]
            reach_x, reach_y = half_length * abs(over_x[i]), half_width * abs(over_y[i])
            near = max(mid_x - reach_x, mid_y - reach_y)
            far = min(mid_x + reach_x, mid_y + reach_y)
            hit = max(near, 0.0)
            nearer = (far >= hit) & (hit < ranges[row, i])
            ranges[row, i] = hit if nearer else ranges[row, i]
    for k in range(first_post, last_post):
        east, north, radius = posts[k, 0] - x, posts[k, 1] - y, posts[k, 2]
        px, py = cos_yaw * east + sin_yaw * north, cos_yaw * north - sin_yaw * east
        for i in range(count):
            along = px * cos_beams[i] + py * sin_beams[i]
            across = px * sin_beams[i] - py * cos_beams[i]
            half_chord = radius * radius - across * across
            half = math.sqrt(max(half_chord, 0.0))
            hit = max(along - half, 0.0)
            nearer = (half_chord >= 0.0) & (along + half >= 0.0) & (hit < ranges[row, i])
            ranges[row, i] = hit if nearer else ranges[row, i]


@njit(cache=True, **UNCOUNTED, forceinline=True)
def limit_ranges(ranges, row, min_range, max_range):
    """Raise ranges in a row of `ranges` (num_envs, beams) to `min_range`, and set those above `max_range` to inf."""
    for i in range(ranges.shape[1]):
        ranges[row, i] = np.inf if ranges[row, i] > max_range else max(ranges[row, i], min_range)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def clearance_at(x, y, index, world):
    """Distance from a point to the nearest obstacle of a world [m]: 0 inside one, inf without obstacles."""
    if index.parts[world, COLUMNS] > 0.0:
        return clearance_in_grid(x, y, index, world)
    boxes, posts, parts, _ = index
    nearest = np.inf
    for k in range(int(parts[world, BOXES]), int(parts[world, BOXES_END])):
        nearest = min(nearest, squared_gap_to_box(x, y, boxes, k))
    nearest = math.sqrt(nearest)
    for k in range(int(parts[world, POSTS]), int(parts[world, POSTS_END])):
        nearest = min(nearest, gap_to_post(x, y, posts, k))
    return nearest


@njit(cache=True)
def place_in_triangles(draws, corners, shares, poses):
    """Turn four random numbers in [0, 1) into a pose: a triangle, a point in it (two numbers), and a heading.

    Osada et al. 2002, "Shape distributions", section 4.2.

    Args:
        draws: Shape (num_envs, 4).
        corners: x, y of the corners of each triangle [m], shape (triangles, 3, 2).
        shares: Cumulative share of the area, shape (triangles,).
        poses: Result x [m], y [m], yaw [rad], shape (num_envs, 3).
    """
    for i in range(draws.shape[0]):
        k = min(np.searchsorted(shares, draws[i, 0], side="right"), shares.size - 1)
        root, along = math.sqrt(draws[i, 1]), draws[i, 2]
        for axis in range(2):
            first, second, third = corners[k, 0, axis], corners[k, 1, axis], corners[k, 2, axis]
            poses[i, axis] = (1 - root) * first + root * ((1 - along) * second + along * third)
        poses[i, 2] = math.tau * draws[i, 3] - math.pi


@njit(cache=True, fastmath={"nnan", "nsz"})  # ranges are never NaN, so several beams are compared at a time
def shortest_of(ranges, i):
    """Shortest range in row `i` of `ranges` (num_envs, beams)."""
    nearest = np.inf
    for beam in range(ranges.shape[1]):
        nearest = min(nearest, ranges[i, beam])
    return nearest


@njit(cache=True)
def shortest(ranges):
    """Shortest range in each row of `ranges` (num_envs, beams), shape (num_envs,)."""
    nearest = np.empty(ranges.shape[0])
    for i in range(ranges.shape[0]):
        nearest[i] = shortest_of(ranges, i)
    return nearest


def cast(poses, cos_beams, sin_beams, boxes, posts, ranges):
    """Write the ranges (num_envs, beams) from poses (num_envs, 3), testing every obstacle against every beam."""
    index = index_of(boxes, posts, grid_above=len(boxes) + len(posts))
    cast_many(poses, np.zeros(len(poses)), cos_beams, sin_beams, *index, ranges)


@njit(cache=True)
def cast_many(poses, world_of, cos_beams, sin_beams, boxes, posts, parts, lists, ranges):
    """`cast_beams` for poses (num_envs, 3), their worlds (num_envs,) and ranges (num_envs, beams)."""
    beams, index = (cos_beams, sin_beams), WorldIndex(boxes, posts, parts, lists)
    scratch = np.empty(cos_beams.size), np.empty(cos_beams.size)
    for i in range(poses.shape[0]):
        cast_beams(poses[i, 0], poses[i, 1], poses[i, 2], beams, index, int(world_of[i]), scratch, ranges, i)


# The entry points of kernels that hold the arrays of a `WorldIndex` one by one.


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def cast_one(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, row):
    """`cast_beams` with loose arrays."""
    index = WorldIndex(boxes, posts, parts, lists)
    cast_beams(x, y, yaw, (cos_beams, sin_beams), index, world, (over_x, over_y), ranges, row)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def clearance_one(x, y, boxes, posts, parts, lists, world):
    """`clearance_at` with loose arrays."""
    return clearance_at(x, y, WorldIndex(boxes, posts, parts, lists), world)
