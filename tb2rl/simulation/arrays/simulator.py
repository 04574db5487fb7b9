"""Base class of simulators that keep all robots in arrays; a subclass moves the robots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.simulation.arrays.robots import ROBOT, Constants, RobotArrays, reset_robots, scan_robots, wheel_twists
from tb2rl.simulation.obstacles.dynamic_obstacles import SimulatedObstacles
from tb2rl.simulation.odometry import integrate_odometry, is_odometry_exact, measure_arcs
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators, ResetGenerators, ResetStates
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec

_MAX_RESTORED_SPEED = 1e3  # [m/s] of a wheel in a restored state; a step at a higher speed could take for ever
_STATE_FIELDS = ("pose", "wheel_speeds", "stream", "bumped", "command", "twist", "acceleration")  # keys in `state`


class ArraySimulator:
    """Robots in records of an array, each in one of the worlds; see `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
    """

    wheels_slip = False  # whether the odometry of nominal wheels differs from the true pose

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        self.spec, self.num_envs, laser = spec, num_envs, spec.laser
        beams = np.cos(laser.angles), np.sin(laser.angles)
        values = float(laser.noise), float(laser.min_range), float(laser.max_range)
        self._constants = Constants(spec.spatial_index, beams, *values, 1.0 / (PHYSICS_RATE * spec.substeps))
        self._obstacles = SimulatedObstacles(spec, num_envs)
        self._place_robots(InitialState.default(spec, num_envs), np.zeros(num_envs, dtype=np.uint64))

    def step_robots(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotArrays:
        """The robots after a control period, in new arrays; see `Simulator.step`. Dynamic obstacles move in place."""
        raise NotImplementedError

    def _place_robots(self, initial_state: InitialState, keys: np.ndarray) -> None:
        """Put all robots at their start poses, at rest, with stream keys (num_envs,) for their lasers."""
        self._initial_state, self._records = initial_state, np.zeros(self.num_envs, ROBOT)
        self._records["pose"], self._records["stream"][:, 0] = initial_state.pose, keys
        self._ranges = np.empty((self.num_envs, len(self.spec.laser.angles)))
        # None: odometry has no errors and equals the true poses.
        self._odometry = None if self._is_odometry_exact(initial_state) else initial_state.pose.copy()

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        self._place_robots(initial_state, _draw_keys(rng, self.num_envs))
        self._obstacles.table = self._obstacles.table.copy()  # earlier robot states refer to the old table
        self._obstacles.reset_at(np.arange(self.num_envs), initial_state)
        return self._scan_all()

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        if self.spec.has_dynamic_obstacles:
            self._obstacles.table = self._obstacles.table.copy()  # earlier robot states refer to the old table
        yaws = self._records["pose"][:, 2]
        _, self._records, self._ranges = robots = self.step_robots(commands, duration, inactive)
        self.travelled = robots.records["travelled"]
        if self._odometry is not None:
            arcs = self._records["arc"]
            turns = arcs[:, 1]
            if self.wheels_slip:
                changes = self._records["pose"][:, 2] - yaws
                turns = changes - math.tau * np.round((changes - turns) / math.tau)  # with the full turns of the wheels
            arcs = measure_arcs(arcs, turns, self._initial_state.records)
            self._odometry = integrate_odometry(self._odometry, arcs)
        return self._robot_state()

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        keys = None if rng is None else _draw_keys(rng, len(indices))
        self._obstacles.reset_at(indices, initial_state)
        reset_robots(indices, initial_state.records, keys, self._constants, self._robots, self._obstacles.arrays)
        if self._odometry is not None:
            self._odometry[indices] = initial_state.pose
        elif not self._is_odometry_exact(initial_state):
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
        exact = self._is_odometry_exact(initial_state) and (state["odometry"] == state["pose"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._scan_all()

    def close(self) -> None:
        """Nothing to free."""

    @property
    def _robots(self) -> RobotArrays:
        return RobotArrays(self._initial_state.records, self._records, self._ranges)

    def _is_odometry_exact(self, initial_state: InitialState) -> bool:
        return not self.wheels_slip and is_odometry_exact(initial_state.records)

    def _scan_all(self) -> RobotState:
        """Measure at the present poses and wheel speeds."""
        scan_robots(np.arange(self.num_envs), self._constants, self._robots, self._obstacles.arrays)
        return self._robot_state()

    def _robot_state(self) -> RobotState:
        """Robot state of all environments."""
        records = self._records
        motion = measured_motion = records["pose"], records["twist"]
        if self._odometry is not None:
            initial_states = self._initial_state.records
            twists, turn_rates = wheel_twists(records, initial_states), records["twist"][:, 1]
            measured_motion = self._odometry, measure_arcs(twists, turn_rates, initial_states)
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
