"""How the robot moves, as its odometry and its inertial unit (IMU) say, and what it was told.

Odometry counts the wheels, which slip on the floor; the inertial unit feels how the body itself moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.values import Bins
from tb2rl.robots import Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulationSpec


class _Motion(Sensor):
    """One number that lies within what the robot can do.

    Args:
        robot: What it can do.
        bins: Borders of the classes, as shares of the largest value.
    """

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1)) -> None:
        self.high = self._largest(robot)
        self.low = -self.high
        self.bins = tuple(edge * self.high for edge in bins)

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        return {"robot": spec.robot}

    @staticmethod
    def _largest(robot: Robot) -> float:
        raise NotImplementedError


class ForwardSpeed(_Motion):
    """How fast the robot drives ahead, counted from its wheels [m/s].

    Args:
        robot: Its fastest speed is the limit.
        bins: Borders of the classes, as shares of that.
    """

    name, unit = "forward speed", "m/s"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1, 0.5)) -> None:
        super().__init__(robot, bins)

    @staticmethod
    def _largest(robot: Robot) -> float:
        return robot.max_speed

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, :1]


class TurnRate(_Motion):
    """How fast the robot turns to the left, counted from its wheels [rad/s].

    Args:
        robot: Its fastest turn is the limit.
        bins: Borders of the classes, as shares of that.
    """

    name, unit = "turn rate", "rad/s"

    @staticmethod
    def _largest(robot: Robot) -> float:
        return robot.max_turn_rate

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, 1:]


class YawRate(TurnRate):
    """How fast the robot truly turns to the left, as a gyroscope feels it [rad/s]; arguments as of `TurnRate`."""

    name = "yaw rate"

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.twist[:, 1:]


class ForwardAcceleration(_Motion):
    """The mean acceleration ahead since the last reading, as an accelerometer feels it [m/s^2].

    Args:
        robot: What its motors can do is the limit; the blow of a wall is cut to it.
        bins: Borders of the classes, as shares of that.
    """

    name, unit = "forward acceleration", "m/s^2"

    @staticmethod
    def _largest(robot: Robot) -> float:
        return robot.wheel_acceleration + abs(robot.wheel_coupling)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.acceleration[:, None]


class LastAction(Sensor):
    """What the robot was last told, v and w, as shares of its fastest speed and its fastest turn; 0 at the start.

    Who drives knows it at once, however late the robot obeys and its readings come. With a `count` of as many control
    steps as both take, a late robot is a Markov decision process again (Katsikopoulos & Engelbrecht 2003, "Markov
    decision processes with delays and asynchronous cost collection").

    Shares, so that one sensor has one unit, and networks see numbers of one size, whatever the robot.

    Args:
        robot: What it can do.
        bins: Borders of the classes of all shares.
        count: How many of the last actions, the newest first.
    """

    name, low, high = "last action", -1.0, 1.0

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1), count: Annotated[int, Ge(1), Le(100)] = 1) -> None:
        self.max_speeds, self.bins = np.array([robot.max_speed, robot.max_turn_rate]), bins
        self.reads_commands, self.shape = count, (2 * count,)

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        return {"robot": spec.robot}

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.command_history is None:
            return np.zeros((len(robot_state.command), *self.shape))
        return (robot_state.command_history.last(self.reads_commands) / self.max_speeds).reshape(-1, *self.shape)
