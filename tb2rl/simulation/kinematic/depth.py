"""The depth camera of the kinematic simulator.

Walls and dynamic obstacles have the same height, so that one planar ray is enough for a column of pixels.
"""

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.robots import Camera
from tb2rl.simulation.obstacles.outlines import cast_at_outlines
from tb2rl.simulation.robot_state import RobotState
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.spatial_index import SpatialIndex
from tb2rl.worlds.world import WALL_HEIGHT


def depth_images(
    robot_state: RobotState, camera: Camera, spatial_index: SpatialIndex, width: int, height: int
) -> np.ndarray:
    """Depth images of cameras that look along x, mounted below the top of the walls.

    Args:
        robot_state: Poses, worlds and dynamic obstacles.
        camera: Camera of every robot.
        spatial_index: Index of all worlds.
        width, height: Size of an image [px].

    Returns:
        Depth along the optical axis [m], shape (num_envs, height, width), float32; inf beyond the camera's range.
    """
    (forward, sideways, up), poses, obstacles = camera.position, robot_state.pose, robot_state.dynamic_obstacles
    lens_poses, cos, sin = np.array(poses, dtype=float), np.cos(poses[:, 2]), np.sin(poses[:, 2])
    lens_poses[:, 0] += forward * cos - sideways * sin
    lens_poses[:, 1] += forward * sin + sideways * cos
    # PyBullet's renderer takes a pixel's colour and depth from its lower left corner, and not from its middle.
    half_height = math.tan(camera.field_of_view / 2)  # [m] half height of the image at a depth of 1 m
    leftward = half_height * (width - 2.0 * np.arange(width)) / height
    upward = half_height * (height - 2.0 * np.arange(1, height + 1)) / height
    cosines = 1.0 / np.hypot(1.0, leftward)  # of the angles between the rays and the optical axis
    rays, depths = (cosines, cosines * leftward), np.empty((len(lens_poses), width))
    cast_many(lens_poses, robot_state.initial_state.world, rays, spatial_index, depths)
    if obstacles is not None:
        cast_at_outlines(lens_poses, rays, obstacles, depths)
    depths *= cosines
    images = np.empty((len(lens_poses), height, width), dtype=np.float32)
    _fill_images(depths, upward, up, camera.range[1], images)
    return images


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_images(wall_depths, upward, lens_height, max_depth, images):
    """Write the depth of each pixel: that of a wall, of the floor, or inf.

    Args:
        wall_depths: Depth of the nearest wall or obstacle in each column [m], shape (num_envs, width).
        upward: Rise of the rays of each row per metre of depth, shape (height,).
        lens_height: Height of the lens above the floor [m].
        max_depth: Range of the camera [m].
        images: Result [m], shape (num_envs, height, width).
    """
    for robot in range(wall_depths.shape[0]):
        for row in range(upward.size):
            rise, wall_end, depth_beyond = upward[row], np.inf, np.inf
            if rise > 0.0:
                wall_end = (WALL_HEIGHT - lens_height) / rise  # beyond this depth the ray is above the walls
            elif rise < 0.0:
                wall_end = depth_beyond = -lens_height / rise  # there the ray meets the floor
            for column in range(wall_depths.shape[1]):
                wall_depth = wall_depths[robot, column]
                depth = wall_depth if wall_depth <= wall_end else depth_beyond
                images[robot, row, column] = depth if depth <= max_depth else np.inf
