"""What the sensors of all robots say at one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.outlines import towards
from tb2rl.simulation.setup import Setup
from tb2rl.simulation.start import Start
from tb2rl.worlds.geometry import shortest
from tb2rl.worlds.ways import Ways

_ARRAYS = ("pose", "twist", "odometry", "odometry_twist", "ranges", "bumped", "command", "acceleration")


class Explored(Protocol):
    """Maps of what the robots of a reading have seen."""

    def ahead(self, reading: Reading, reach: float) -> np.ndarray:
        """See `Reading.ahead`."""


class Trailed(Protocol):
    """Where the robots of a reading have been lately."""

    def seconds_near(self, points: np.ndarray, radius: float) -> np.ndarray:
        """How long each was within `radius` [m] of points, x and y, (robots, n, 2): [s], shape (robots, n)."""


class Commanded(Protocol):
    """What the robots of a reading were told lately."""

    def last(self, count: int) -> np.ndarray:
        """The last commands, v [m/s] and w [rad/s], the newest first, shape (robots, count, 2); 0 before the first."""


class Eye(Protocol):
    """What a simulation hands over with a reading, so that what takes time is found only when it is asked for."""

    @property
    def setup(self) -> Setup:
        """The robot, its laser and the worlds."""

    def look(self, reading: Reading, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """What the robots of a reading see, see `Reading.look`."""


@dataclass(frozen=True)
class Reading:
    """What the robots sense, the truth beside it, and the start of the episode that each is in.

    Attributes:
        pose: True x [m], y [m], yaw [rad] in the world's frame, shape (robots, 3).
        twist: True forward speed [m/s] and turn rate [rad/s], shape (robots, 2).
        odometry: x, y, yaw counted from the wheels since the start pose, shape (robots, 3); it does not know of wheels
            that are not what they should be.
        odometry_twist: Forward speed [m/s] and turn rate [rad/s] by the wheels' speeds, shape (robots, 2).
        ranges: Distances along the laser's beams [m], right to left, shape (robots, beams); inf where nothing was hit
            or a beam was dropped.
        bumped: Whether the base touched a wall or something that moves since the last reading, shape (robots,), bool.
        command: What each robot obeyed last, v [m/s] and w [rad/s], shape (robots, 2); 0 at an episode's start.
        acceleration: Mean forward acceleration since the last reading [m/s^2], shape (robots,); 0 at a start.
        start: How the episode of each robot began: its world, its goal, its bounds.
        eye: What makes images, see `look`, and knows ways; None for a reading that comes from no simulation.
        movers: Outlines of what moves beside each robot: x, y [m], cos and sin of the heading, half length and half
            width [m] of a box, or radius and 0, shape (robots, movers, 6); 0 and 0 in rows that are of none. None:
            nothing moves in these worlds, and no rows.
        moving: Whether what a robot touched, or if it touched nothing what is nearest along its laser's beams, is one
            of them, shape (robots,), bool; not if it touched a wall, too. None: nothing moves.
        explored: What the robots have seen so far, where their planner goes by that; None: it knows the world.
        trail: Where the robots have been lately, where a sensor asks for it; None: nowhere yet.
        told: What the robots were told lately, which late ones have not obeyed yet, where a sensor asks for it; None:
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
    start: Start
    eye: Eye | None = None
    movers: np.ndarray | None = None
    moving: np.ndarray | None = None
    explored: Explored | None = field(default=None, kw_only=True)
    trail: Trailed | None = field(default=None, kw_only=True)
    told: Commanded | None = field(default=None, kw_only=True)

    @cached_property
    def nearest(self) -> np.ndarray:
        """The shortest range of each robot [m], shape (robots,)."""
        return shortest(self.ranges)

    @cached_property
    def to_go(self) -> np.ndarray:
        """How long the way is from each robot to its goal [m], a way near walls longer; shape (robots,).

        The robot does not know it: it is for a task to pay by. For goals of `tb2rl.worlds.ways`.
        """
        return self._ways.to_go(*self._goals, self.pose)

    @property
    def to_mover(self) -> np.ndarray:
        """Which way from each robot what moves is nearest, unit vectors in the world's frame, shape (robots, 2)."""
        assert self.movers is not None  # who asks looked at `moving`
        return towards(self.pose[:, :2], self.movers)

    def ahead(self, reach: float) -> np.ndarray:
        """The point on each robot's way that is `reach` [m] ahead, or the goal, x, y [m], shape (robots, 2).

        As a planner says it that knows where the robot is, and the map: the world's, or what the robot has explored.
        """
        if self.explored is not None:
            return self.explored.ahead(self, reach)
        return self._ways.ahead(*self._goals, self.pose, reach)

    @property
    def _ways(self) -> Ways:
        if self.eye is None:
            raise InputError("this reading comes from no simulation, so it knows no ways")
        return self.eye.setup.ways

    @property
    def _goals(self) -> tuple[np.ndarray, np.ndarray]:
        return self.start.world.astype(int), self.start.way.astype(int)

    @property
    def goal(self) -> np.ndarray:
        """Where each robot is to get, x, y [m], shape (robots, 2); NaN for a robot without a goal."""
        return self.start.goal

    def look(self, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """What the robots' cameras see, made now: ask the latest reading, for in PyBullet a robot may see itself.

        Returns:
            Colours, shape (robots, height, width, 3), uint8, None in the twin, which has none; depth along the
            optical axis [m], shape (robots, height, width), float32, inf beyond the camera's range.

        Raises:
            InputError: If the reading comes from no simulation.
        """
        if self.eye is None:
            raise InputError("this reading comes from no simulation, so it has no images")
        return self.eye.look(self, width, height)

    @classmethod
    def of_one(cls, sensed: Sequence[Any], start: Start, eye: Eye) -> Reading:
        """The reading of one robot: the rows of the arrays above in their order, as plain values or arrays."""
        arrays = [row[None] if isinstance(row, np.ndarray) else np.array([row]) for row in sensed]
        columns: dict[str, Any] = dict(zip((*_ARRAYS, "movers", "moving"), arrays, strict=False))
        return cls(**columns, start=start, eye=eye)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], eye: Eye | None = None) -> Reading:
        """The reading whose `state` this is; `eye` is that of the simulation that goes on from there."""
        return cls(**{**state, "start": Start(np.array(state["start"]))}, eye=eye)

    def state(self) -> dict[str, Any]:
        """All of it by name, in arrays of its own."""
        names = _ARRAYS if self.movers is None else (*_ARRAYS, "movers", "moving")
        return {**{name: np.array(getattr(self, name)) for name in names}, "start": self.start.table.copy()}
