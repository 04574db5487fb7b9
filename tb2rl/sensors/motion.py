"""Sensors of speed, acceleration and contact, and of the recent past: commands and positions.

Odometry follows the wheels, which can slip, and the gyro, if there is one; the inertial unit (IMU) measures the motion
of the body.
"""

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.values import Bins, Positive
from tb2rl.robots import Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class _Motion(Sensor):
    """A number from -limit to limit; `bins` [1] are shares of the limit."""

    def __init__(self, limit: float, bins: Bins) -> None:
        self.low, self.high, self.bins = -limit, limit, tuple(share * limit for share in bins)


class ForwardSpeed(_Motion):
    """Forward speed by odometry [m/s]; `bins` [1] are shares of the robot's largest speed."""

    name, unit = "forward speed", "m/s"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1, 0.5)) -> None:
        super().__init__(robot.max_speed, bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, :1]


class TurnRate(_Motion):
    """Turn rate by odometry, positive to the left [rad/s]; `bins` [1] are shares of the robot's largest turn rate."""

    name, unit = "turn rate", "rad/s"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1)) -> None:
        super().__init__(robot.max_turn_rate, bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, 1:]


class YawRate(TurnRate):
    """True turn rate, as a gyroscope measures it [rad/s]; it has the arguments of `TurnRate`."""

    name = "yaw rate"

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.twist[:, 1:]


class ForwardAcceleration(_Motion):
    """Mean forward acceleration since the last state, as an accelerometer measures it [m/s^2].

    Values are clipped to the limit of the motors, because impacts exceed it. `bins` [1] are shares of this limit.
    """

    name, unit = "forward acceleration", "m/s^2"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1)) -> None:
        # Upper bound: the other wheel's motor adds or subtracts `wheel_coupling`, which may itself be negative.
        super().__init__(robot.wheel_acceleration + abs(robot.wheel_coupling), bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.acceleration[:, None]


class Bumper(Sensor):
    """1 if the base had a contact since the last state, else 0."""

    name, low, high = "bumper", 0.0, 1.0
    bins = (0.5,)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.bumped[:, None].astype(float)


def bumper_at(angle: float) -> int:
    """The Kobuki's bumper at an angle from straight ahead [rad]: 0 left, 1 centre (60 degrees wide), 2 right."""
    return 0 if angle > math.pi / 6 else 2 if angle < -math.pi / 6 else 1


class LastAction(Sensor):
    """The latest commands v and w as shares of the robot's limits, the newest first.

    Entries from before the first command are the command in effect at the reset. The sensor has no latency. If `count`
    covers the latency of commands and observations, a robot with latency is a Markov decision process again
    (Katsikopoulos & Engelbrecht 2003, "Markov decision processes with delays and asynchronous cost collection").

    Args:
        robot: The robot, for its speed limits.
        bins: Borders between bins, as shares of the limits.
        count: Number of commands.
    """

    name, low, high = "last action", -1.0, 1.0

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1), count: Annotated[int, Ge(1), Le(100)] = 1) -> None:
        self.max_speeds, self.bins = np.array([robot.max_speed, robot.max_turn_rate]), bins
        self.command_history_length, self.shape = count, (2 * count,)

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.command_history is None:
            return np.zeros((len(robot_state.command), *self.shape))
        commands = robot_state.command_history.last(self.command_history_length)
        return (commands / self.max_speeds).reshape(-1, *self.shape)


class Visited(Sensor):
    """Time spent near points around the robot in the last minute, by odometry; a memory for policies.

    The points are on a circle, counter-clockwise from straight ahead, then at the robot's position, then on a circle of
    twice the radius. A policy can prefer new places by these times, as in node counting (Koenig & Szymanski 1999,
    "Value-update rules for real-time search"). Where a robot stands, the number at its position grows, so that its
    actions change at last.

    Args:
        count: Number of points on each circle.
        distance: Radius of the smaller circle [m].

    Attributes:
        around: Points in the robot's frame, x and y [m], shape (2 * count + 1, 2).
        near: Largest distance from a point at which time is counted [m].
    """

    name, unit, low, high = "visited", "s", 0.0, 60.0
    bins = (1.0, 3.0)
    reads_position_history = True

    def __init__(self, count: Annotated[int, Ge(1), Le(100)] = 12, distance: Positive = 1.0) -> None:
        angles = np.arange(count) * math.tau / count
        circle = distance * np.column_stack([np.cos(angles), np.sin(angles)])
        self.around = np.vstack([circle, (0.0, 0.0), 2.0 * circle])
        self.near, self.shape = 0.5 * distance, (len(self.around),)

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.position_history is None:
            return np.zeros((len(robot_state.odometry), *self.shape))
        return robot_state.position_history.seconds_near(robot_state.odometry, self.around, self.near)
