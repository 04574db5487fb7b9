"""Distances to single obstacles, and ray casting and clearance in a world with a grid, compiled.

A ray visits the cells along it (Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing"). A clearance
query searches rings of cells around the point.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.worlds.index import CELLS, COLUMNS, ROWS, SIDE, X, Y, cell_of

PARALLEL = 1e-12  # direction components below this count as parallel to a side; avoids 0 / 0


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def squared_gap_to_box(x, y, boxes, k):
    """Squared distance from a point to box `k` [m^2], 0 inside it."""
    east, north = x - boxes[k, 0], y - boxes[k, 1]
    dx = abs(boxes[k, 4] * east + boxes[k, 5] * north) - boxes[k, 2]
    dy = abs(boxes[k, 4] * north - boxes[k, 5] * east) - boxes[k, 3]
    dx, dy = max(dx, 0.0), max(dy, 0.0)
    return dx * dx + dy * dy


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def gap_to_post(x, y, posts, k):
    """Distance from a point to post `k` [m], 0 inside it."""
    east, north = x - posts[k, 0], y - posts[k, 1]
    return max(math.sqrt(east * east + north * north) - posts[k, 2], 0.0)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def hit_box(x, y, dx, dy, boxes, k):
    """Distance along the unit vector `dx`, `dy` to box `k` [m]: 0 inside it, inf if the ray misses it."""
    cos, sin = boxes[k, 4], boxes[k, 5]
    east, north = boxes[k, 0] - x, boxes[k, 1] - y
    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
    over_x = 1.0 / (ahead if abs(ahead) > PARALLEL else PARALLEL)
    over_y = 1.0 / (aside if abs(aside) > PARALLEL else PARALLEL)
    mid_x, mid_y = (cos * east + sin * north) * over_x, (cos * north - sin * east) * over_y
    reach_x, reach_y = boxes[k, 2] * abs(over_x), boxes[k, 3] * abs(over_y)
    near, far = max(mid_x - reach_x, mid_y - reach_y, 0.0), min(mid_x + reach_x, mid_y + reach_y)
    return near if far >= near else np.inf


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def hit_post(x, y, dx, dy, posts, k):
    """Distance along the unit vector `dx`, `dy` to post `k` [m]: 0 inside it, inf if the ray misses it."""
    east, north = posts[k, 0] - x, posts[k, 1] - y
    along, across = east * dx + north * dy, east * dy - north * dx
    half_chord = posts[k, 2] * posts[k, 2] - across * across
    half = math.sqrt(max(half_chord, 0.0))
    return max(along - half, 0.0) if half_chord >= 0.0 and along + half >= 0.0 else np.inf


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def first_hit(x, y, dx, dy, index, world):
    """Distance from a point along the unit vector `dx`, `dy` to the nearest obstacle [m]; inf if there is none."""
    boxes, posts, parts, lists = index
    x0, y0, side = parts[world, X], parts[world, Y], parts[world, SIDE]
    columns, rows, first = int(parts[world, COLUMNS]), int(parts[world, ROWS]), int(parts[world, CELLS])
    over_x, over_y = 1.0 / (dx if abs(dx) > PARALLEL else PARALLEL), 1.0 / (dy if abs(dy) > PARALLEL else PARALLEL)
    left, right = (x0 - x) * over_x, (x0 + columns * side - x) * over_x
    below, above = (y0 - y) * over_y, (y0 + rows * side - y) * over_y
    enter = max(min(left, right), min(below, above), 0.0)
    if min(max(left, right), max(below, above)) < enter:
        return np.inf  # the ray misses the grid
    column, row = cell_of(x0, side, x + enter * dx, columns), cell_of(y0, side, y + enter * dy, rows)
    east, north = over_x > 0.0, over_y > 0.0
    nearest = np.inf
    while True:
        cell = first + row * columns + column
        for entry in range(lists[cell], lists[cell + 1]):
            k = lists[entry]
            hit = hit_box(x, y, dx, dy, boxes, k) if k >= 0 else hit_post(x, y, dx, dy, posts, -1 - k)
            nearest = min(nearest, hit)
        leave_x, leave_y = (x0 + (column + east) * side - x) * over_x, (y0 + (row + north) * side - y) * over_y
        if nearest <= min(leave_x, leave_y):
            return nearest
        if leave_x < leave_y:
            column += 1 if east else -1
        else:
            row += 1 if north else -1
        if column < 0 or column == columns or row < 0 or row == rows:
            return nearest


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def clearance_in_grid(x, y, index, world):
    """Distance from a point to the nearest obstacle [m]: search rings of cells until the rest is farther away."""
    boxes, posts, parts, lists = index
    x0, y0, side = parts[world, X], parts[world, Y], parts[world, SIDE]
    columns, rows, first = int(parts[world, COLUMNS]), int(parts[world, ROWS]), int(parts[world, CELLS])
    column, row = cell_of(x0, side, x, columns), cell_of(y0, side, y, rows)
    # Offset in the cell. A point outside is moved to the nearest point of the grid, which is nearer to all obstacles.
    west = min(max(x - x0, 0.0), columns * side) - column * side
    south = min(max(y - y0, 0.0), rows * side) - row * side
    nearest = np.inf
    for ring in range(max(columns, rows)):
        for j in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            whole = abs(j - row) == ring
            i = max(column - ring, 0) if whole else column - ring
            while i <= min(column + ring, columns - 1):
                if i >= 0:
                    cell = first + j * columns + i
                    for entry in range(lists[cell], lists[cell + 1]):
                        k = lists[entry]
                        if k >= 0:
                            nearest = min(nearest, math.sqrt(squared_gap_to_box(x, y, boxes, k)))
                        else:
                            nearest = min(nearest, gap_to_post(x, y, posts, -1 - k))
                i += 1 if whole else 2 * ring
        searched = np.inf  # [m] radius within which every obstacle has been tested
        if column - ring > 0:
            searched = min(searched, west + ring * side)
        if column + ring < columns - 1:
            searched = min(searched, (ring + 1) * side - west)
        if row - ring > 0:
            searched = min(searched, south + ring * side)
        if row + ring < rows - 1:
            searched = min(searched, (ring + 1) * side - south)
        if nearest <= searched:
            break
    return nearest
