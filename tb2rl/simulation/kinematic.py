"""The fast twin of the physics: robots that move along exact arcs, thousands of them together in compiled code.

What is simulated is what decides where a differential drive goes on a floor: two wheels whose speeds ramp to what they
are told, the arcs between, walls that stop the base, and the exact laser. `tests/simulation/test_kinematic.py` holds
the twin against the robot in PyBullet.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, WHEEL_SEPARATION
from tb2rl.simulation.depth import depth_images
from tb2rl.simulation.dynamic_obstacles import dynamic_obstacles_of
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.odometry import as_counted, integrate_odometry, is_exact
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import ASSUMED_SEPARATION, PHYSICS_RATE, WHEEL, SimulationSpec
from tb2rl.simulation.stepping import begin_some, sense_some, step_block, step_block_among
from tb2rl.simulation.threads import parallel_for
from tb2rl.worlds.index import join

ROBOT, BEAM = 0.25e-6, 4e-9  # [s] what a step costs a thread, for each robot and for each of its beams
MOVER = 2e-6  # [s] and for each mover
WAKING = 0.06e-3  # [s] until another thread has begun
WORTH_THREADS = 0.25e-3  # [s] of work; to wake a thread costs 0.1 ms, and more on a busy machine


class KinematicSimulation:
    """N robots that do not meet, each in one of the worlds.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: How many.

    Attributes:
        moved: How far from where it was the last step took each robot [m], shape (num_envs,).
    """

    moved: np.ndarray

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.laser, self.num_envs = spec, spec.laser, num_envs
        laser, worlds = spec.laser, spec.worlds
        self._index = join([world.index for world in worlds])
        self._beams = np.stack([np.cos(laser.angles), np.sin(laser.angles)])
        self._physics_step = 1.0 / (PHYSICS_RATE * spec.substeps)  # [s]
        self._limits = np.array([laser.noise, laser.min_range, laser.max_range])
        self._initial_state = InitialState.default(spec, num_envs)
        self._poses, self._wheel_speeds = self._initial_state.pose.copy(), np.zeros((num_envs, 2))
        self._streams = np.zeros((num_envs, 2), dtype=np.uint64)  # key of each, and how often it has read
        self._bumped = np.zeros(num_envs, dtype=bool)
        self._twists, self._commands = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))
        self._accelerations = np.zeros(num_envs)
        self._odometry: np.ndarray | None = None  # None: the wheels are what they should be, so it is the truth
        self._dynamic_obstacles = dynamic_obstacles_of(spec, num_envs)
        self._nearest_is_dynamic = np.zeros(num_envs, dtype=bool)

    def reset(self, initial_state: InitialState, rng: np.random.Generator) -> RobotState:
        self._initial_state = initial_state
        self._poses, self._wheel_speeds = initial_state.pose.copy(), np.zeros((self.num_envs, 2))
        self._bumped = np.zeros(self.num_envs, dtype=bool)
        self._commands, self._accelerations = np.zeros((self.num_envs, 2)), np.zeros(self.num_envs)
        self._odometry = None if is_exact(initial_state) else self._poses.copy()
        self._streams = np.zeros((self.num_envs, 2), dtype=np.uint64)
        self._streams[:, 0] = rng.integers(2**64, size=self.num_envs, dtype=np.uint64)
        self._renew_movers()
        self._begin_movers(np.arange(self.num_envs), initial_state)
        return self._look()

    def step(self, commands: np.ndarray, duration: float) -> RobotState:
        poses, wheel_speeds = self._poses.copy(), self._wheel_speeds.copy()  # readings keep what they show
        twists, ways = np.empty_like(wheel_speeds), np.empty_like(wheel_speeds)
        moved, accelerations = np.empty(self.num_envs), np.empty(self.num_envs)
        bumped, ranges = np.empty(self.num_envs, dtype=bool), np.empty((self.num_envs, self._beams.shape[1]))
        nearest = np.empty(self.num_envs)
        commands = np.array(commands, dtype=float, order="C")  # a copy: an episode that ends overwrites it
        self._renew_movers()
        self.advance(
            poses, wheel_speeds, commands, duration, twists, ways, moved, accelerations, bumped, nearest, ranges
        )
        self._poses, self._wheel_speeds, self._bumped, self.moved = poses, wheel_speeds, bumped, moved
        self._twists, self._commands, self._accelerations = twists, commands, accelerations
        if self._odometry is not None:
            self._odometry = integrate_odometry(self._odometry, as_counted(ways, self._initial_state))
        robot_state = self._reading(ranges)
        vars(robot_state)["nearest"] = nearest  # found on the way, while the ranges were at hand
        return robot_state

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

    def restart(
        self, indices: np.ndarray, initial_state: InitialState, robot_state: RobotState
    ) -> tuple[RobotState, RobotState]:
        """Begin new episodes of the robots with indices `robots` (n,), and write them into the last reading.

        Args:
            indices: Shape (n,).
            start: One row for each of them.
            robot_state: The last one; its arrays are changed in place.

        Returns:
            The reading of all robots, and that of those which begin, n rows.
        """
        state = self._initial_state.table, self._poses, self._wheel_speeds, self._streams
        told = self._twists, self._commands, self._accelerations, self._bumped
        begin_some(indices, initial_state.table, *state, *told)
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not is_exact(initial_state):
            self._odometry = self._poses.copy()
        self._begin_movers(indices, initial_state)
        self._sense(indices, robot_state.ranges)
        # Cut out of the reading of all, array by array, it would take four times as long. They all stand.
        still, untouched, steady = (
            np.zeros((len(indices), 2)),
            np.zeros(len(indices), dtype=bool),
            np.zeros(len(indices)),
        )
        truth, ranges = (initial_state.pose, still), robot_state.ranges[indices]
        first = RobotState(*truth, *truth, ranges, untouched, still, steady, initial_state, self, *self._seen(indices))
        return self._reading(robot_state.ranges), first

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
            self._renew_movers()
        self._initial_state = initial_state
        self._poses, self._wheel_speeds = state["poses"].copy(), state["rims"].copy()
        self._streams, self._bumped = state["streams"].copy(), state["bumped"].copy()
        self._commands, self._accelerations = state["commands"].copy(), state["accelerations"].copy()
        exact = is_exact(initial_state) and (state["odometry"] == state["poses"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._look()

    def close(self) -> None:
        """Nothing to free."""

    def _look(self) -> RobotState:
        """What the robots read where they are now."""
        ranges = np.empty((self.num_envs, self._beams.shape[1]))
        self._sense(np.arange(self.num_envs), ranges)
        separation = self._initial_state.parameters[:, WHEEL_SEPARATION]
        speeds = self._wheel_speeds.mean(axis=1), np.diff(self._wheel_speeds, axis=1)[:, 0] / separation
        self._twists = np.stack(speeds, axis=1)
        return self._reading(ranges)

    def _reading(self, ranges: np.ndarray) -> RobotState:
        """With the laser's ranges (num_envs, beams): the wheels do not slip."""
        truth = counted = self._poses, self._twists
        if self._odometry is not None:
            counted = self._odometry, as_counted(self._twists, self._initial_state)
        told = self._commands, self._accelerations
        return RobotState(*truth, *counted, ranges, self._bumped, *told, self._initial_state, self, *self._seen())

    def look(self, robot_state: RobotState, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `RobotState.look`; the twin has no colours."""
        camera = self.spec.robot.camera
        return None, depth_images(
            camera,
            robot_state.pose,
            robot_state.initial_state.world,
            self._index,
            width,
            height,
            robot_state.dynamic_obstacles,
        )

    def _sense(self, indices: np.ndarray, ranges: np.ndarray) -> None:
        laser = self._beams, self._limits, self._streams
        nearest_is_dynamic = (
            () if self._dynamic_obstacles is None else (self._dynamic_obstacles.table, self._nearest_is_dynamic)
        )
        sense_some(indices, self._poses, self._initial_state.table, *self._index, *laser, ranges, *nearest_is_dynamic)

    def _seen(self, indices: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, ...]:
        """What the reading of some robots says of movers, see `RobotState`."""
        return (
            ()
            if self._dynamic_obstacles is None
            else (self._dynamic_obstacles.outlines[indices], self._nearest_is_dynamic[indices])
        )

    def _renew_movers(self) -> None:
        """Arrays of their own for what comes now: readings keep what they show."""
        if self._dynamic_obstacles is not None:
            self._dynamic_obstacles.table, self._nearest_is_dynamic = (
                self._dynamic_obstacles.table.copy(),
                np.zeros(self.num_envs, dtype=bool),
            )

    def _begin_movers(self, indices: np.ndarray, initial_state: InitialState) -> None:
        if self._dynamic_obstacles is not None:
            self._dynamic_obstacles.begin(indices, initial_state, self._index, initial_state.world.astype(int))
