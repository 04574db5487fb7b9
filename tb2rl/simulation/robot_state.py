"""Sensor readings of all robots at one instant, and their true state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.outlines import directions_to_nearest
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.geometry import shortest
from tb2rl.worlds.goal_paths import GoalPaths

_ARRAYS = ("pose", "twist", "odometry", "odometry_twist", "ranges", "bumped", "command", "acceleration")
_OBSTACLE_ARRAYS = ("dynamic_obstacles", "nearest_is_dynamic")


class OccupancyMap(Protocol):
    """Maps of what the robots have seen."""

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""


class PoseHistory(Protocol):
    """Where the robots have been lately."""

    def seconds_near(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Time within `radius` [m] of points x, y, shape (num_envs, n, 2): [s], shape (num_envs, n)."""


class CommandHistory(Protocol):
    """The latest commands, before their latency."""

    def last(self, count: int) -> np.ndarray:
        """V [m/s] and w [rad/s], the newest first, shape (num_envs, count, 2); 0 before the first."""


class CameraSource(Protocol):
    """The simulator of a robot state: makes images on demand, because they take time, and knows the worlds."""

    @property
    def spec(self) -> SimulationSpec:
        """The robot, its laser and the worlds."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """See `RobotState.render_camera`."""


@dataclass(frozen=True)
class RobotState:
    """Sensor readings and true state of all robots, and the initial state of their episodes.

    Attributes:
        pose: True x [m], y [m], yaw [rad] in the world's frame, shape (num_envs, 3).
        twist: True forward speed [m/s] and turn rate [rad/s], shape (num_envs, 2).
        odometry: x, y, yaw by wheel encoders (and gyro) since the start pose, shape (num_envs, 3).
        odometry_twist: Forward speed [m/s] and turn rate [rad/s] by the same, shape (num_envs, 2).
        ranges: Along the laser's beams [m], right to left, shape (num_envs, beams); inf where nothing was hit or a beam
            was dropped.
        bumped: Whether the base touched an obstacle since the last state, shape (num_envs,), bool.
        command: The latest command that took effect, v [m/s] and w [rad/s], shape (num_envs, 2); 0 at the start.
        acceleration: Mean forward acceleration since the last state [m/s^2], shape (num_envs,); 0 at the start.
        initial_state: Of the episodes.
        camera: The simulator; None: the state comes from no simulator.
        dynamic_obstacles: Outlines x, y [m], cos and sin of the heading, half length and half width [m] of a box, or
            radius and 0, shape (num_envs, obstacles, 6); 0 and 0: none in this row. None: these worlds have none.
        nearest_is_dynamic: Whether what a robot touched, or if it touched nothing what is nearest along its beams, is a
            dynamic obstacle, shape (num_envs,), bool; a wall that is touched too comes first. None: there are none.
        nearest: Shortest range [m], shape (num_envs,).
        occupancy_map: What the robots have mapped, if their task maps online.
        pose_history: Recent poses, if a sensor needs them.
        command_history: Recent commands, if a sensor needs them.
    """

    pose: np.ndarray
    twist: np.ndarray
    odometry: np.ndarray
    odometry_twist: np.ndarray
    ranges: np.ndarray
    bumped: np.ndarray
    command: np.ndarray
    acceleration: np.ndarray
    initial_state: InitialState
    camera: CameraSource | None = None
    dynamic_obstacles: np.ndarray | None = None
    nearest_is_dynamic: np.ndarray | None = None
    nearest: np.ndarray = field(default=None, kw_only=True)  # type: ignore[arg-type]
    occupancy_map: OccupancyMap | None = field(default=None, kw_only=True)
    pose_history: PoseHistory | None = field(default=None, kw_only=True)
    command_history: CommandHistory | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.nearest is None:  # simulators that find it on the way hand it over
            object.__setattr__(self, "nearest", shortest(self.ranges))

    @cached_property
    def path_length(self) -> np.ndarray:
        """Length of the shortest path from each robot to its goal [m], longer near walls; shape (num_envs,).

        Privileged information for rewards. Only for goals of `SimulationSpec.goal_paths`.
        """
        return self._goal_paths.path_length(*self._goals, self.pose)

    def keep_path_lengths(self, earlier: RobotState, indices: np.ndarray, first: RobotState) -> None:
        """Take over the path lengths of `earlier`, if they were computed, but for environments that start anew.

        Args:
            earlier: The same state before these environments started anew.
            indices: Of these, shape (n,).
            first: Their state, n rows.
        """
        if "path_length" in earlier.__dict__:  # where `cached_property` keeps its value, as it documents
            lengths = self.__dict__["path_length"] = earlier.path_length.copy()
            lengths[indices] = first.path_length

    @property
    def direction_to_obstacle(self) -> np.ndarray:
        """Unit vectors from each robot to its nearest dynamic obstacle, in the world's frame, shape (num_envs, 2)."""
        assert self.dynamic_obstacles is not None  # callers check `nearest_is_dynamic`
        return directions_to_nearest(self.pose[:, :2], self.dynamic_obstacles)

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """The point `lookahead` [m] ahead on each robot's path, or the goal if nearer, x, y [m], shape (num_envs, 2).

        The planner knows the robot's pose, and the world's map or the one that the robot has made.
        """
        if self.occupancy_map is not None:
            return self.occupancy_map.lookahead_point(self, lookahead)
        return self._goal_paths.lookahead_point(*self._goals, self.pose, lookahead)

    @property
    def _goal_paths(self) -> GoalPaths:
        if self.camera is None:
            raise InputError("this robot state comes from no simulator, so it has no paths")
        return self.camera.spec.goal_paths

    @property
    def _goals(self) -> tuple[np.ndarray, np.ndarray]:
        return self.initial_state.world.astype(int), self.initial_state.goal_path.astype(int)

    @property
    def goal(self) -> np.ndarray:
        """Goals x, y [m], shape (num_envs, 2); NaN: none."""
        return self.initial_state.goal

    def render_camera(self, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """Camera images, made now: ask the latest state, because PyBullet shows what is there now.

        Returns:
            Colours, shape (num_envs, height, width, 3), uint8, None where the simulator has none; depth along the
            optical axis [m], shape (num_envs, height, width), float32, inf beyond the camera's range.

        Raises:
            InputError: If the state comes from no simulator.
        """
        if self.camera is None:
            raise InputError("this robot state comes from no simulator, so it has no images")
        return self.camera.render_camera(self, width, height)

    @classmethod
    def of_one(cls, sensed: Sequence[Any], initial_state: InitialState, camera: CameraSource) -> RobotState:
        """The state of one robot, from rows of the arrays above in their order, plain values or arrays."""
        arrays = [row[None] if isinstance(row, np.ndarray) else np.array([row]) for row in sensed]
        columns: dict[str, Any] = dict(zip((*_ARRAYS, *_OBSTACLE_ARRAYS), arrays, strict=False))
        return cls(**columns, initial_state=initial_state, camera=camera)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], camera: CameraSource | None = None) -> RobotState:
        """The robot state of a `state`; `camera` is the simulator that continues from there."""
        return cls(**{**state, "initial_state": InitialState(np.array(state["initial_state"]))}, camera=camera)

    def state(self) -> dict[str, Any]:
        """All measured arrays by name, copied, and the table of initial states."""
        names = _ARRAYS if self.dynamic_obstacles is None else (*_ARRAYS, *_OBSTACLE_ARRAYS)
        arrays = {name: np.array(getattr(self, name)) for name in names}
        return {**arrays, "initial_state": self.initial_state.table.copy()}
