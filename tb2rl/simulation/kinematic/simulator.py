"""The kinematic simulator: closed-form integration of differential drives, for thousands of robots in compiled code.

Wheel speeds ramp to the commands, walls stop the base, and laser ranges are exact. `tests/simulation/test_kinematic.py`
compares the motion with PyBullet.
"""

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.core.threads import parallel_if_long
from tb2rl.simulation.arrays.robots import ROBOT, RobotArrays
from tb2rl.simulation.arrays.simulator import ArraySimulator
from tb2rl.simulation.kinematic.motion import step_block
from tb2rl.simulation.obstacles.outlines import cast_at_outlines
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.world import WALL_HEIGHT

# Estimated duration [s] of a step in one thread: for each robot, for each of its beams, for each dynamic obstacle.
_ROBOT_TIME, _BEAM_TIME, _OBSTACLE_TIME = 0.25e-6, 4e-9, 2e-6


class KinematicSimulator(ArraySimulator):
    """Differential drives without slip, each in one of the worlds; see `ArraySimulator`."""

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        super().__init__(spec, num_envs)
        obstacle_count = self._obstacles.table.shape[1]
        self._robot_time = _ROBOT_TIME + _BEAM_TIME * len(spec.laser.angles) + _OBSTACLE_TIME * obstacle_count

    def step_robots(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotArrays:
        robots = RobotArrays(self._initial_state.records, np.empty(self.num_envs, ROBOT), np.empty(self._ranges.shape))
        commands = np.ascontiguousarray(commands, dtype=float)
        arguments = self._constants, self._records, robots, commands, duration, self._obstacles.arrays
        parallel_if_long(step_block, self.num_envs, self._robot_time, *arguments)
        return robots

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `RobotState.render_camera`; there are no colours."""
        camera, poses, obstacles = self.spec.robot.camera, robot_state.pose, robot_state.dynamic_obstacles
        forward, sideways, lens_height = camera.position
        lens_poses, cos, sin = np.array(poses, dtype=float), np.cos(poses[:, 2]), np.sin(poses[:, 2])
        lens_poses[:, 0] += forward * cos - sideways * sin
        lens_poses[:, 1] += forward * sin + sideways * cos
        # PyBullet's renderer takes a pixel's colour and depth from its lower left corner, and not from its middle.
        half_height = math.tan(camera.field_of_view / 2)  # [m] half height of the image at a depth of 1 m
        leftward = half_height * (width - 2.0 * np.arange(width)) / height
        upward = half_height * (height - 2.0 * np.arange(1, height + 1)) / height
        cosines = 1.0 / np.hypot(1.0, leftward)  # of the angles between the rays and the optical axis
        # Walls and dynamic obstacles have the same height, so that one planar ray is enough for a column of pixels.
        rays, distances = (cosines, cosines * leftward), np.empty((len(lens_poses), width))
        cast_many(lens_poses, robot_state.initial_state.world, rays, self.spec.spatial_index, distances)
        if obstacles is not None:
            cast_at_outlines(lens_poses, rays, obstacles, distances)
        images = np.empty((len(lens_poses), height, width), dtype=np.float32)
        _fill_images(distances * cosines, upward, lens_height, camera.range[1], images)
        return None, images


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
            rise, wall_end, floor_depth = upward[row], np.inf, np.inf
            if rise > 0.0:
                wall_end = (WALL_HEIGHT - lens_height) / rise  # beyond this depth the ray is above the walls
            elif rise < 0.0:
                wall_end = floor_depth = -lens_height / rise  # there the ray meets the floor
            for column in range(wall_depths.shape[1]):
                wall_depth = wall_depths[robot, column]
                depth = wall_depth if wall_depth <= wall_end else floor_depth
                images[robot, row, column] = depth if depth <= max_depth else np.inf
