"""The manoeuvres of the calibration drive, as a policy for `tb2rl.deploy.portable.driver.Driver`.

The robot stays in a disc around its start. It turns once on the spot, to see with the laser that the disc is free, and
then drives straight lines and curves at several speeds, turns on the spot both ways, and steps of commands at irregular
intervals. After each line it turns back to the centre, because it cannot see backwards. Odometry only keeps it in the
disc. It takes two to three minutes.
"""

import math
from collections.abc import Iterator

import numpy as np

from tb2rl.deploy.portable.policy_contract import Needs, SensorData, Speeds
from tb2rl.robots import Robot

MIN_RADIUS = 0.9  # [m] of the free disc; lines in a smaller one are too short
OVERSHOOT = 1.1  # commands reach this much over the nominal limits, because otherwise they could not show the true ones
_PERIOD = 0.1  # [s] of control
_BEAMS = np.linspace(-math.pi / 2, math.pi / 2, 121)  # [rad]
_MARGIN = 0.1  # [m] from the robot to the edge of the disc, and from there to obstacles with an inexact laser
_REACTION, _BRAKING = 0.5, 1.5  # [s] most latency of commands and scans together; [m/s^2] least braking
_TOO_MANY = 3  # beams; fewer that end in the disc are outliers
_FIRST_TURN = 0.8  # [rad/s]
_STEPS = (  # [m/s], [rad/s], duration [s]: irregular, so that a latency cannot be mistaken for a period
    (0.0, 1.2, 0.7), (0.0, -0.8, 0.4), (0.0, 0.6, 0.9), (0.0, -1.5, 0.5), (0.2, 0.0, 0.8), (0.0, 0.0, 0.6),
    (0.3, 0.9, 0.6), (0.1, -1.0, 0.9), (0.0, 0.0, 0.5), (0.0, 1.8, 0.3), (0.2, -0.6, 0.7), (0.0, 0.0, 0.9),
)  # fmt: skip


