"""What a driver and a policy say to each other: what the policy needs, what one robot sensed, two speeds.

Frames follow REP 103: x forward, y left, angles counter-clockwise, metres, radians and seconds. The robot's frame lies
under the middle of the axle; the odometry frame is the one that the robot's odometry counts in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Optional, Protocol, Tuple

import numpy as np

Pose = Tuple[float, float, float]  # x [m], y [m], yaw [rad]
Point = Tuple[float, float]  # x [m], y [m]
Speeds = Tuple[float, float]  # v [m/s] ahead, w [rad/s] to the left
LARGEST = 1e9  # [m], [rad], [m/s]: larger numbers are errors, and squares of smaller ones do not overflow


def are_usable(numbers: Any) -> bool:
    """Whether all numbers of an array or a tuple are finite, and none is larger than `LARGEST`."""
    return bool((np.abs(np.asarray(numbers, dtype=float)) <= LARGEST).all())


@dataclass(frozen=True)
class Needs:
    """What a policy was trained with, so what it needs of a robot.

    Attributes:
        beams: Directions of the laser's beams in the robot's frame [rad], right to left, shape (beams,).
        min_range: The shortest range that it was shown [m]; what is nearer was shown as this.
        max_range: The longest [m]; beyond it the laser said inf.
        period: How long a command lasts [s]: the control step.
        max_speed: The fastest that it commands, ahead or back [m/s].
        max_turn_rate: The fastest that it commands to either side [rad/s].
        robot: Name of the robot that it was trained with.
        uses_odometry: Whether it acts by `Sensed.pose` or `Sensed.twist`.
        goal: None: it has no goal. "goal": it is told where its goal is. "plan": it is told a point on a planned way to
            it, too.
        goal_radius: How near to the goal it is to get [m].
        lookahead: How far ahead on the planned way that point is [m].

    Raises:
        ValueError: For a number that is not finite or is negative, a period of 0, or ranges without extent.
    """

    beams: np.ndarray
    min_range: float
    max_range: float
    period: float
    max_speed: float
    max_turn_rate: float
    robot: str
    uses_odometry: bool = False
    goal: Optional[str] = None
    goal_radius: float = 0.3
    lookahead: float = 1.5

    def __post_init__(self) -> None:
        if self.beams.ndim != 1 or not self.beams.size or not are_usable(self.beams):
            raise ValueError("beams takes finite angles, shape (beams,), at least one")
        for name in ("min_range", "max_range", "period", "max_speed", "max_turn_rate", "goal_radius", "lookahead"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError("{} takes a finite number from 0, got {}".format(name, getattr(self, name)))
        if not (self.period > 0.0 and self.max_range > self.min_range):
            raise ValueError("period takes seconds above 0, and max_range metres above min_range")
        if self.goal not in (None, "goal", "plan"):
            raise ValueError('goal takes None, "goal" or "plan", got {!r}'.format(self.goal))

    @property
    def field_of_view(self) -> float:
        """The angle from the first beam to the last [rad]."""
        return float(self.beams[-1] - self.beams[0])


@dataclass(frozen=True)
class Sensed:
    """What one robot sensed by one control step.

    Attributes:
        ranges: Along the beams of `Needs` [m], from `min_range` to `max_range`, inf where nothing is, shape (beams,).
        pose: In the odometry frame.
        twist: v and w by the odometry.
        bumped: Whether the robot touches something.
        command: What it was last told; (0, 0) where it has not been told anything.
        goal: In the odometry frame; None: it has none.
        waypoint: The point of the planned way, in the odometry frame; None: there is no plan.
    """

    ranges: np.ndarray
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Speeds = (0.0, 0.0)
    bumped: bool = False
    command: Speeds = (0.0, 0.0)
    goal: Optional[Point] = None
    waypoint: Optional[Point] = None


class Policy(Protocol):
    """What decides how a robot drives; it remembers what an episode needs: stacked frames, a recurrent state."""

    needs: Needs

    def begin(self) -> None:
        """Forget the last episode; the next `act` is the first of a new one."""

    def act(self, sensed: Sensed) -> Speeds:
        """The speeds for the next control step; called once for each."""
