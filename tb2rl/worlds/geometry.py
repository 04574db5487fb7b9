"""Compiled, exact laser ranges and clearances in worlds of boxes and posts, for all simulators.

Ranges come from the slab method for oriented boxes (Kay & Kajiya 1986) and the quadratic equation for circles. The
inner loops over beams have no branches, so that the compiler vectorizes them. Worlds with many obstacles use a grid
(`tb2rl.worlds.grid`).
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.worlds.grid import MIN_DIVISOR, clearance_in_grid, distance_to_post, range_in_grid, squared_distance_to_box
from tb2rl.worlds.spatial_index import BOX, POST, WORLD

_FASTMATH = {"nsz", "nnan", "arcp", "contract", "reassoc"}  # LLVM flags with which loops over beams are vectorized


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
                inverse_x[i] = 1.0 / (ray_x if abs(ray_x) > MIN_DIVISOR else MIN_DIVISOR)
                inverse_y[i] = 1.0 / (ray_y if abs(ray_y) > MIN_DIVISOR else MIN_DIVISOR)
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


@njit(cache=True, **NO_REFCOUNT, forceinline=True)
def limit_ranges(ranges, row, min_range, max_range):
    """Clip a row of `ranges` (num_envs, beams) to at least `min_range`, and set ranges above `max_range` to inf."""
    for i in range(ranges.shape[1]):
        ranges[row, i] = np.inf if ranges[row, i] > max_range else max(ranges[row, i], min_range)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def clearance_at(x, y, spatial_index, world_id):
    """Distance from a point to the nearest obstacle of a world [m]: 0 inside an obstacle, inf without obstacles."""
    if spatial_index.worlds[world_id, WORLD.columns] > 0.0:
        return clearance_in_grid(x, y, spatial_index, world_id)
    boxes, posts, worlds, _ = spatial_index
    nearest = np.inf
    for k in range(int(worlds[world_id, WORLD.first_box]), int(worlds[world_id, WORLD.end_box])):
        nearest = min(nearest, squared_distance_to_box(x, y, boxes, k))
    nearest = math.sqrt(nearest)
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


@njit(cache=True, fastmath={"nnan", "nsz"})  # ranges are never NaN, so the loop is vectorized
def shortest_range(ranges, row):
    """Shortest range in a row of `ranges` (num_envs, beams)."""
    nearest = np.inf
    for i in range(ranges.shape[1]):
        nearest = min(nearest, ranges[row, i])
    return nearest


@njit(cache=True)
def cast_many(poses, world_ids, beams, spatial_index, ranges):
    """`cast_beams` from poses (num_envs, 3) in worlds (num_envs,); writes `ranges` (num_envs, beams)."""
    scratch = np.empty(beams[0].size), np.empty(beams[0].size)
    for i in range(poses.shape[0]):
        pose = poses[i, 0], poses[i, 1], poses[i, 2]
        cast_beams(pose, beams, spatial_index, int(world_ids[i]), scratch, ranges, i)