class CalibrationDrive:
    """Drives the manoeuvres once; a `Policy`. An interruption by the driver only delays them.

    The commands reach the limits of the nominal `robot`; `radius` is that of the free disc around the start [m].

    Attributes:
        done: Whether the drive is over; from then on the commands are zero.
        problem: Why it ended early; an empty string if it did not.

    Raises:
        ValueError: If the radius is below `MIN_RADIUS`.
    """

    def __init__(self, robot: Robot, radius: float = 1.5) -> None:
        if not radius >= MIN_RADIUS:
            raise ValueError(f"the radius of the free space must be at least {MIN_RADIUS} m, got {radius}")
        speed, turn_rate = OVERSHOOT * robot.max_speed, OVERSHOOT * robot.max_turn_rate
        max_range = min(robot.laser.max_range, 4.0 * radius)
        limits = robot.laser.min_range, max_range, _PERIOD, speed, turn_rate
        self.needs = Needs(_BEAMS, *limits, robot.name, uses_odometry=True)
        self.done, self.problem = False, ""
        self._robot_radius, self._radius, self._reach = robot.radius, radius, radius - robot.radius - _MARGIN
        self._is_checked = False  # whether the robot has looked around
        self._data, self._centre = SensorData(np.empty(0)), (0.0, 0.0)
        self._overshoot = 0.0  # [s] for which a turn went on after the command to stop
        self._turned, self._last_yaw = 0.0, 0.0  # [rad] by odometry since the start, without a jump at 180 degrees
        self._commands: Iterator[Speeds] | None = None

    def reset(self) -> None:
        """Continue: the centre of the disc and the manoeuvres stay, as an interruption does not move the robot."""

    def act(self, sensor_data: SensorData) -> Speeds:
        """The next command."""
        if self._commands is None:
            self._commands, self._centre, self._last_yaw = self._drive(), sensor_data.pose[:2], sensor_data.pose[2]
        self._turned += math.remainder(sensor_data.pose[2] - self._last_yaw, math.tau)
        self._data, self._last_yaw = sensor_data, sensor_data.pose[2]
        self.problem = self.problem or ("" if self.done else self._obstacle())
        self.done = self.done or bool(self.problem)
        command = None if self.done else next(self._commands, None)
        self.done = command is None
        return command or (0.0, 0.0)

    # ---- manoeuvres: iterators of commands, one per control step

    def _drive(self) -> Iterator[Speeds]:
        speed, turn_rate = self.needs.max_speed, self.needs.max_turn_rate
        yield from self._hold(0.0, 0.0, 3.0)
        yield from self._turn(_FIRST_TURN, math.tau)
        self._is_checked = True
        for share in (0.3, 0.6, 1.0, 1.0, 1.0):
            yield from self._line(share * speed, 0.0)
        for share in (0.25, -0.25, 0.5, -0.5, 1.0, -1.0):
            yield from self._turn(share * turn_rate, 2.0 * math.tau if abs(share) == 1.0 else math.tau)
        for v, w in ((0.3, 0.5), (0.3, -0.5), (0.5, 1.0), (0.5, -1.0)):
            yield from self._line(v, w)
        yield from self._face_centre()
        for v, w, seconds in _STEPS:
            yield from self._hold(v, w, seconds)
        for _ in range(2):
            yield from self._line(speed, 0.0)
        yield from self._hold(0.0, 0.0, 2.0)

    def _hold(self, v: float, w: float, seconds: float) -> Iterator[Speeds]:
        """Command the speeds for a time, or until the robot would leave the disc."""
        for _ in range(round(seconds / _PERIOD)):
            if v and not self._stays_inside(v):
                break
            yield v, w

    def _line(self, v: float, w: float) -> Iterator[Speeds]:
        """Face the centre, drive to the other side of the disc, straight or on a curve, and stop."""
        yield from self._face_centre()
        yield from self._hold(v, w, 8.0)
        yield from self._hold(0.0, 0.0, 0.8)

    def _turn(self, w: float, angle: float) -> Iterator[Speeds]:
        """Turn on the spot, and stop."""
        sign, start = math.copysign(1.0, w), self._turned
        for _ in range(math.ceil(3.0 * angle / abs(w) / _PERIOD)):  # a robot that does not turn does not wait forever
            if sign * (self._turned - start) + abs(w) * self._overshoot >= angle:
                break
            yield 0.0, w
        last = self._turned
        yield from self._hold(0.0, 0.0, 0.8)
        self._overshoot = min(max(0.0, sign * (self._turned - last) / abs(w)), _REACTION)

    def _face_centre(self) -> Iterator[Speeds]:
        for rate in (1.5, 0.5):  # the latency lets each turn overshoot, a slower one less
            x, y, yaw = self._data.pose
            if math.dist((x, y), self._centre) < 0.3 * self._reach:
                break  # near the centre all directions are as good
            error = math.remainder(math.atan2(self._centre[1] - y, self._centre[0] - x) - yaw, math.tau)
            if abs(error) > 0.2:
                yield from self._turn(math.copysign(rate, error), abs(error))

    # ---- the free space

    def _stays_inside(self, v: float) -> bool:
        """Whether the robot, if it stops now from the larger of command and speed, stops in the disc and before walls.

        The laser decides, too, because odometry drifts.
        """
        v = max(v, self._data.twist[0])
        distance = v * _REACTION + v * v / (2.0 * _BRAKING)
        x, y, yaw = self._data.pose
        end = x + distance * math.cos(yaw), y + distance * math.sin(yaw)
        before, after = math.dist((x, y), self._centre), math.dist(end, self._centre)
        return (after < self._reach or after < before) and self._is_free_ahead(distance + _MARGIN)

    def _is_free_ahead(self, distance: float) -> bool:
        ranges = np.minimum(self._data.ranges, self.needs.max_range)
        ahead, left = ranges * np.cos(self.needs.beams), ranges * np.sin(self.needs.beams)
        inside = (np.abs(left) < self._robot_radius + _MARGIN) & (ahead < self._robot_radius + distance)
        return int(inside.sum()) < _TOO_MANY

    def _obstacle(self) -> str:
        """Describe an obstacle in the disc, before the first line, or near the robot; an empty string without one."""
        limit = self._robot_radius + 0.5 * _MARGIN if self._is_checked else self._radius - _MARGIN
        if int((self._data.ranges < limit).sum()) < _TOO_MANY:
            return ""
        place = "the robot" if self._is_checked else "the start"
        return f"the laser sees an obstacle nearer than {limit:.2f} m to {place}"
