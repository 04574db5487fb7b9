"""Speeds by odometry, the inertial unit (IMU), and the latest commands.

Odometry follows the wheels, which can slip; the inertial unit measures the motion of the body.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.values import Bins
from tb2rl.robots import Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class _Motion(Sensor):
    """A signed number within a limit of the robot; `bins` are shares of the limit."""

    spec_arguments = ("robot",)

    def __init__(self, limit: float, bins: Bins) -> None:
        self.low, self.high, self.bins = -limit, limit, tuple(share * limit for share in bins)


class ForwardSpeed(_Motion):
    """Forward speed by odometry [m/s]; `bins` are shares of the robot's largest speed."""

    name, unit = "forward speed", "m/s"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1, 0.5)) -> None:
        super().__init__(robot.max_speed, bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, :1]


class TurnRate(_Motion):
    """Turn rate by odometry, positive to the left [rad/s]; `bins` are shares of the robot's largest turn rate."""

    name, unit = "turn rate", "rad/s"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1)) -> None:
        super().__init__(robot.max_turn_rate, bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.odometry_twist[:, 1:]


class YawRate(TurnRate):
    """True turn rate, as a gyroscope measures it [rad/s]; arguments as of `TurnRate`."""

    name = "yaw rate"

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.twist[:, 1:]


class ForwardAcceleration(_Motion):
    """Mean forward acceleration since the last state, as an accelerometer measures it [m/s^2].

    It is clipped to the limit of the motors, which impacts exceed; `bins` are shares of this limit.
    """

    name, unit = "forward acceleration", "m/s^2"

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1)) -> None:
        super().__init__(robot.wheel_acceleration + abs(robot.wheel_coupling), bins)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.acceleration[:, None]


class LastAction(Sensor):
    """The latest commands v and w as shares of the robot's limits, the newest first; 0 at the start.

    They have no latency. If `count` covers the latency of commands and observations, a robot with latency is a Markov
    decision process again (Katsikopoulos & Engelbrecht 2003, "Markov decision processes with delays and asynchronous
    cost collection"). Shares have one unit and one scale for all robots.

    Args:
        robot: Its speed limits are the unit.
        bins: Borders of the bins of all shares.
        count: Number of commands.
    """

    name, low, high, spec_arguments = "last action", -1.0, 1.0, ("robot",)

    def __init__(self, robot: Robot, bins: Bins = (-0.1, 0.1), count: Annotated[int, Ge(1), Le(100)] = 1) -> None:
        self.max_speeds, self.bins = np.array([robot.max_speed, robot.max_turn_rate]), bins
        self.reads_commands, self.shape = count, (2 * count,)

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.command_history is None:
            return np.zeros((len(robot_state.command), *self.shape))
        return (robot_state.command_history.last(self.reads_commands) / self.max_speeds).reshape(-1, *self.shape)
