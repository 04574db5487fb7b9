"""Compiled, exact laser ranges and clearances in worlds of boxes and posts, for all simulators.

Ranges come from the slab method for oriented boxes (Kay & Kajiya 1986) and the quadratic equation for circles. The
inner loops over beams have no branches, so that the compiler vectorizes them. Worlds with many obstacles use the grid
of a `SpatialIndex`: a ray visits the cells along it (Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray
tracing"), and a clearance query searches rings of cells around the point.
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.worlds.spatial_index import BOX, POST, WORLD, cell_of

_MIN_DIVISOR = 1e-12  # replaces divisors nearer to 0, of rays parallel to a side, because 0 * (1 / 0) is NaN
_FASTMATH = {"nsz", "nnan", "arcp", "contract", "reassoc"}  # for LLVM to vectorize loops; ranges are never NaN


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def cast_beams(pose, beams, spatial_index, world_id, scratch, ranges, row):
    """Write the range of each beam to one row of `ranges`; inf if the beam hits no obstacle.

    Args:
        pose: Pose of the laser: x, y, yaw [m, m, rad].
        beams: Cosines and sines of the beam angles in the frame of the laser, each of shape (beams,).
        spatial_index: `SpatialIndex` of all worlds.
        world_id: Row of the world in `spatial_index.worlds`.
        scratch: Two arrays of shape (beams,), because their allocation would take as long as the computation.
        ranges: Result [m], shape (num_envs, beams).
        row: Row of the result. It is an index, because threads would contend for the reference count of a view.
    """
    if spatial_index.worlds[world_id, WORLD.columns] == 0.0:
        _cast_without_grid(pose, beams, spatial_index, world_id, scratch, ranges, row)
        return
    (x, y, yaw), (cos_beams, sin_beams) = pose, beams
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    for i in range(cos_beams.size):
        ray_x = cos_yaw * cos_beams[i] - sin_yaw * sin_beams[i]
        ray_y = sin_yaw * cos_beams[i] + cos_yaw * sin_beams[i]
        ranges[row, i] = range_in_grid(x, y, ray_x, ray_y, spatial_index, world_id)


@njit(cache=True, **NO_REFCOUNT, fastmath=_FASTMATH, error_model="numpy", forceinline=True)
def _cast_without_grid(pose, beams, spatial_index, world_id, scratch, ranges, row):
    """Test all obstacles of a world against all beams; see `cast_beams`."""
    (x, y, yaw), (cos_beams, sin_beams), (inverse_x, inverse_y) = pose, beams, scratch
    boxes, posts, worlds, _ = spatial_index
    first_box = int(worlds[world_id, WORLD.first_box])
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    count = cos_beams.size
    for i in range(count):
        ranges[row, i] = np.inf
    # Inverse beam directions are kept between boxes of the same orientation, because divisions dominate the cost.
    for k in range(first_box, int(worlds[world_id, WORLD.end_box])):
        half_length, half_width = boxes[k, BOX.half_length], boxes[k, BOX.half_width]
        cos_box, sin_box = boxes[k, BOX.cos], boxes[k, BOX.sin]
        if k == first_box or cos_box != boxes[k - 1, BOX.cos] or sin_box != boxes[k - 1, BOX.sin]:
            cos_relative = cos_yaw * cos_box + sin_yaw * sin_box
            sin_relative = sin_yaw * cos_box - cos_yaw * sin_box
            for i in range(count):
                ray_x = cos_relative * cos_beams[i] - sin_relative * sin_beams[i]
                ray_y = sin_relative * cos_beams[i] + cos_relative * sin_beams[i]
                inverse_x[i] = 1.0 / (ray_x if abs(ray_x) > _MIN_DIVISOR else _MIN_DIVISOR)
                inverse_y[i] = 1.0 / (ray_y if abs(ray_y) > _MIN_DIVISOR else _MIN_DIVISOR)
        dx, dy = x - boxes[k, BOX.x], y - boxes[k, BOX.y]
        laser_x, laser_y = cos_box * dx + sin_box * dy, cos_box * dy - sin_box * dx  # in the frame of the box
        for i in range(count):  # see `slab_interval`
            middle_x, middle_y = -laser_x * inverse_x[i], -laser_y * inverse_y[i]
            half_x, half_y = half_length * abs(inverse_x[i]), half_width * abs(inverse_y[i])
            near = max(middle_x - half_x, middle_y - half_y)
            far = min(middle_x + half_x, middle_y + half_y)
            hit = max(near, 0.0)
            is_nearer = (far >= hit) & (hit < ranges[row, i])
            ranges[row, i] = hit if is_nearer else ranges[row, i]
    for k in range(int(worlds[world_id, WORLD.first_post]), int(worlds[world_id, WORLD.end_post])):
        dx, dy, radius = posts[k, POST.x] - x, posts[k, POST.y] - y, posts[k, POST.radius]
        post_x, post_y = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx  # in the frame of the laser
        for i in range(count):  # see `chord_interval`
            along = post_x * cos_beams[i] + post_y * sin_beams[i]
            across = post_x * sin_beams[i] - post_y * cos_beams[i]
            squared_half_chord = radius * radius - across * across
            half_chord = math.sqrt(max(squared_half_chord, 0.0))
            hit = max(along - half_chord, 0.0)
            is_nearer = (squared_half_chord >= 0.0) & (along + half_chord >= 0.0) & (hit < ranges[row, i])
            ranges[row, i] = hit if is_nearer else ranges[row, i]


@njit(cache=True, **NO_REFCOUNT, fastmath=_FASTMATH, forceinline=True)
def limit_ranges(ranges, row, min_range, max_range):
    """Clip a row of `ranges` (num_envs, beams) to at least `min_range`, and set ranges above `max_range` to inf.

    Returns:
        The shortest range [m].
    """
    shortest = np.inf
    for i in range(ranges.shape[1]):
        limited = np.inf if ranges[row, i] > max_range else max(ranges[row, i], min_range)
        shortest, ranges[row, i] = min(shortest, limited), limited
    return shortest


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def clearance_at(x, y, spatial_index, world_id):
    """Distance from a point to the nearest obstacle of a world [m]: 0 inside an obstacle, inf without obstacles."""
    if spatial_index.worlds[world_id, WORLD.columns] > 0.0:
        return clearance_in_grid(x, y, spatial_index, world_id)
    boxes, posts, worlds, _ = spatial_index
    nearest_squared = np.inf
    for k in range(int(worlds[world_id, WORLD.first_box]), int(worlds[world_id, WORLD.end_box])):
        nearest_squared = min(nearest_squared, squared_distance_to_box(x, y, boxes, k))
    nearest = math.sqrt(nearest_squared)
    for k in range(int(worlds[world_id, WORLD.first_post]), int(worlds[world_id, WORLD.end_post])):
        nearest = min(nearest, distance_to_post(x, y, posts, k))
    return nearest


@njit(cache=True)
def sample_in_triangles(random_numbers, corners, cumulative_areas, poses):
    """Sample poses in triangles, uniformly in area and yaw (Osada et al. 2002, "Shape distributions").

    Args:
        random_numbers: Uniform in [0, 1): one for the triangle, two for the point, one for the yaw; shape (poses, 4).
        corners: x, y of the corners of each triangle [m], shape (triangles, 3, 2).
        cumulative_areas: Cumulative sum of the triangles' areas, as shares of the total area, shape (triangles,).
        poses: Result x [m], y [m], yaw [rad], shape (poses, 3).
    """
    for i in range(random_numbers.shape[0]):
        k = min(np.searchsorted(cumulative_areas, random_numbers[i, 0], side="right"), cumulative_areas.size - 1)
        root, along = math.sqrt(random_numbers[i, 1]), random_numbers[i, 2]
        for axis in range(2):
            first, second, third = corners[k, 0, axis], corners[k, 1, axis], corners[k, 2, axis]
            poses[i, axis] = (1 - root) * first + root * ((1 - along) * second + along * third)
        poses[i, 2] = math.tau * random_numbers[i, 3] - math.pi


@njit(cache=True, fastmath=_FASTMATH)
def shortest_ranges(ranges):
    """Shortest range in each row of `ranges` (num_envs, beams), shape (num_envs,); inf without beams."""
    shortest = np.full(ranges.shape[0], np.inf)
    for row in range(ranges.shape[0]):
        for i in range(ranges.shape[1]):
            shortest[row] = min(shortest[row], ranges[row, i])
    return shortest


@njit(cache=True)
def cast_many(poses, world_ids, beams, spatial_index, ranges):
    """`cast_beams` from poses (num_envs, 3) in worlds (num_envs,); writes `ranges` (num_envs, beams)."""
    scratch = np.empty(beams[0].size), np.empty(beams[0].size)
    for i in range(poses.shape[0]):
        pose = poses[i, 0], poses[i, 1], poses[i, 2]
        cast_beams(pose, beams, spatial_index, int(world_ids[i]), scratch, ranges, i)


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
    """Distances from the start of a ray [m] at which its line enters and leaves a box, by the slab method.

    They are negative behind the start. If the line misses the box, enter > leave. `x` and `y` are the position of the
    box relative to the start [m], `ray_x` and `ray_y` the unit vector along the ray, all along the sides of the box.
    """
    inverse_x = 1.0 / (ray_x if abs(ray_x) > _MIN_DIVISOR else _MIN_DIVISOR)
    inverse_y = 1.0 / (ray_y if abs(ray_y) > _MIN_DIVISOR else _MIN_DIVISOR)
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
    inverse_x = 1.0 / (ray_x if abs(ray_x) > _MIN_DIVISOR else _MIN_DIVISOR)
    inverse_y = 1.0 / (ray_y if abs(ray_y) > _MIN_DIVISOR else _MIN_DIVISOR)
    # Distances along the ray to the four sides of the grid, and to the point where the ray enters the grid.
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
        to_next_column = (x0 + (column + rightward) * side - x) * inverse_x
        to_next_row = (y0 + (row + upward) * side - y) * inverse_y
        if nearest <= min(to_next_column, to_next_row):
            return nearest
        if to_next_column < to_next_row:
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
    # of the grid, which is nearer to all obstacles, so that the search does not end too early.
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
