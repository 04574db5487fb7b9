"""The kinematic simulator: closed-form integration of differential drives, for thousands of robots in compiled code.

Wheel speeds ramp to the commands, walls stop the base, and laser ranges are exact. `tests/simulation/test_kinematic.py`
compares the motion with PyBullet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.simulation.kinematic.motion import reset_robots, scan_robots, step_block
from tb2rl.simulation.kinematic.threads import parallel_for
from tb2rl.simulation.obstacles.dynamic_obstacles import SimulatedObstacles
from tb2rl.simulation.obstacles.outlines import cast_at_outlines
from tb2rl.simulation.odometry import integrate_odometry, is_odometry_exact, measure_arcs
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators, ResetGenerators, ResetStates
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.spatial_index import SpatialIndex
from tb2rl.worlds.world import WALL_HEIGHT

# Estimated duration [s] of a step in one thread: for each robot, for each of its beams, for each dynamic obstacle.
_ROBOT_TIME, _BEAM_TIME, _OBSTACLE_TIME = 0.25e-6, 4e-9, 2e-6
_THREAD_DELAY = 0.06e-3  # [s] from handing work to a sleeping thread until the thread starts
MIN_PARALLEL_TIME = 0.25e-3  # [s] shorter steps run in one thread, because waking the others costs 0.1 ms or more
_MAX_RESTORED_SPEED = 1e3  # [m/s] of a wheel in a restored state; a step at a higher speed could take for ever
_STATE_FIELDS = ("pose", "wheel_speeds", "stream", "bumped", "command", "acceleration")  # keys in `state`


# Motion of a robot, and its measurements of the last step.
ROBOT = np.dtype(
    [
        ("pose", "f8", 3),  # x [m], y [m], yaw [rad]
        ("wheel_speeds", "f8", 2),  # [m/s] of the left and the right rim
        ("stream", "u8", 2),  # random stream of the laser: its key, and the number of scans
        ("command", "f8", 2),  # v [m/s], w [rad/s]
        ("twist", "f8", 2),  # v [m/s], w [rad/s]
        ("arc", "f8", 2),  # distance driven [m] and turn [rad] in the step
        ("travelled", "f8"),  # [m] straight distance between the positions before and after the step
        ("acceleration", "f8"),  # [m/s^2] forward, mean of the step
        ("nearest_range", "f8"),  # [m] shortest range of the laser
        ("bumped", "?"),  # whether the base touched an obstacle
        ("nearest_is_dynamic", "?"),  # see `RobotState`
    ],
    align=True,
)


class Constants(NamedTuple):
    """Values for compiled code that never change."""

    spatial_index: SpatialIndex  # obstacles of all worlds
    beams: tuple[np.ndarray, np.ndarray]  # cosines and sines of the laser's beam directions, each of shape (beams,)
    laser_noise: float  # [m] standard deviation
    min_range: float  # [m]
    max_range: float  # [m]
    physics_step: float  # [s] duration of PyBullet's physics step, whose discretisation error the motion reproduces


class RobotArrays(NamedTuple):
    """All robots; compiled code changes the arrays in place."""

    initial_states: np.ndarray  # records of `spec.RECORD`, shape (num_envs,); only `reset_robots` changes them
    records: np.ndarray  # records of `ROBOT`, shape (num_envs,)
    ranges: np.ndarray  # [m] laser ranges, shape (num_envs, beams)


class KinematicSimulator:
    """Differential drives without slip, each in one of the worlds; see `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.num_envs, laser = spec, num_envs, spec.laser
        beams = np.cos(laser.angles), np.sin(laser.angles)
        physics_step = 1.0 / (PHYSICS_RATE * spec.substeps)  # [s]
        values = float(laser.noise), float(laser.min_range), float(laser.max_range)
        self._constants = Constants(spec.spatial_index, beams, *values, physics_step)
        self._obstacles = SimulatedObstacles(spec, num_envs)
        obstacle_count = self._obstacles.table.shape[1]
        self._robot_time = _ROBOT_TIME + _BEAM_TIME * len(laser.angles) + _OBSTACLE_TIME * obstacle_count
        self._place_robots(InitialState.default(spec, num_envs), np.zeros(num_envs, dtype=np.uint64))

    def _place_robots(self, initial_state: InitialState, keys: np.ndarray) -> None:
        """Put all robots at their start poses, at rest, with stream keys (num_envs,) for their lasers."""
        self._initial_state, self._records = initial_state, np.zeros(self.num_envs, ROBOT)
        self._records["pose"], self._records["stream"][:, 0] = initial_state.pose, keys
        self._ranges = np.empty((self.num_envs, len(self.spec.laser.angles)))
        # None: odometry has no errors and equals the true poses.
        self._odometry = None if is_odometry_exact(initial_state.records) else initial_state.pose.copy()

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        self._place_robots(initial_state, _draw_keys(rng, self.num_envs))
        self._obstacles.table = self._obstacles.table.copy()  # earlier robot states refer to the old table
        self._obstacles.reset_at(np.arange(self.num_envs), initial_state)
        return self._scan_all()

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        if self.spec.has_dynamic_obstacles:
            self._obstacles.table = self._obstacles.table.copy()  # earlier robot states refer to the old table
        _, self._records, self._ranges = robots = self.step_robots(commands, duration)
        self.travelled = robots.records["travelled"]
        if self._odometry is not None:
            arcs = measure_arcs(robots.records["arc"], self._initial_state)
            self._odometry = integrate_odometry(self._odometry, arcs)
        return self._robot_state()

    def step_robots(self, commands: np.ndarray, duration: float) -> RobotArrays:
        """The robots after a control period, in new arrays; the dynamic obstacles move in place."""
        robots = RobotArrays(self._initial_state.records, np.empty(self.num_envs, ROBOT), np.empty(self._ranges.shape))
        commands = np.ascontiguousarray(commands, dtype=float)
        arguments = self._constants, self._records, robots, commands, duration, self._obstacles.arrays
        if self.num_envs * self._robot_time > MIN_PARALLEL_TIME:
            head_start = int(_THREAD_DELAY / self._robot_time)  # robots that this thread steps while the others wake up
            parallel_for(step_block, self.num_envs, head_start, *arguments)
        else:
            step_block(0, self.num_envs, *arguments)
        return robots

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        keys = None if rng is None else _draw_keys(rng, len(indices))
        self._obstacles.reset_at(indices, initial_state)
        reset_robots(indices, initial_state.records, keys, self._constants, self._robots, self._obstacles.arrays)
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not is_odometry_exact(initial_state.records):
            self._odometry = self._records["pose"].copy()
        # Made field by field: indexing the robot state of all environments would take four times as long.
        count = len(indices)
        zeros, zero_pairs, bumped = np.zeros(count), np.zeros((count, 2)), np.zeros(count, dtype=bool)
        motion = measured_motion = initial_state.pose, zero_pairs
        measured = self._ranges[indices], bumped, zero_pairs, zeros
        fields = *motion, *measured_motion, *measured, initial_state, self, *self._obstacle_fields(indices)
        nearest_range = self._records["nearest_range"][indices]
        return self._robot_state(), RobotState(*fields, nearest_range=nearest_range)

    def state(self) -> dict[str, Any]:
        """Motion, odometry, initial states and dynamic obstacles of all environments."""
        odometry = self._records["pose"] if self._odometry is None else self._odometry
        return {
            **{name: self._records[name].copy() for name in _STATE_FIELDS},
            "odometry": odometry.copy(),
            "initial_state": self._initial_state.table.copy(),
            "dynamic_obstacles": self._obstacles.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a `state`.

        Raises:
            ValueError: If a world does not exist, a robot is too fast, or the dynamic obstacles differ.
        """
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        if not (np.abs(state["wheel_speeds"]) < _MAX_RESTORED_SPEED).all():
            raise ValueError(f"wheel speeds must be below {_MAX_RESTORED_SPEED:g} m/s")
        self._obstacles.restore(state["dynamic_obstacles"], initial_state)
        self._place_robots(initial_state, state["stream"][:, 0])
        for name in _STATE_FIELDS:
            self._records[name] = state[name]
        exact = is_odometry_exact(initial_state.records) and (state["odometry"] == state["pose"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._scan_all()

    def close(self) -> None:
        """Nothing to free."""

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

    @property
    def _robots(self) -> RobotArrays:
        return RobotArrays(self._initial_state.records, self._records, self._ranges)

    def _scan_all(self) -> RobotState:
        """Measure at the present poses and wheel speeds."""
        scan_robots(np.arange(self.num_envs), self._constants, self._robots, self._obstacles.arrays)
        return self._robot_state()

    def _robot_state(self) -> RobotState:
        """Robot state of all environments."""
        records = self._records
        motion = measured_motion = records["pose"], records["twist"]
        if self._odometry is not None:
            measured_motion = self._odometry, measure_arcs(records["twist"], self._initial_state)
        measured = self._ranges, records["bumped"], records["command"], records["acceleration"]
        fields = *motion, *measured_motion, *measured, self._initial_state, self, *self._obstacle_fields()
        return RobotState(*fields, nearest_range=records["nearest_range"])

    def _obstacle_fields(self, indices: np.ndarray | slice = slice(None)) -> tuple[Any, ...]:
        """Fields `dynamic_obstacles` and `nearest_is_dynamic` of `RobotState` for some environments."""
        if not self.spec.has_dynamic_obstacles:
            return ()
        return self._obstacles.outlines[indices], self._records["nearest_is_dynamic"][indices]


def _draw_keys(rng: Generators, count: int) -> np.ndarray:
    """Draw the keys of random streams for `count` environments, uint64."""
    if isinstance(rng, np.random.Generator):
        return rng.integers(2**64, size=count, dtype=np.uint64)
    return np.array([generator.integers(2**64, dtype=np.uint64) for generator in rng])


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
