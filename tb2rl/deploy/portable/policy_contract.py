"""The interface between a driver and a policy.

Frames follow REP 103: x forward, y left, angles counter-clockwise, metres, radians and seconds. The robot's frame lies
below the middle of the axle; the odometry frame is the frame of the robot's odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Tuple

import numpy as np

Pose = Tuple[float, float, float]  # x [m], y [m], yaw [rad]
Point = Tuple[float, float]  # x [m], y [m]
Speeds = Tuple[float, float]  # v [m/s] forward, w [rad/s] to the left
LARGEST = 1e9  # [m], [rad], [m/s]: larger numbers are errors, and squares of smaller ones do not overflow


def are_usable(numbers: Any) -> bool:
    """Whether all numbers are finite and none is larger than `LARGEST`."""
    return bool((np.abs(np.asarray(numbers, dtype=float)) <= LARGEST).all())


@dataclass(frozen=True)
class Needs:
    """The requirements of a policy, from its training.

    Attributes:
        beams: Directions of the laser's beams in the robot's frame [rad], right to left, shape (beams,).
        min_range: Shortest range [m]; nearer obstacles appear at this range.
        max_range: Longest range [m]; beyond it the range is inf.
        period: Control step [s].
        max_speed: Largest |v| of its commands [m/s].
        max_turn_rate: Largest |w| of its commands [rad/s].
        robot: Name of the robot.
        uses_odometry: Whether it uses `SensorData.pose` or `SensorData.twist`.
        goal: None: no goal. "goal": it uses the goal. "plan": it also uses a point on a planned path to the goal.
        goal_radius: A goal at this distance is reached [m].
        lookahead: Distance of that point along the path [m].
    """

    beams: np.ndarray
    min_range: float
    max_range: float
    period: float
    max_speed: float
    max_turn_rate: float
    robot: str
    uses_odometry: bool = False
    goal: str | None = None
    goal_radius: float = 0.3
    lookahead: float = 1.5


@dataclass(frozen=True)
class SensorData:
    """The input of a policy at one control step.

    Attributes:
        ranges: Along the beams of `Needs` [m], from `min_range` to `max_range`, or inf, shape (beams,).
        pose: In the odometry frame.
        twist: v and w by the odometry.
        bumped: Whether the robot touches something.
        command: The last command; (0, 0) before the first.
        goal: In the odometry frame; None: no goal.
        waypoint: The point on the planned path, in the odometry frame; None: no plan.
    """

    ranges: np.ndarray
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Speeds = (0.0, 0.0)
    bumped: bool = False
    command: Speeds = (0.0, 0.0)
    goal: Point | None = None
    waypoint: Point | None = None


class Policy(Protocol):
    """Decides how a robot drives; keeps stacked frames and a recurrent state itself."""

    needs: Needs

    def reset(self) -> None:
        """Start a new episode."""

    def act(self, sensed: SensorData) -> Speeds:
        """The command of the next control step; called once per step."""
