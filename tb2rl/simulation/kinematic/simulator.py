"""The kinematic simulator: closed-form integration of differential drives, for thousands of robots in compiled code.

Wheel speeds ramp to the commands, walls stop the base, and laser ranges are exact. `tests/simulation/test_kinematic.py`
compares the motion with PyBullet.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tb2rl.simulation.kinematic.depth import depth_images
from tb2rl.simulation.kinematic.motion import reset_robots, scan_robots, step_block
from tb2rl.simulation.kinematic.threads import parallel_for
from tb2rl.simulation.obstacles.dynamic_obstacles import SimulatedObstacles
from tb2rl.simulation.odometry import integrate_odometry, is_exact, measure_arcs
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators, ResetGenerators, StatesAfterReset
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec
from tb2rl.worlds.spatial_index import SpatialIndex

# Estimated duration [s] of a step in one thread: for each robot, for each of its beams, for each dynamic obstacle.
_ROBOT_TIME, _BEAM_TIME, _OBSTACLE_TIME = 0.25e-6, 4e-9, 2e-6
_THREAD_DELAY = 0.06e-3  # [s] from handing work to a sleeping thread until the thread starts
MIN_PARALLEL_TIME = 0.25e-3  # [s] shorter steps run in one thread, because waking the others costs 0.1 ms or more
_MAX_RESTORED_SPEED = 1e3  # [m/s] of a wheel in a restored state; a step at a higher speed could take for ever
_STATE_ARRAYS = ("poses", "wheel_speeds", "streams", "bumped", "commands", "accelerations")  # keys in `state`


class Constants(NamedTuple):
    """Values that no step changes, for compiled code."""

    initial_states: np.ndarray  # records of the initial states, see `spec.RECORD`, shape (num_envs,)
    spatial_index: SpatialIndex  # obstacles of all worlds
    beams: tuple[np.ndarray, np.ndarray]  # cosines and sines of the laser's beam directions, each of shape (beams,)
    laser_noise: float  # [m] standard deviation
    min_range: float  # [m]
    max_range: float  # [m]
    physics_step: float  # [s] duration of PyBullet's physics step, for the same discretisation error


class RobotArrays(NamedTuple):
    """Motion of all robots and measurements of the last step; compiled code changes the arrays in place."""

    poses: np.ndarray  # x [m], y [m], yaw [rad], shape (num_envs, 3)
    wheel_speeds: np.ndarray  # [m/s] of the left and the right rim, shape (num_envs, 2)
    streams: np.ndarray  # random stream of each laser: its key, and the number of scans; shape (num_envs, 2), uint64
    commands: np.ndarray  # v [m/s], w [rad/s], shape (num_envs, 2)
    bumped: np.ndarray  # whether the base touched an obstacle, shape (num_envs,)
    accelerations: np.ndarray  # [m/s^2] forward, mean of the step, shape (num_envs,)
    twists: np.ndarray  # v [m/s], w [rad/s], shape (num_envs, 2)
    arcs: np.ndarray  # distance driven [m] and turn [rad] in the step, shape (num_envs, 2)
    travelled: np.ndarray  # [m] straight distance between the positions before and after the step, shape (num_envs,)
    ranges: np.ndarray  # [m] laser ranges, shape (num_envs, beams)
    shortest_ranges: np.ndarray  # [m] shortest range of each robot, shape (num_envs,)
    nearest_is_dynamic: np.ndarray  # see `RobotState`, shape (num_envs,)

    @classmethod
    def at_rest(cls, poses: np.ndarray, keys: np.ndarray, beams: int) -> RobotArrays:
        """Make the arrays of robots at rest at poses (num_envs, 3), with stream keys (num_envs,) for the lasers."""
        count = len(poses)
        streams, (wheel_speeds, commands, twists, arcs) = np.stack([keys, 0 * keys], axis=1), np.zeros((4, count, 2))
        bumped, nearest_is_dynamic = np.zeros((2, count), dtype=bool)
        accelerations, travelled, shortest_ranges = np.zeros((3, count))
        motion = poses.copy(), wheel_speeds, streams, commands, bumped, accelerations, twists, arcs, travelled
        return cls(*motion, np.empty((count, beams)), shortest_ranges, nearest_is_dynamic)

    def for_step(self, commands: np.ndarray) -> RobotArrays:
        """Make new arrays for a step with these commands (num_envs, 2); robot states keep the present arrays."""
        poses, wheel_speeds, streams, _, *results = self
        commands = np.array(commands, dtype=float, order="C")  # a copy, because `reset_at` overwrites commands
        return RobotArrays(poses.copy(), wheel_speeds.copy(), streams, commands, *map(np.empty_like, results))


class KinematicSimulator:
    """Differential drives without slip, each in one of the worlds; see `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.num_envs = spec, num_envs
        self._beams = np.cos(spec.laser.angles), np.sin(spec.laser.angles)
        self._physics_step = 1.0 / (PHYSICS_RATE * spec.substeps)  # [s]
        self._obstacles = SimulatedObstacles(spec, num_envs)
        self._place_robots(InitialState.default(spec, num_envs), np.zeros(num_envs, dtype=np.uint64))

    def _place_robots(self, initial_state: InitialState, keys: np.ndarray) -> None:
        """Put all robots at their start poses, at rest, with stream keys (num_envs,) for their lasers."""
        self._initial_state = initial_state
        self.robots = RobotArrays.at_rest(initial_state.pose, keys, len(self._beams[0]))
        # None: odometry has no errors and equals the true poses.
        self._odometry = None if is_exact(initial_state) else initial_state.pose.copy()

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        self._place_robots(initial_state, _draw_keys(rng, self.num_envs))
        self._obstacles.table = self._obstacles.table.copy()  # earlier robot states keep the present table
        self._obstacles.reset_at(np.arange(self.num_envs), initial_state)
        return self._scan_all()

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        self.robots = robots = self.robots.for_step(commands)
        self._obstacles.table = self._obstacles.table.copy()
        self.step_robots(robots, duration)
        self.travelled = robots.travelled
        if self._odometry is not None:
            self._odometry = integrate_odometry(self._odometry, measure_arcs(robots.arcs, self._initial_state))
        return self._robot_state()

    def step_robots(self, robots: RobotArrays, duration: float) -> None:
        """Run the compiled part of `step`, which changes `robots` and the dynamic obstacles in place."""
        robot_time = _ROBOT_TIME + _BEAM_TIME * len(self._beams[0]) + _OBSTACLE_TIME * self._obstacles.table.shape[1]
        arguments = self._constants, robots, duration, self._obstacles.arrays
        if self.num_envs * robot_time > MIN_PARALLEL_TIME:
            parallel_for(step_block, self.num_envs, int(_THREAD_DELAY / robot_time), *arguments)
        else:
            step_block(0, self.num_envs, *arguments)

    def reset_at(
        self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None
    ) -> StatesAfterReset:
        robots = self.robots
        reset_robots(indices, initial_state.records, self._initial_state.records, robots)
        if rng is not None:
            robots.streams[indices, 0], robots.streams[indices, 1] = _draw_keys(rng, len(indices)), 0  # as in `reset`
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not is_exact(initial_state):
            self._odometry = robots.poses.copy()
        self._obstacles.reset_at(indices, initial_state)
        scan_robots(indices, self._constants, robots, self._obstacles.arrays)
        # Selecting these rows from the robot state of all environments would take four times as long.
        count = len(indices)
        zeros, zero_pairs, bumped = np.zeros(count), np.zeros((count, 2)), np.zeros(count, dtype=bool)
        motion = initial_state.pose, zero_pairs
        measured = robots.ranges[indices], bumped, zero_pairs, zeros
        reset_states = RobotState(*motion, *motion, *measured, initial_state, self, *self._obstacle_fields(indices))
        return self._robot_state(), reset_states

    def state(self) -> dict[str, Any]:
        """Motion, odometry, initial states and dynamic obstacles of all environments."""
        odometry = self.robots.poses if self._odometry is None else self._odometry
        return {
            **{name: getattr(self.robots, name).copy() for name in _STATE_ARRAYS},
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
        self._place_robots(initial_state, state["streams"][:, 0])
        for name in _STATE_ARRAYS:
            getattr(self.robots, name)[:] = state[name]
        exact = is_exact(initial_state) and (state["odometry"] == state["poses"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._scan_all()

    def close(self) -> None:
        """Nothing to free."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `RobotState.render_camera`; there are no colours."""
        return None, depth_images(robot_state, self.spec.robot.camera, self.spec.spatial_index, width, height)

    @property
    def _constants(self) -> Constants:
        # Not an attribute, because a copy of the simulator would copy `records`, which are a view, without their table.
        laser, records = self.spec.laser, self._initial_state.records
        limits = float(laser.noise), float(laser.min_range), float(laser.max_range)
        return Constants(records, self.spec.spatial_index, self._beams, *limits, self._physics_step)

    def _scan_all(self) -> RobotState:
        """Measure at the present poses and wheel speeds."""
        robots = self.robots
        scan_robots(np.arange(self.num_envs), self._constants, robots, self._obstacles.arrays)
        robots.twists[:, 0] = robots.wheel_speeds.mean(axis=1)
        robots.twists[:, 1] = (
            np.diff(robots.wheel_speeds, axis=1)[:, 0] / self._initial_state.records["wheel_separation"]
        )
        return self._robot_state()

    def _robot_state(self) -> RobotState:
        """Robot state of all environments."""
        robots = self.robots
        motion = measured_motion = robots.poses, robots.twists
        if self._odometry is not None:
            measured_motion = self._odometry, measure_arcs(robots.twists, self._initial_state)
        measured = robots.ranges, robots.bumped, robots.commands, robots.accelerations
        fields = *motion, *measured_motion, *measured, self._initial_state, self, *self._obstacle_fields()
        return RobotState(*fields, nearest_range=robots.shortest_ranges)

    def _obstacle_fields(self, indices: np.ndarray | slice = slice(None)) -> tuple[Any, ...]:
        """Fields `dynamic_obstacles` and `nearest_is_dynamic` of `RobotState` for some environments."""
        if not self.spec.has_dynamic_obstacles:
            return ()
        return self._obstacles.outlines[indices], self.robots.nearest_is_dynamic[indices]


def _draw_keys(rng: Generators, count: int) -> np.ndarray:
    """Draw the keys of random streams for `count` environments, uint64."""
    if isinstance(rng, np.random.Generator):
        return rng.integers(2**64, size=count, dtype=np.uint64)
    return np.array([generator.integers(2**64, dtype=np.uint64) for generator in rng])
