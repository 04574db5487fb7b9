"""Sensor readings of all robots at one instant, and their true state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.spec import InitialState, SimulationSpec
from tb2rl.worlds.geometry import shortest_ranges

# Arrays that a simulator measures, in the order of `for_one_robot`; the last two only with dynamic obstacles.
ARRAYS = (
    "pose", "twist", "odometry", "odometry_twist", "ranges", "bumped", "command", "acceleration",
    "dynamic_obstacles", "nearest_is_dynamic",
)  # fmt: skip


class OccupancyMap(Protocol):
    """Occupancy maps that the robots have made in their episodes."""

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""


class PositionHistory(Protocol):
    """Recent positions of the robots, by odometry."""

    def seconds_near(self, poses: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
        """Time that each robot spent near points [s], shape (num_envs, n).

        Args:
            poses: Poses of the robots by odometry, x [m], y [m], yaw [rad], shape (num_envs, 3).
            points: x ahead and y to the left of each robot [m], shape (n, 2).
            radius: Largest distance from a point at which time is counted [m].
        """


class CommandHistory(Protocol):
    """The latest commands as given, without the latency after which they take effect."""

    def last(self, count: int) -> np.ndarray:
        """V [m/s] and w [rad/s], newest first, shape (num_envs, count, 2), filled up with the command at the start."""


class StateSource(Protocol):
    """The simulator of a robot state, which renders images on demand."""

    @property
    def spec(self) -> SimulationSpec:
        """The robot, its laser and the worlds."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """See `RobotState.render_camera`."""


@dataclass
class RobotState:
    """Sensor readings and true state of all robots, and the initial state of their episodes.

    Only `Simulator.reset_at` changes the arrays later. The class is not frozen, because freezing costs 1 us per state.
    """

    pose: np.ndarray  # true x [m], y [m], yaw [rad] in the world's frame, shape (num_envs, 3)
    twist: np.ndarray  # true forward speed [m/s] and turn rate [rad/s], shape (num_envs, 2)
    odometry: np.ndarray  # x, y, yaw from wheel encoders (and gyro), equal to the true pose at the start, (num_envs, 3)
    odometry_twist: np.ndarray  # forward speed [m/s] and turn rate [rad/s] of the odometry, shape (num_envs, 2)
    ranges: np.ndarray  # [m] laser ranges, right to left, shape (num_envs, beams); inf: no hit, or a dropped beam
    bumped: np.ndarray  # whether the base touched an obstacle since the last state, shape (num_envs,), bool
    command: np.ndarray  # latest command in effect, v [m/s], w [rad/s], shape (num_envs, 2); 0 at the start
    acceleration: np.ndarray  # [m/s^2] forward, mean since the last state, shape (num_envs,); 0 at the start
    initial_state: InitialState  # initial states of the episodes
    simulator: StateSource | None = None  # None: the state does not come from a simulator
    # Outlines of the dynamic obstacles, shape (num_envs, obstacles, 6): x, y [m], cos and sin of the heading, and two
    # sizes [m]: half length and half width of a box, radius and 0 of a circle, 0 and 0 in a row without an obstacle.
    # None: no dynamic obstacles.
    dynamic_obstacles: np.ndarray | None = None
    # After a contact: whether the robot touched a dynamic obstacle, and no wall. Otherwise: whether the shortest laser
    # range is that of a dynamic obstacle. Shape (num_envs,), bool. None: no dynamic obstacles.
    nearest_is_dynamic: np.ndarray | None = None
    nearest_range: np.ndarray = field(default=None, kw_only=True)  # type: ignore[arg-type]  # [m] shortest range, (num_envs,)
    occupancy_map: OccupancyMap | None = field(default=None, kw_only=True)  # if the task maps online
    position_history: PositionHistory | None = field(default=None, kw_only=True)  # if a sensor needs it
    command_history: CommandHistory | None = field(default=None, kw_only=True)  # if a sensor needs it

    def __post_init__(self) -> None:
        if self.nearest_range is None:  # some simulators compute it with the ranges
            self.nearest_range = shortest_ranges(self.ranges)

    @cached_property
    def path_length(self) -> np.ndarray:
        """Length of the shortest path from each robot to its goal [m], with extra cost near walls; shape (num_envs,).

        This is privileged information for rewards. The goals must be those of `SimulationSpec.goal_paths`.
        """
        return self._source.spec.goal_paths.path_length(*self._worlds_and_goal_numbers, self.pose)

    def copy_path_lengths(self, earlier: RobotState, indices: np.ndarray, reset_states: RobotState) -> None:
        """If `earlier` has computed its path lengths, copy them to this state, except in the reset environments.

        Args:
            earlier: The same state, before some environments were reset.
            indices: The environments that were reset, shape (n,).
            reset_states: The states of these environments after the reset, n rows; source of their path lengths.
        """
        if "path_length" in earlier.__dict__:  # `cached_property` stores its value there
            lengths = self.__dict__["path_length"] = earlier.path_length.copy()
            lengths[indices] = reset_states.path_length

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """Point `lookahead` [m] ahead on each robot's path, or the goal if it is nearer: x, y [m], shape (num_envs, 2).

        The path is planned on the robot's `occupancy_map` from its estimated pose, or else on the true map.
        """
        if self.occupancy_map is not None:
            return self.occupancy_map.lookahead_point(self, lookahead)
        return self._source.spec.goal_paths.lookahead_point(*self._worlds_and_goal_numbers, self.pose, lookahead)

    @property
    def _source(self) -> StateSource:
        if self.simulator is None:
            raise InputError("this robot state does not come from a simulator, so it has no paths and no images")
        return self.simulator

    @property
    def _worlds_and_goal_numbers(self) -> tuple[np.ndarray, np.ndarray]:
        return self.initial_state.world.astype(int), self.initial_state.records["goal_path"].astype(int)

    @property
    def goal(self) -> np.ndarray:
        """X and y of the goals [m], shape (num_envs, 2); NaN without a goal."""
        return self.initial_state.goal

    def render_camera(self, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """Render camera images; works for the latest robot state only, because PyBullet renders its present world.

        Returns:
            Colours, shape (num_envs, height, width, 3), uint8, or None from a simulator without colours; depth along
            the optical axis [m], shape (num_envs, height, width), float32, inf beyond the camera's range.
        """
        return self._source.render_camera(self, width, height)

    @classmethod
    def for_one_robot(cls, values: Sequence[Any], initial_state: InitialState, simulator: StateSource) -> RobotState:
        """Make the state of one robot from a value for each of `ARRAYS`: a number, a sequence, or an array."""
        arrays = [value[None] if isinstance(value, np.ndarray) else np.array([value]) for value in values]
        columns: dict[str, Any] = dict(zip(ARRAYS, arrays, strict=False))
        return cls(**columns, initial_state=initial_state, simulator=simulator)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], simulator: StateSource | None = None) -> RobotState:
        """Make a robot state from the result of `state`; `simulator`, if any, has been restored to the same step."""
        return cls(**{**state, "initial_state": InitialState(np.array(state["initial_state"]))}, simulator=simulator)

    def state(self) -> dict[str, Any]:
        """Copies of all measured arrays by name, and of the table of initial states."""
        arrays = {name: np.array(getattr(self, name)) for name in ARRAYS if getattr(self, name) is not None}
        return {**arrays, "initial_state": self.initial_state.table.copy()}
