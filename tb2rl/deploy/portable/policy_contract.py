"""The interface between `Driver` and a policy.

Frames follow REP 103: x forward, y left, angles counter-clockwise, metres, radians and seconds. The origin of the
robot's frame is on the floor below the middle of the axle. The odometry frame is fixed to the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Tuple

import numpy as np

Pose = Tuple[float, float, float]  # x [m], y [m], yaw [rad]
Point = Tuple[float, float]  # x [m], y [m]
Speeds = Tuple[float, float]  # v [m/s] forward, w [rad/s] to the left
MAX_MAGNITUDE = 1e9  # [m], [rad], [m/s], [rad/s] larger numbers are rejected, as squares could overflow


def are_usable(numbers: Any) -> bool:
    """Whether all numbers are finite and none is larger than `MAX_MAGNITUDE`."""
    return bool((np.abs(np.asarray(numbers, dtype=float)) <= MAX_MAGNITUDE).all())


@dataclass(frozen=True)
class Needs:
    """The requirements of a policy, from its training.

    Attributes:
        beams: Directions of the laser's beams in the robot's frame [rad], right to left, shape (beams,).
        min_range: Shortest range [m]; nearer obstacles have this range.
        max_range: Longest range [m]; the range of farther obstacles is inf.
        period: Duration of a control step [s].
        max_speed: Largest absolute v of the policy's commands [m/s].
        max_turn_rate: Largest absolute w of the policy's commands [rad/s].
        robot: Name of the robot in the training.
        uses_odometry: Whether the policy uses `SensorData.pose` or `SensorData.twist`.
        goal: "goal" if the policy needs a goal, "plan" if it also needs a waypoint on a planned path, else None.
        goal_radius: Distance at which a goal is reached [m].
        lookahead: Distance from the robot along the path to the waypoint [m].
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
        ranges: Ranges along `Needs.beams` [m], from `min_range` to `max_range`, or inf, shape (beams,).
        pose: Pose in the odometry frame.
        twist: v and w by the odometry.
        bumped: Whether the robot has contact with an obstacle.
        command: The last command to the base, after all filters; (0, 0) before the first one.
        goal: Goal in the odometry frame; None: no goal.
        waypoint: Point on the planned path, in the odometry frame; None: no plan.
    """

    ranges: np.ndarray
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Speeds = (0.0, 0.0)
    bumped: bool = False
    command: Speeds = (0.0, 0.0)
    goal: Point | None = None
    waypoint: Point | None = None


class Policy(Protocol):
    """Maps sensor data to commands; stores past observations and recurrent states itself."""

    needs: Needs

    def reset(self) -> None:
        """Start a new episode."""

    def act(self, sensor_data: SensorData) -> Speeds:
        """The command of the next control step; called once per step."""
