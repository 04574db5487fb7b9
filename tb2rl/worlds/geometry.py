"""Exact laser ranges against the boxes and posts of a world, compiled.

Slab test against oriented boxes (Kay & Kajiya 1986) and the quadratic for circles; the inner loops over beams have no
branches, so that the compiler turns them into vector instructions. Where a world has many obstacles, its grid says
which of them can matter (`tb2rl.worlds.grid`). Every simulation reads this laser: all see the same walls.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.worlds.grid import PARALLEL, clearance_in_grid, first_hit
from tb2rl.worlds.index import BOXES, BOXES_END, COLUMNS, POSTS, POSTS_END, index_of

_FAST = {"nsz", "nnan", "arcp", "contract", "reassoc"}  # for loops over beams


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def cast_one(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, robot):
    """Write the distance to the nearest obstacle along each beam of one robot into its row of `ranges` (inf: nothing).

    Args:
        x, y, yaw: Pose of the laser [m, m, rad].
        cos_beams, sin_beams: Beam directions in the laser's frame, shape (beams,).
        boxes, posts, parts, lists: The `WorldIndex` of all worlds.
        world: Number of the robot's world in it.
        over_x, over_y: Room to calculate in, shape (beams,); to allocate it here would cost as much as the work.
        ranges: Result [m], shape (num_envs, beams).
        robot: Index of its row; a view of the row would be counted as one more reference, by all threads in one place.
    """
    if parts[world, COLUMNS] == 0.0:
        _cast_at_all(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, robot)
        return
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    for i in range(cos_beams.size):
        dx = cos_yaw * cos_beams[i] - sin_yaw * sin_beams[i]
        dy = sin_yaw * cos_beams[i] + cos_yaw * sin_beams[i]
        ranges[robot, i] = first_hit(x, y, dx, dy, boxes, posts, parts, lists, world)


@njit(cache=True, **UNCOUNTED, fastmath=_FAST, error_model="numpy", forceinline=True)
def _cast_at_all(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, robot):
    """Hold each obstacle of a world against all beams; for the arguments see `cast_one`."""
    first_box, last_box = int(parts[world, BOXES]), int(parts[world, BOXES_END])
    first_post, last_post = int(parts[world, POSTS]), int(parts[world, POSTS_END])
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    beams = cos_beams.size
    for i in range(beams):
        ranges[robot, i] = np.inf
    # One over each beam's direction in the frame of a box: divisions are what costs, and boxes share orientations.
    for k in range(first_box, last_box):
        half_length, half_width, cos_box, sin_box = boxes[k, 2], boxes[k, 3], boxes[k, 4], boxes[k, 5]
        if k == first_box or cos_box != boxes[k - 1, 4] or sin_box != boxes[k - 1, 5]:
            c = cos_yaw * cos_box + sin_yaw * sin_box
            s = sin_yaw * cos_box - cos_yaw * sin_box
            for i in range(beams):
                dx = c * cos_beams[i] - s * sin_beams[i]
                dy = s * cos_beams[i] + c * sin_beams[i]
                over_x[i] = 1.0 / (dx if abs(dx) > PARALLEL else PARALLEL)
                over_y[i] = 1.0 / (dy if abs(dy) > PARALLEL else PARALLEL)
        east, north = x - boxes[k, 0], y - boxes[k, 1]
        ox, oy = cos_box * east + sin_box * north, cos_box * north - sin_box * east
        for i in range(beams):
            mid_x, mid_y = -ox * over_x[i], -oy * over_y[i]
            reach_x, reach_y = half_length * abs(over_x[i]), half_width * abs(over_y[i])
            near = max(mid_x - reach_x, mid_y - reach_y)
            far = min(mid_x + reach_x, mid_y + reach_y)
            hit = max(near, 0.0)
            nearer = (far >= hit) & (hit < ranges[robot, i])
            ranges[robot, i] = hit if nearer else ranges[robot, i]
    for k in range(first_post, last_post):
        east, north, radius = posts[k, 0] - x, posts[k, 1] - y, posts[k, 2]
        px, py = cos_yaw * east + sin_yaw * north, cos_yaw * north - sin_yaw * east
        for i in range(beams):
            along = px * cos_beams[i] + py * sin_beams[i]
            across = px * sin_beams[i] - py * cos_beams[i]
            half_chord = radius * radius - across * across
            half = math.sqrt(max(half_chord, 0.0))
            hit = max(along - half, 0.0)
            nearer = (half_chord >= 0.0) & (along + half >= 0.0) & (hit < ranges[robot, i])
            ranges[robot, i] = hit if nearer else ranges[robot, i]


@njit(cache=True, **UNCOUNTED, forceinline=True)
def limit_ranges(ranges, robot, min_range, max_range):
    """Keep the row of a robot in `ranges` (num_envs, beams) within what a laser can say.

    Nothing is below its shortest range, and inf is beyond its longest.
    """
    for i in range(ranges.shape[1]):
        ranges[robot, i] = np.inf if ranges[robot, i] > max_range else max(ranges[robot, i], min_range)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def clearance_one(x, y, boxes, posts, parts, lists, world):
    """Distance from a point to the nearest obstacle of a world [m]; 0 inside one, inf where there is none."""
    if parts[world, COLUMNS] > 0.0:
        return clearance_in_grid(x, y, boxes, posts, parts, lists, world)
    nearest = np.inf
    for k in range(int(parts[world, BOXES]), int(parts[world, BOXES_END])):
        east, north = x - boxes[k, 0], y - boxes[k, 1]
        dx = abs(boxes[k, 4] * east + boxes[k, 5] * north) - boxes[k, 2]
        dy = abs(boxes[k, 4] * north - boxes[k, 5] * east) - boxes[k, 3]
        dx, dy = max(dx, 0.0), max(dy, 0.0)
        nearest = min(nearest, dx * dx + dy * dy)
    nearest = math.sqrt(nearest)
    for k in range(int(parts[world, POSTS]), int(parts[world, POSTS_END])):
        east, north = x - posts[k, 0], y - posts[k, 1]
        nearest = min(nearest, max(math.sqrt(east * east + north * north) - posts[k, 2], 0.0))
    return nearest


@njit(cache=True)
def place_in_triangles(draws, corners, shares, poses):
    """Write the pose that four random numbers in [0, 1) mean: a triangle, a point in it (two), and a heading.

    Osada et al. 2002, "Shape distributions", section 4.2.

    Args:
        draws: Shape (num_envs, 4).
        corners: x, y of the corners of each triangle [m], shape (triangles, 3, 2).
        shares: Share of the area up to and with each triangle, ascending, shape (triangles,).
        poses: Result x [m], y [m], yaw [rad], shape (num_envs, 3).
    """
    for i in range(draws.shape[0]):
        k = min(np.searchsorted(shares, draws[i, 0], side="right"), shares.size - 1)
        root, along = math.sqrt(draws[i, 1]), draws[i, 2]
        for axis in range(2):
            first, second, third = corners[k, 0, axis], corners[k, 1, axis], corners[k, 2, axis]
            poses[i, axis] = (1 - root) * first + root * ((1 - along) * second + along * third)
        poses[i, 2] = math.tau * draws[i, 3] - math.pi


@njit(cache=True, fastmath={"nnan", "nsz"})  # several beams at a time: ranges are numbers
def shortest_of(ranges, i):
    """The shortest of the ranges (num_envs, beams) of robot `i`."""
    nearest = np.inf
    for beam in range(ranges.shape[1]):
        nearest = min(nearest, ranges[i, beam])
    return nearest


@njit(cache=True)
def shortest(ranges):
    """The shortest of each robot's ranges (num_envs, beams), shape (num_envs,)."""
    nearest = np.empty(ranges.shape[0])
    for i in range(ranges.shape[0]):
        nearest[i] = shortest_of(ranges, i)
    return nearest


def cast(poses, cos_beams, sin_beams, boxes, posts, ranges):
    """The ranges (num_envs, beams) from poses (num_envs, 3) among `boxes` and `posts`, each held against every beam."""
    index = index_of(boxes, posts, few=len(boxes) + len(posts))
    cast_many(poses, np.zeros(len(poses)), cos_beams, sin_beams, *index, ranges)


@njit(cache=True)
def cast_many(poses, world_of, cos_beams, sin_beams, boxes, posts, parts, lists, ranges):
    """`cast_one` for many robots: poses (num_envs, 3), their worlds (num_envs,), ranges (num_envs, beams)."""
    over_x, over_y = np.empty(cos_beams.size), np.empty(cos_beams.size)
    for i in range(poses.shape[0]):
        x, y, yaw, world = poses[i, 0], poses[i, 1], poses[i, 2], int(world_of[i])
        cast_one(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, i)
