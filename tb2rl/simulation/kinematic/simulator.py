"""The fast twin of the physics: robots that move along exact arcs, thousands of them together in compiled code.

What is simulated is what decides where a differential drive goes on a floor: two wheels whose speeds ramp to what they
are told, the arcs between, walls that stop the base, and the exact laser. `tests/simulation/test_kinematic.py` holds
the twin against the robot in PyBullet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, WHEEL_SEPARATION
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.kinematic.depth import depth_images
from tb2rl.simulation.kinematic.stepping import begin_some, sense_some, step_block, step_block_among
from tb2rl.simulation.kinematic.threads import parallel_for
from tb2rl.simulation.obstacles.dynamic_obstacles import dynamic_obstacles_of
from tb2rl.simulation.odometry import as_counted, integrate_odometry, is_exact
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import ASSUMED_SEPARATION, PHYSICS_RATE, WHEEL, SimulationSpec
from tb2rl.worlds.index import join

ROBOT, BEAM = 0.25e-6, 4e-9  # [s] what a step costs a thread, for each robot and for each of its beams
MOVER = 2e-6  # [s] and for each mover
WAKING = 0.06e-3  # [s] until another thread has begun
WORTH_THREADS = 0.25e-3  # [s] of work; to wake a thread costs 0.1 ms, and more on a busy machine


class KinematicSimulator:
    """N robots on exact arcs, each in one of the worlds; see `tb2rl.simulation.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of robots.
    """

    travelled: np.ndarray

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.laser, self.num_envs = spec, spec.laser, num_envs
        laser, worlds = spec.laser, spec.worlds
        self._index = join([world.index for world in worlds])
        self._beams = np.stack([np.cos(laser.angles), np.sin(laser.angles)])
        self._physics_step = 1.0 / (PHYSICS_RATE * spec.substeps)  # [s]
        self._limits = np.array([laser.noise, laser.min_range, laser.max_range])
        self._initial_state = InitialState.default(spec, num_envs)
        self._poses, self._wheel_speeds = self._initial_state.pose.copy(), np.zeros((num_envs, 2))
        self._streams = np.zeros((num_envs, 2), dtype=np.uint64)  # key of each, and the number of its scans
        self._bumped = np.zeros(num_envs, dtype=bool)
        self._twists, self._commands = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))
        self._accelerations = np.zeros(num_envs)
        self._odometry: np.ndarray | None = None  # None: without errors, so it is the true pose
        self._dynamic_obstacles = dynamic_obstacles_of(spec, num_envs)
        self._nearest_is_dynamic = np.zeros(num_envs, dtype=bool)

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        self._initial_state = initial_state
        self._poses, self._wheel_speeds = initial_state.pose.copy(), np.zeros((self.num_envs, 2))
        self._bumped = np.zeros(self.num_envs, dtype=bool)
        self._commands, self._accelerations = np.zeros((self.num_envs, 2)), np.zeros(self.num_envs)
        self._odometry = None if is_exact(initial_state) else self._poses.copy()
        self._streams = np.zeros((self.num_envs, 2), dtype=np.uint64)
        self._streams[:, 0] = _keys(rng, self.num_envs)
        self._renew_obstacles()
        self._start_obstacles(np.arange(self.num_envs), initial_state)
        return self._look()

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        poses, wheel_speeds = self._poses.copy(), self._wheel_speeds.copy()  # earlier robot states keep their arrays
        twists, ways = np.empty_like(wheel_speeds), np.empty_like(wheel_speeds)
        travelled, accelerations = np.empty(self.num_envs), np.empty(self.num_envs)
        bumped, ranges = np.empty(self.num_envs, dtype=bool), np.empty((self.num_envs, self._beams.shape[1]))
        nearest = np.empty(self.num_envs)
        commands = np.array(commands, dtype=float, order="C")  # a copy, because an episode's end overwrites it
        self._renew_obstacles()
        self.advance(
            poses, wheel_speeds, commands, duration, twists, ways, travelled, accelerations, bumped, nearest, ranges
        )
        self._poses, self._wheel_speeds, self._bumped, self.travelled = poses, wheel_speeds, bumped, travelled
        self._twists, self._commands, self._accelerations = twists, commands, accelerations
        if self._odometry is not None:
            self._odometry = integrate_odometry(self._odometry, as_counted(ways, self._initial_state))
        return self._robot_state(ranges, nearest)

    def advance(
        self,
        poses: np.ndarray,
        wheel_speeds: np.ndarray,
        commands: np.ndarray,
        duration: float,
        twists: np.ndarray,
        ways: np.ndarray,
        moved: np.ndarray,
        accelerations: np.ndarray,
        bumped: np.ndarray,
        nearest: np.ndarray,
        ranges: np.ndarray,
    ) -> None:
        """The compiled work of a step alone, into the caller's arrays (see `stepping.step_block`).

        For `step` and the benchmark. The movers are not the caller's: they are where they were, and go on from there.
        """
        data: tuple[Any, ...] = (
            poses, wheel_speeds, commands, duration, self._physics_step, self._initial_state.table, *self._index,
            self._beams,
            self._limits, self._streams, twists, ways, moved, accelerations, bumped, nearest, ranges,
        )  # fmt: skip
        cost, work = ROBOT + BEAM * ranges.shape[1], step_block
        if self._dynamic_obstacles is not None:
            work = step_block_among
            data += (
                self._dynamic_obstacles.table,
                self._dynamic_obstacles.walks,
                self._dynamic_obstacles.routes,
                self._nearest_is_dynamic,
            )
            cost += MOVER * self._dynamic_obstacles.table.shape[1]
        if self.num_envs * cost > WORTH_THREADS:
            parallel_for(work, self.num_envs, int(WAKING / cost), *data)
        else:
            work(0, self.num_envs, *data)

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        robot_state: RobotState,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> tuple[RobotState, RobotState]:
        if rng is not None:
            self._streams[indices, 0] = _keys(rng, len(indices))
        arrays = self._initial_state.table, self._poses, self._wheel_speeds, self._streams
        motion = self._twists, self._commands, self._accelerations, self._bumped
        begin_some(indices, initial_state.table, *arrays, *motion)
        if rng is not None:
            self._streams[indices, 1] = 0  # as after `reset`
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not is_exact(initial_state):
            self._odometry = self._poses.copy()
        self._start_obstacles(indices, initial_state)
        self._sense(indices, robot_state.ranges)
        # To cut it out of the state of all, array by array, would take four times as long. They all stand.
        count = len(indices)
        still, untouched, steady = np.zeros((count, 2)), np.zeros(count, dtype=bool), np.zeros(count)
        truth, ranges = (initial_state.pose, still), robot_state.ranges[indices]
        obstacles = self._seen(indices)
        first = RobotState(*truth, *truth, ranges, untouched, still, steady, initial_state, self, *obstacles)
        return self._robot_state(robot_state.ranges), first

    def state(self) -> dict[str, Any]:
        """Poses, rim speeds, random streams and starts of all robots, and what moves beside them."""
        now = {"poses": self._poses, "rims": self._wheel_speeds, "streams": self._streams, "bumped": self._bumped}
        now |= {"commands": self._commands, "accelerations": self._accelerations}
        now["odometry"] = self._poses if self._odometry is None else self._odometry
        nearest_is_dynamic = (
            {} if self._dynamic_obstacles is None else {"dynamic_obstacles": self._dynamic_obstacles.state()}
        )
        return {
            **{name: array.copy() for name, array in now.items()},
            "initial_state": self._initial_state.table.copy(),
            **nearest_is_dynamic,
        }

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Go on from a state.

        Raises:
            ValueError: If it names a world that is not there, robots so fast that a step would not end, or
                other movers.
        """
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        table, robot = initial_state.table, initial_state.parameters
        reach = 0.5 * robot[:, WHEEL_SEPARATION] * table[:, ASSUMED_SEPARATION] * robot[:, MAX_TURN_RATE]
        fastest = table[:, WHEEL] * (robot[:, MAX_SPEED] + reach)
        if not (np.abs(state["rims"]) <= 1.01 * fastest[:, None]).all():
            raise ValueError("the wheels turn faster than they can")
        if self._dynamic_obstacles is not None:
            self._dynamic_obstacles.restore(state["dynamic_obstacles"], initial_state)
            self._renew_obstacles()
        self._initial_state = initial_state
        self._poses, self._wheel_speeds = state["poses"].copy(), state["rims"].copy()
        self._streams, self._bumped = state["streams"].copy(), state["bumped"].copy()
        self._commands, self._accelerations = state["commands"].copy(), state["accelerations"].copy()
        exact = is_exact(initial_state) and (state["odometry"] == state["poses"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._look()

    def close(self) -> None:
        """Nothing to free."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `RobotState.render_camera`; there are no colours."""
        camera, worlds = self.spec.robot.camera, robot_state.initial_state.world
        obstacles = robot_state.dynamic_obstacles
        return None, depth_images(camera, robot_state.pose, worlds, self._index, width, height, obstacles)

    def _look(self) -> RobotState:
        """The robot state of the present poses."""
        ranges = np.empty((self.num_envs, self._beams.shape[1]))
        self._sense(np.arange(self.num_envs), ranges)
        separation = self._initial_state.parameters[:, WHEEL_SEPARATION]
        speeds = self._wheel_speeds.mean(axis=1), np.diff(self._wheel_speeds, axis=1)[:, 0] / separation
        self._twists = np.stack(speeds, axis=1)
        return self._robot_state(ranges)

    def _robot_state(self, ranges: np.ndarray, nearest: np.ndarray | None = None) -> RobotState:
        """With the laser's ranges (num_envs, beams); wheels do not slip here, so they tell the true twist."""
        truth = counted = self._poses, self._twists
        if self._odometry is not None:
            counted = self._odometry, as_counted(self._twists, self._initial_state)
        rest = self._bumped, self._commands, self._accelerations, self._initial_state, self, *self._seen()
        return RobotState(*truth, *counted, ranges, *rest, nearest=nearest)  # type: ignore[arg-type]

    def _sense(self, indices: np.ndarray, ranges: np.ndarray) -> None:
        laser = self._beams, self._limits, self._streams
        obstacles = () if self._dynamic_obstacles is None else (self._dynamic_obstacles.table, self._nearest_is_dynamic)
        sense_some(indices, self._poses, self._initial_state.table, *self._index, *laser, ranges, *obstacles)

    def _seen(self, indices: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, ...]:
        """The dynamic obstacles in the state of some environments, see `RobotState`."""
        obstacles = self._dynamic_obstacles
        return () if obstacles is None else (obstacles.outlines[indices], self._nearest_is_dynamic[indices])

    def _renew_obstacles(self) -> None:
        """Take new arrays for the next state, because earlier robot states keep theirs."""
        if self._dynamic_obstacles is not None:
            self._dynamic_obstacles.table = self._dynamic_obstacles.table.copy()
            self._nearest_is_dynamic = np.zeros(self.num_envs, dtype=bool)

    def _start_obstacles(self, indices: np.ndarray, initial_state: InitialState) -> None:
        if self._dynamic_obstacles is not None:
            self._dynamic_obstacles.begin(indices, initial_state, self._index, initial_state.world.astype(int))


def _keys(rng: Generators, count: int) -> np.ndarray:
    """Keys of the streams of so many environments, uint64."""
    if isinstance(rng, np.random.Generator):
        return rng.integers(2**64, size=count, dtype=np.uint64)
    return np.array([each.integers(2**64, dtype=np.uint64) for each in rng])
