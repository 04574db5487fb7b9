"""The kinematic simulator: robots on exact arcs, thousands of them together in compiled code.

It simulates what decides where a differential drive goes on a floor: two wheels whose speeds ramp to the commands, the
arcs between, walls that stop the base, and the exact laser. `tests/simulation/test_kinematic.py` compares it with
PyBullet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.kinematic.depth import depth_images
from tb2rl.simulation.kinematic.records import Constants, Measured, Motion
from tb2rl.simulation.kinematic.stepping import reset_some, scan_some, step_block
from tb2rl.simulation.kinematic.threads import parallel_for
from tb2rl.simulation.obstacles.dynamic_obstacles import make_dynamic_obstacles
from tb2rl.simulation.obstacles.records import ObstacleArrays
from tb2rl.simulation.odometry import encoder_counts, integrate_odometry, is_exact
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import PHYSICS_RATE, SimulationSpec
from tb2rl.worlds.index import join

# Cost of a step in one thread [s]: of each robot, and of each of its beams and dynamic obstacles.
_ROBOT, _BEAM, _OBSTACLE = 0.25e-6, 4e-9, 2e-6
_WAKING = 0.06e-3  # [s] until another thread has begun
WORTH_THREADS = 0.25e-3  # [s] of work; to wake a thread costs 0.1 ms, and more on a busy machine


class KinematicSimulator:
    """Robots on exact arcs, each in one of the worlds; see `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
    """

    travelled: np.ndarray

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.laser, self.num_envs = spec, spec.laser, num_envs
        self._index = join([world.index for world in spec.worlds])
        self._beams = np.cos(spec.laser.angles), np.sin(spec.laser.angles)
        self._physics_step = 1.0 / (PHYSICS_RATE * spec.substeps)  # [s]
        self._obstacles = make_dynamic_obstacles(spec, num_envs)
        self._nearest_is_dynamic = np.zeros(num_envs, dtype=bool)
        self._begin(InitialState.default(spec, num_envs), np.zeros(num_envs, dtype=np.uint64))

    def _begin(self, initial_state: InitialState, keys: np.ndarray) -> None:
        """Put all robots at their start poses, at rest."""
        self._initial_state, num_envs = initial_state, self.num_envs
        self._motion = Motion(
            poses=initial_state.pose.copy(),
            wheel_speeds=np.zeros((num_envs, 2)),
            streams=np.stack([keys, np.zeros_like(keys)], axis=1),
            bumped=np.zeros(num_envs, dtype=bool),
            commands=np.zeros((num_envs, 2)),
            accelerations=np.zeros(num_envs),
            twists=np.zeros((num_envs, 2)),
        )
        # None: without errors, so it is the true pose.
        self._odometry = None if is_exact(initial_state) else self._motion.poses.copy()

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        self._begin(initial_state, _keys(rng, self.num_envs))
        self._copy_obstacles()
        self._reset_obstacles(np.arange(self.num_envs), initial_state)
        return self._scan_all()

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        last, num_envs = self._motion, self.num_envs
        self._motion = Motion(  # earlier robot states keep their arrays
            poses=last.poses.copy(),
            wheel_speeds=last.wheel_speeds.copy(),
            streams=last.streams,
            bumped=np.empty(num_envs, dtype=bool),
            commands=np.array(commands, dtype=float, order="C"),  # a copy, because an episode's end overwrites it
            accelerations=np.empty(num_envs),
            twists=np.empty((num_envs, 2)),
        )
        self._copy_obstacles()
        measured = self.step_arrays(self._motion, duration)
        self.travelled = measured.travelled
        if self._odometry is not None:
            self._odometry = integrate_odometry(self._odometry, encoder_counts(measured.arcs, self._initial_state))
        return self._robot_state(measured.ranges, measured.nearest)

    def step_arrays(self, motion: Motion, duration: float) -> Measured:
        """The compiled work of a step alone: `motion` changes in place, and so do the dynamic obstacles."""
        beams, num_envs = len(self._beams[0]), self.num_envs
        measured = Measured(
            arcs=np.empty((num_envs, 2)),
            travelled=np.empty(num_envs),
            ranges=np.empty((num_envs, beams)),
            nearest=np.empty(num_envs),
            nearest_is_dynamic=self._nearest_is_dynamic,
        )
        cost = _ROBOT + _BEAM * beams
        if self._obstacles is not None:
            cost += _OBSTACLE * self._obstacles.table.shape[1]
        arguments = self._constants, motion, duration, measured, self._obstacle_arrays
        if num_envs * cost > WORTH_THREADS:
            parallel_for(step_block, num_envs, int(_WAKING / cost), *arguments)
        else:
            step_block(0, num_envs, *arguments)
        return measured

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        robot_state: RobotState,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> tuple[RobotState, RobotState]:
        if rng is not None:
            self._motion.streams[indices, 0] = _keys(rng, len(indices))
        reset_some(indices, initial_state.rows, self._initial_state.rows, self._motion)
        if rng is not None:
            self._motion.streams[indices, 1] = 0  # as after `reset`
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not is_exact(initial_state):
            self._odometry = self._motion.poses.copy()
        self._reset_obstacles(indices, initial_state)
        self._scan(indices, robot_state.ranges)
        # Built directly, because selecting it from the state of all, array by array, would take four times as long.
        count = len(indices)
        still, untouched, steady = np.zeros((count, 2)), np.zeros(count, dtype=bool), np.zeros(count)
        truth, ranges = (initial_state.pose, still), robot_state.ranges[indices]
        obstacles = self._seen(indices)
        first = RobotState(*truth, *truth, ranges, untouched, still, steady, initial_state, self, *obstacles)
        return self._robot_state(robot_state.ranges), first

    def state(self) -> dict[str, Any]:
        """Motion, odometry, initial states and dynamic obstacles of all environments."""
        motion = {name: array.copy() for name, array in self._motion._asdict().items() if name != "twists"}
        odometry = self._motion.poses if self._odometry is None else self._odometry
        obstacles = {} if self._obstacles is None else {"dynamic_obstacles": self._obstacles.state()}
        return {**motion, "odometry": odometry.copy(), "initial_state": self._initial_state.table.copy(), **obstacles}

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a `state`.

        Raises:
            ValueError: If a world does not exist, a robot is too fast, or there are other dynamic obstacles.
        """
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        rows = initial_state.rows
        reach = 0.5 * rows["wheel_separation"] * rows["assumed_separation"] * rows["max_turn_rate"]
        max_wheel_speed = rows["wheel_radius"] * (rows["max_speed"] + reach)
        if not (np.abs(state["wheel_speeds"]) <= 1.01 * max_wheel_speed[:, None]).all():
            raise ValueError("the wheels turn faster than they can")
        if self._obstacles is not None:
            self._obstacles.restore(state["dynamic_obstacles"], initial_state)
            self._copy_obstacles()
        self._initial_state = initial_state
        copies = {name: state[name].copy() for name in Motion._fields if name != "twists"}
        self._motion = Motion(**copies, twists=np.zeros((self.num_envs, 2)))
        exact = is_exact(initial_state) and (state["odometry"] == state["poses"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._scan_all()

    def close(self) -> None:
        """Nothing to free."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `RobotState.render_camera`; there are no colours."""
        camera, worlds = self.spec.robot.camera, robot_state.initial_state.world
        obstacles = robot_state.dynamic_obstacles
        return None, depth_images(camera, robot_state.pose, worlds, self._index, (height, width), obstacles)

    @property
    def _constants(self) -> Constants:
        laser, initial = self.laser, self._initial_state.rows
        limits = float(laser.noise), float(laser.min_range), float(laser.max_range)
        return Constants(initial, self._index, self._beams, *limits, self._physics_step)

    @property
    def _obstacle_arrays(self) -> ObstacleArrays | None:
        return None if self._obstacles is None else self._obstacles.arrays

    def _scan_all(self) -> RobotState:
        """The robot state of the present poses and wheel speeds."""
        ranges = np.empty((self.num_envs, len(self._beams[0])))
        self._scan(np.arange(self.num_envs), ranges)
        speeds = self._motion.wheel_speeds
        self._motion.twists[:, 0] = speeds.mean(axis=1)
        self._motion.twists[:, 1] = np.diff(speeds, axis=1)[:, 0] / self._initial_state.rows["wheel_separation"]
        return self._robot_state(ranges)

    def _scan(self, indices: np.ndarray, ranges: np.ndarray) -> None:
        arrays = self._constants, self._motion, ranges, self._nearest_is_dynamic, self._obstacle_arrays
        scan_some(indices, *arrays)

    def _robot_state(self, ranges: np.ndarray, nearest: np.ndarray | None = None) -> RobotState:
        """With the laser's ranges (num_envs, beams); the wheels do not slip, so they tell the true twist."""
        motion = self._motion
        truth = counted = motion.poses, motion.twists
        if self._odometry is not None:
            counted = self._odometry, encoder_counts(motion.twists, self._initial_state)
        rest = motion.bumped, motion.commands, motion.accelerations, self._initial_state, self, *self._seen()
        return RobotState(*truth, *counted, ranges, *rest, nearest=nearest)  # type: ignore[arg-type]

    def _seen(self, indices: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, ...]:
        """The dynamic obstacles in the state of some environments, see `RobotState`."""
        if self._obstacles is None:
            return ()
        return self._obstacles.outlines[indices], self._nearest_is_dynamic[indices]

    def _copy_obstacles(self) -> None:
        """Take new arrays for the next state, because earlier robot states keep theirs."""
        if self._obstacles is not None:
            self._obstacles.table = self._obstacles.table.copy()
            self._nearest_is_dynamic = np.zeros(self.num_envs, dtype=bool)

    def _reset_obstacles(self, indices: np.ndarray, initial_state: InitialState) -> None:
        if self._obstacles is not None:
            self._obstacles.reset_at(indices, initial_state, self._index, initial_state.world.astype(int))


def _keys(rng: Generators, count: int) -> np.ndarray:
    """Keys of random streams for so many environments, uint64."""
    if isinstance(rng, np.random.Generator):
        return rng.integers(2**64, size=count, dtype=np.uint64)
    return np.array([each.integers(2**64, dtype=np.uint64) for each in rng])
