"""What the sensors of all robots say at one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.outlines import towards
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.geometry import shortest
from tb2rl.worlds.goal_paths import GoalPaths

_ARRAYS = ("pose", "twist", "odometry", "odometry_twist", "ranges", "bumped", "command", "acceleration")


class Planner(Protocol):
    """Maps of what the robots of a reading have seen."""

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""


class Visits(Protocol):
    """Where the robots of a reading have been lately."""

    def seconds_near(self, points: np.ndarray, radius: float) -> np.ndarray:
        """How long each was within `radius` [m] of points, x and y, (num_envs, n, 2): [s], shape (num_envs, n)."""


class CommandHistory(Protocol):
    """What the robots of a reading were told lately."""

    def last(self, count: int) -> np.ndarray:
        """The last commands, v [m/s] and w [rad/s], the newest first, shape (num_envs, count, 2); 0 before the
        first.
        """


class CameraSource(Protocol):
    """What a simulation hands over with a reading, so that what takes time is found only when it is asked for."""

    @property
    def spec(self) -> SimulationSpec:
        """The robot, its laser and the worlds."""

    def look(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """What the robots of a reading see, see `RobotState.look`."""


@dataclass(frozen=True)
class RobotState:
    """What the robots sense, the truth beside it, and the start of the episode that each is in.

    Attributes:
        pose: True x [m], y [m], yaw [rad] in the world's frame, shape (num_envs, 3).
        twist: True forward speed [m/s] and turn rate [rad/s], shape (num_envs, 2).
        odometry: x, y, yaw counted from the wheels since the start pose, shape (num_envs, 3); it does not know of
        wheels
            that are not what they should be.
        odometry_twist: Forward speed [m/s] and turn rate [rad/s] by the wheels' speeds, shape (num_envs, 2).
        ranges: Distances along the laser's beams [m], right to left, shape (num_envs, beams); inf where nothing was hit
            or a beam was dropped.
        bumped: Whether the base touched a wall or something that moves since the last reading, shape (num_envs,), bool.
        command: What each robot obeyed last, v [m/s] and w [rad/s], shape (num_envs, 2); 0 at an episode's start.
        acceleration: Mean forward acceleration since the last reading [m/s^2], shape (num_envs,); 0 at a start.
        start: How the episode of each robot began: its world, its goal, its bounds.
        camera: What makes images, see `look`, and knows ways; None for a reading that comes from no simulation.
        dynamic_obstacles: Outlines of what moves beside each robot: x, y [m], cos and sin of the heading, half length
        and half
            width [m] of a box, or radius and 0, shape (num_envs, movers, 6); 0 and 0 in rows that are of none. None:
            nothing moves in these worlds, and no rows.
        nearest_is_dynamic: Whether what a robot touched, or if it touched nothing what is nearest along its laser's
        beams, is one
            of them, shape (num_envs,), bool; not if it touched a wall, too. None: nothing moves.
        occupancy_map: What the robots have seen so far, where their planner goes by that; None: it knows the world.
        pose_history: Where the robots have been lately, where a sensor asks for it; None: nowhere yet.
        command_history: What the robots were told lately, which late ones have not obeyed yet, where a sensor asks
        for it; None:
            nothing yet.
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
    occupancy_map: Planner | None = field(default=None, kw_only=True)
    pose_history: Visits | None = field(default=None, kw_only=True)
    command_history: CommandHistory | None = field(default=None, kw_only=True)

    @cached_property
    def nearest(self) -> np.ndarray:
        """The shortest range of each robot [m], shape (num_envs,)."""
        return shortest(self.ranges)

    @cached_property
    def path_length(self) -> np.ndarray:
        """How long the way is from each robot to its goal [m], a way near walls longer; shape (num_envs,).

        The robot does not know it: it is for a task to pay by. For goals of `tb2rl.worlds.goal_paths`.
        """
        return self._paths.path_length(*self._goals, self.pose)

    @property
    def direction_to_obstacle(self) -> np.ndarray:
        """Which way from each robot what moves is nearest, unit vectors in the world's frame, shape (num_envs, 2)."""
        assert self.dynamic_obstacles is not None  # who asks looked at `nearest_is_dynamic`
        return towards(self.pose[:, :2], self.dynamic_obstacles)

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """The point on each robot's way that is `lookahead` [m] ahead, or the goal, x, y [m], shape (num_envs, 2).

        As a planner says it that knows where the robot is, and the map: the world's, or what the robot has explored.
        """
        if self.occupancy_map is not None:
            return self.occupancy_map.lookahead_point(self, lookahead)
        return self._paths.lookahead_point(*self._goals, self.pose, lookahead)

    @property
    def _paths(self) -> GoalPaths:
        if self.camera is None:
            raise InputError("this reading comes from no simulation, so it knows no ways")
        return self.camera.spec.ways

    @property
    def _goals(self) -> tuple[np.ndarray, np.ndarray]:
        return self.initial_state.world.astype(int), self.initial_state.way.astype(int)

    @property
    def goal(self) -> np.ndarray:
        """Where each robot is to get, x, y [m], shape (num_envs, 2); NaN for a robot without a goal."""
        return self.initial_state.goal

    def look(self, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """What the robots' cameras see, made now: ask the latest reading, for in PyBullet a robot may see itself.

        Returns:
            Colours, shape (num_envs, height, width, 3), uint8, None in the twin, which has none; depth along the
            optical axis [m], shape (num_envs, height, width), float32, inf beyond the camera's range.

        Raises:
            InputError: If the reading comes from no simulation.
        """
        if self.camera is None:
            raise InputError("this reading comes from no simulation, so it has no images")
        return self.camera.look(self, width, height)

    @classmethod
    def of_one(cls, sensed: Sequence[Any], initial_state: InitialState, camera: CameraSource) -> RobotState:
        """The reading of one robot: the rows of the arrays above in their order, as plain values or arrays."""
        arrays = [row[None] if isinstance(row, np.ndarray) else np.array([row]) for row in sensed]
        columns: dict[str, Any] = dict(zip((*_ARRAYS, "dynamic_obstacles", "nearest_is_dynamic"), arrays, strict=False))
        return cls(**columns, initial_state=initial_state, camera=camera)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], camera: CameraSource | None = None) -> RobotState:
        """The reading whose `state` this is; `camera` is that of the simulation that goes on from there."""
        return cls(**{**state, "initial_state": InitialState(np.array(state["initial_state"]))}, camera=camera)

    def state(self) -> dict[str, Any]:
        """All of it by name, in arrays of its own."""
        names = _ARRAYS if self.dynamic_obstacles is None else (*_ARRAYS, "dynamic_obstacles", "nearest_is_dynamic")
        return {
            **{name: np.array(getattr(self, name)) for name in names},
            "initial_state": self.initial_state.table.copy(),
        }
