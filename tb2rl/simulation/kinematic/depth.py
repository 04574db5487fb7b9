"""The depth camera of the kinematic simulator; walls and dynamic obstacles are equally high, so that a column of
pixels needs one planar ray.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.robots import Camera
from tb2rl.simulation.obstacles.outlines import cast_at_outlines
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.index import WorldIndex
from tb2rl.worlds.world import WALL_HEIGHT


def depth_images(
    camera: Camera,
    poses: np.ndarray,
    world_of: np.ndarray,
    index: WorldIndex,
    size: tuple[int, int],
    dynamic_obstacles: np.ndarray | None = None,
) -> np.ndarray:
    """Depth images of cameras that look along x, mounted below the top of the walls.

    Args:
        camera: Of every robot.
        poses: Of the robots: x [m], y [m], yaw [rad], shape (num_envs, 3).
        world_of: The world of each, shape (num_envs,).
        index: Of all worlds.
        size: Height and width of an image [px].
        dynamic_obstacles: See `RobotState.dynamic_obstacles`.

    Returns:
        Depth along the optical axis [m], shape (num_envs, height, width), float32; inf beyond the camera's range.
    """
    (height, width), (forward, sideways, up) = size, camera.position
    lens, cos, sin = np.array(poses, dtype=float), np.cos(poses[:, 2]), np.sin(poses[:, 2])
    lens[:, 0] += forward * cos - sideways * sin
    lens[:, 1] += forward * sin + sideways * cos
    # PyBullet's renderer takes a pixel's colour and depth from its lower left corner, and not from its middle.
    reach = math.tan(camera.field_of_view / 2)
    leftward = reach * (width - 2.0 * np.arange(width)) / height
    upward = reach * (height - 2.0 * np.arange(1, height + 1)) / height
    along = 1.0 / np.hypot(1.0, leftward)  # the cosine of each ray's angle
    walls = np.empty((len(lens), width))
    cast_many(lens, world_of, along, along * leftward, *index, walls)
    if dynamic_obstacles is not None:
        cast_at_outlines(lens, (along, along * leftward), dynamic_obstacles, walls)
    walls *= along
    images = np.empty((len(lens), height, width), dtype=np.float32)
    _fill(walls, upward, up, camera.range[1], images)
    return images


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(walls, upward, lens_height, farthest, images):
    """Write images (num_envs, height, width) of walls at depths (num_envs, width) [m]: wall, floor, or nothing.

    `upward` (height,) is how much each row rises per metre of depth, `lens_height` [m] where the rays begin.
    """
    for robot in range(walls.shape[0]):
        for row in range(upward.size):
            rise, end, beyond = upward[row], np.inf, np.inf
            if rise > 0.0:
                end = (WALL_HEIGHT - lens_height) / rise  # further on, the ray is above the walls and sees nothing
            elif rise < 0.0:
                end = beyond = -lens_height / rise  # where it meets the floor
            for column in range(walls.shape[1]):
                wall = walls[robot, column]
                depth = wall if wall <= end else beyond
                images[robot, row, column] = depth if depth <= farthest else np.inf
