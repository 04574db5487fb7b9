"""Compiled ray casting and clearance queries against single obstacles, and in the grid of a `SpatialIndex`.

A ray visits the cells along it (Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing"). A clearance
query searches rings of cells around the point.
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.worlds.spatial_index import BOX, POST, WORLD, cell_of

MIN_DIVISOR = 1e-12  # smallest divisor, for rays that are parallel to a side; avoids 0 / 0


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def squared_distance_to_box(x, y, boxes, k):
    """Squared distance from a point to row `k` of `boxes` [m^2]; 0 inside the box."""
    dx, dy, cos, sin = x - boxes[k, BOX.x], y - boxes[k, BOX.y], boxes[k, BOX.cos], boxes[k, BOX.sin]
    outside_x = max(abs(cos * dx + sin * dy) - boxes[k, BOX.half_length], 0.0)
    outside_y = max(abs(cos * dy - sin * dx) - boxes[k, BOX.half_width], 0.0)
    return outside_x * outside_x + outside_y * outside_y


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def distance_to_post(x, y, posts, k):
    """Distance from a point to the circle in row `k` of `posts` [m]; 0 inside the circle."""
    dx, dy = x - posts[k, POST.x], y - posts[k, POST.y]
    return max(math.sqrt(dx * dx + dy * dy) - posts[k, POST.radius], 0.0)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def slab_interval(x, y, ray_x, ray_y, half_length, half_width):
    """Distances along a ray [m] where it enters and leaves a box, by the slab method; without a hit, enter > leave.

    `x` and `y` are the position of the box relative to the start of the ray [m], and `ray_x` and `ray_y` are the unit
    vector along the ray, all in directions along the sides of the box.
    """
    inverse_x = 1.0 / (ray_x if abs(ray_x) > MIN_DIVISOR else MIN_DIVISOR)
    inverse_y = 1.0 / (ray_y if abs(ray_y) > MIN_DIVISOR else MIN_DIVISOR)
    middle_x, middle_y = x * inverse_x, y * inverse_y  # of the part of the ray between two opposite sides of the box
    half_x, half_y = half_length * abs(inverse_x), half_width * abs(inverse_y)
    return max(middle_x - half_x, middle_y - half_y), min(middle_x + half_x, middle_y + half_y)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def chord_interval(x, y, ray_x, ray_y, radius):
    """As `slab_interval`, for a circle."""
    along, across = x * ray_x + y * ray_y, x * ray_y - y * ray_x
    squared_half_chord = radius * radius - across * across
    half_chord = math.sqrt(max(squared_half_chord, 0.0))
    return (along - half_chord, along + half_chord) if squared_half_chord >= 0.0 else (np.inf, -np.inf)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def range_in_grid(x, y, ray_x, ray_y, spatial_index, world_id):
    """Distance along a ray to the nearest obstacle of a world with a grid [m]: 0 inside an obstacle, inf without a hit.

    The ray starts at `x`, `y` [m] in the direction of the unit vector `ray_x`, `ray_y`.
    """
    boxes, posts, worlds, cell_lists = spatial_index
    x0, y0, side = worlds[world_id, WORLD.x0], worlds[world_id, WORLD.y0], worlds[world_id, WORLD.cell_side]
    columns, rows = int(worlds[world_id, WORLD.columns]), int(worlds[world_id, WORLD.rows])
    first_cell = int(worlds[world_id, WORLD.first_cell])
    inverse_x = 1.0 / (ray_x if abs(ray_x) > MIN_DIVISOR else MIN_DIVISOR)
    inverse_y = 1.0 / (ray_y if abs(ray_y) > MIN_DIVISOR else MIN_DIVISOR)
    # Distances along the ray to the four sides of the grid.
    left, right = (x0 - x) * inverse_x, (x0 + columns * side - x) * inverse_x
    bottom, top = (y0 - y) * inverse_y, (y0 + rows * side - y) * inverse_y
    entry = max(min(left, right), min(bottom, top), 0.0)
    if min(max(left, right), max(bottom, top)) < entry:
        return np.inf  # the ray misses the grid
    column, row = cell_of(x0, side, x + entry * ray_x, columns), cell_of(y0, side, y + entry * ray_y, rows)
    rightward, upward = inverse_x > 0.0, inverse_y > 0.0
    nearest = np.inf
    while True:
        cell = first_cell + row * columns + column
        for position in range(cell_lists[cell], cell_lists[cell + 1]):
            k = cell_lists[position]
            if k >= 0:
                dx, dy, cos, sin = boxes[k, BOX.x] - x, boxes[k, BOX.y] - y, boxes[k, BOX.cos], boxes[k, BOX.sin]
                centre = cos * dx + sin * dy, cos * dy - sin * dx
                direction = cos * ray_x + sin * ray_y, cos * ray_y - sin * ray_x
                enter, leave = slab_interval(*centre, *direction, boxes[k, BOX.half_length], boxes[k, BOX.half_width])
            else:
                dx, dy = posts[-1 - k, POST.x] - x, posts[-1 - k, POST.y] - y
                enter, leave = chord_interval(dx, dy, ray_x, ray_y, posts[-1 - k, POST.radius])
            hit = max(enter, 0.0)
            nearest = min(nearest, hit if leave >= hit else np.inf)
        exit_x = (x0 + (column + rightward) * side - x) * inverse_x
        exit_y = (y0 + (row + upward) * side - y) * inverse_y
        if nearest <= min(exit_x, exit_y):
            return nearest
        if exit_x < exit_y:
            column += 1 if rightward else -1
        else:
            row += 1 if upward else -1
        if column < 0 or column == columns or row < 0 or row == rows:
            return nearest


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def clearance_in_grid(x, y, spatial_index, world_id):
    """Distance from a point to the nearest obstacle of a world with a grid [m]; 0 inside an obstacle."""
    boxes, posts, worlds, cell_lists = spatial_index
    x0, y0, side = worlds[world_id, WORLD.x0], worlds[world_id, WORLD.y0], worlds[world_id, WORLD.cell_side]
    columns, rows = int(worlds[world_id, WORLD.columns]), int(worlds[world_id, WORLD.rows])
    first_cell = int(worlds[world_id, WORLD.first_cell])
    column, row = cell_of(x0, side, x, columns), cell_of(y0, side, y, rows)
    # Distances from the left and the lower side of the cell. A point outside the grid is replaced by the nearest point
    # of the grid, which is nearer to all obstacles, so that no ring is left out.
    from_left = min(max(x - x0, 0.0), columns * side) - column * side
    from_bottom = min(max(y - y0, 0.0), rows * side) - row * side
    nearest = np.inf
    for ring in range(max(columns, rows)):
        for j in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            is_full_row = abs(j - row) == ring  # the lowest and the highest row of the ring; others have two cells
            i = max(column - ring, 0) if is_full_row else column - ring
            while i <= min(column + ring, columns - 1):
                if i >= 0:
                    cell = first_cell + j * columns + i
                    for position in range(cell_lists[cell], cell_lists[cell + 1]):
                        k = cell_lists[position]
                        if k >= 0:
                            nearest = min(nearest, math.sqrt(squared_distance_to_box(x, y, boxes, k)))
                        else:
                            nearest = min(nearest, distance_to_post(x, y, posts, -1 - k))
                i += 1 if is_full_row else 2 * ring
        # Distances to the sides of the ring; beyond the grid there are no obstacles.
        left = from_left + ring * side if column > ring else np.inf
        right = (ring + 1) * side - from_left if column + ring < columns - 1 else np.inf
        bottom = from_bottom + ring * side if row > ring else np.inf
        top = (ring + 1) * side - from_bottom if row + ring < rows - 1 else np.inf
        if nearest <= min(left, right, bottom, top):
            break
    return nearest
