"""A simulator that is a robot of ROS: time passes by itself, and odometry stands for the true pose."""

from __future__ import annotations

import atexit
import math
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy import Mounting, Needs, ScanReader, SpeedLimits
from tb2rl.deploy.portable.driver import stale
from tb2rl.deploy.portable.preflight import STALE
from tb2rl.deploy.ros.messages import BILLION, BumperEvent, LaserScan, Odometry, Twist
from tb2rl.deploy.ros.node import EMPTY, Node
from tb2rl.deploy.ros.topics import DriverTopics
from tb2rl.deploy.ros.wall_clock import WallClock
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.simulator import Generators

RESETS = ("/gazebo/reset_world", "/reset_world")  # services of Gazebo in ROS 1 and in ROS 2
PROMPT = "put the robot where the episode is to begin, then press Enter: "
_STILL = (0.0, 0.0)
_AT_REST = (0.02, 0.05)  # [m/s], [rad/s] speeds below are noise
_EARLY, _LATE = 0.1, 0.5  # shares of a control step by which the scan that ends it may come early or late
_MAX_STOPS = 10  # zero commands in a row; then other programs may drive the robot
_SETTLED = 2  # scans after a reset before one counts, because others may be on their way
_OTHER_CLOCK = 1e6  # [s] larger differences are those between wall-clock time and simulated time
# All in seconds of wall-clock time:
_POLL = 0.02
_REPEAT = 0.2  # period of repeated commands, because a base forgets them after 0.6 s
_REPEAT_SIMULATED = 2.0  # longer, because a simulation may take a repeated command for the answer to a later scan
_ABANDONED = 0.5  # without another step, after which the robot stops
_PATIENCE = 10.0  # for sensors to begin, and for a simulated time that stands still
_BRAKING = 3.0  # longest time until a robot is at rest


@dataclass
class _Input:
    """The last message of a sensor."""

    value: Any
    time: float = -math.inf  # [s] of arrival in ROS time; in simulated time its stamp
    arrival: float = -math.inf  # [s] of wall-clock time
    count: int = 0  # of messages so far

    def update(self, value: Any, time: float, arrival: float) -> None:
        self.value, self.time, self.arrival, self.count = value, time, arrival, self.count + 1


class RemoteRobot:
    """A simulator with one environment, see `tb2rl.simulation.Simulator`. It has no state to save and no images.

    A step ends with the scan that arrives at its end; steps have the right duration on average. An episode begins at
    the initial state, and odometry counts from there. Gazebo resets the robot; otherwise the user is asked to in the
    terminal. Without both the robot starts where it is.

    The robot stops on contact, when scans or odometry are missing or no step follows for half a second, between
    episodes, and at the end.

    Args:
        spec: The robot, its laser, and the world of its episodes.
        needs: Requirements of the policy.
        node: Our node; `close` closes it, too.
        mounting: Pose of the scanner on the robot.
        limits: Limits of commands; faster ones are slowed down on the same arc.
    """

    num_envs = 1
    travelled: np.ndarray

    def __init__(
        self,
        spec: SimulationSpec,
        needs: Needs,
        node: Node,
        topics: DriverTopics,
        mounting: Mounting,
        limits: SpeedLimits,
    ) -> None:
        self.spec, self._node, self._topics, self._limits = spec, node, topics, limits
        self._reader, self._wall = ScanReader(needs, mounting), WallClock()
        self._sim_time = node.uses_sim_time()
        self._lock = threading.Condition()  # shared with the threads of ROS and the watchdog
        self._ranges, self._odometry = _Input(np.empty(0)), _Input(Odometry(0, "", "", (0.0, 0.0, 0.0), _STILL))
        self._scan_problem = ""  # why the last scan cannot be used
        self._bumped = self._pressed = False
        self._command, self._stops_left, self._published = _STILL, 0, -math.inf
        self._hold_until = -math.inf  # ROS time until which each scan is answered by the same command
        self._abandoned_at = math.inf  # wall-clock time at which the watchdog stops the robot
        self._closed = False
        self._velocity = node.create_publisher(topics.velocity, Twist)
        node.create_subscription(topics.scan, LaserScan, self._on_scan)
        node.create_subscription(topics.odometry, Odometry, self._on_odometry)
        node.create_subscription(topics.bumper, BumperEvent, self._on_bumper)
        self._end_watchdog = self._wall.repeat(_REPEAT, self._watch)
        atexit.register(self.close)

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        """See `tb2rl.simulation.Simulator`.

        Raises:
            InputError: If sensors are missing, or the robot was closed.
        """
        if self._closed:
            raise InputError("the environment of the robot is closed: make another one")
        self._stand_until(lambda: True)
        self._reset_pose()
        scans, deadline = self._ranges.count, self._wall.now() + _BRAKING
        self._stand_until(
            lambda: self._ranges.count >= scans + _SETTLED and (self._at_rest() or self._wall.now() > deadline)
        )
        with self._lock:
            self._initial_state, self._origin, self._speed = initial_state, self._odometry.value.pose, 0.0
            self._bumped, self._due, self._place = False, -math.inf, initial_state.pose[0, :2]
            return self._robot_state(math.inf)

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        """See `tb2rl.simulation.Simulator`.

        Raises:
            InputError: If scans or odometry are missing for half a second.
        """
        with self._lock:
            scans, now = self._ranges.count, self._node.now()
            if abs(now - self._due) > duration:  # the first step, one after a break, or the clock was set back
                self._due = now
            self._due += duration
            latest, self._hold_until = self._due + _LATE * duration, self._due - _EARLY * duration
            self._abandoned_at = math.inf
            self._send(self._limits(commands)[0].tolist())

            def finished() -> bool:
                scanned = self._ranges.count > scans and not now - duration < self._ranges.time < self._hold_until
                return scanned or self._node.now() > latest

            try:
                self._wait_until(finished, STALE)
                deadline = self._wall.now() + _POLL
                while self._sim_time and self._odometry.time < self._ranges.time and self._wall.now() < deadline:
                    self._wall.wait(self._lock, _POLL)  # odometry of the same instant may arrive after the scan
            except BaseException:
                self._send(_STILL)
                raise
            finally:
                self._hold_until, self._abandoned_at = -math.inf, self._wall.now() + _ABANDONED
            return self._robot_state(duration)

    def __reduce__(self) -> NoReturn:
        raise InputError("a robot with ROS cannot be copied")

    def state(self) -> NoReturn:
        """Raise an `InputError`."""
        raise InputError("a robot with ROS has no state to save or restore")

    def restore(self, state: Mapping[str, Any]) -> NoReturn:
        """Raise an `InputError`."""
        self.state()

    def reset_at(
        self, indices: np.ndarray, initial_state: InitialState, robot_state: RobotState, rng: object = None
    ) -> tuple[RobotState, RobotState]:
        """See `reset`."""
        first = self.reset(initial_state, np.random.default_rng())
        return first, first

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> NoReturn:
        """Raise an `InputError`."""
        raise InputError("a robot with ROS has no images here")

    def close(self) -> None:
        """Stop the robot, and leave ROS."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        self._end_watchdog()
        for _ in range(_MAX_STOPS):
            with self._lock:
                self._send(_STILL)
            self._wall.sleep(_POLL)  # so that the last commands arrive
        self._node.close()

    # ---- called by the threads of ROS and the watchdog

    def _on_scan(self, message: LaserScan) -> None:
        with self._lock:
            # In simulated time the clock of the same instant may arrive after the scan.
            time = message.stamp / BILLION if self._sim_time else self._node.now()
            view = self._reader.read(message.to_scan())
            self._scan_problem = view.problem or _age_problem(time - message.stamp / BILLION)
            if not self._scan_problem:
                self._ranges.update(view.ranges, time, self._wall.now())
            if time < self._hold_until:
                self._publish()  # a simulation in lockstep waits for an answer to each scan
            self._lock.notify_all()

    def _on_odometry(self, message: Odometry) -> None:
        if message.is_usable:
            with self._lock:
                time = message.stamp / BILLION if self._sim_time else self._node.now()
                self._odometry.update(message, time, self._wall.now())
                self._lock.notify_all()

    def _on_bumper(self, event: BumperEvent) -> None:
        with self._lock:
            self._pressed = event.pressed
            if event.pressed:
                self._bumped = True
                self._send(_STILL)

    def _watch(self) -> None:
        """Stop an abandoned robot; repeat the command of a step in progress, and zero commands."""
        with self._lock:
            now, silence = self._wall.now(), _REPEAT_SIMULATED if self._sim_time else 0.0
            if now > self._abandoned_at and self._command != _STILL:
                self._send(_STILL)
            elif now > self._published + silence and (self._stops_left or self._hold_until > -math.inf):
                self._publish()

    # ---- called with the lock held

    def _send(self, command: tuple[float, float]) -> None:
        self._command, self._stops_left = command, _MAX_STOPS if command == _STILL else 0
        self._publish()

    def _publish(self) -> None:
        self._stops_left, self._published = max(0, self._stops_left - 1), self._wall.now()
        self._velocity.publish(Twist(*self._command))

    def _stand_until(self, finished: Callable[[], bool]) -> None:
        """Stop and wait, see `_wait_until`; answer scans meanwhile, because a simulation in lockstep waits for it."""
        with self._lock:
            self._hold_until = math.inf
            self._send(_STILL)
            try:
                self._wait_until(finished)
            finally:
                self._hold_until = -math.inf

    def _wait_until(self, finished: Callable[[], bool], max_age: float = math.inf) -> None:
        """Wait for odometry, a usable scan, and a condition; sensor data older than `max_age` [s] is missing.

        Raises:
            InputError: If one of them is missing, or does not arrive within ten seconds of wall-clock time.
        """
        began = self._wall.now()
        while not (self._ranges.count and self._odometry.count and finished()):
            now, wall = self._node.now(), self._wall.now()
            for sensor, problem in (
                (self._ranges, self._scan_problem or f"no scan on {self._topics.scan}"),
                (self._odometry, f"no odometry on {self._topics.odometry}"),
            ):
                on_its_way = self._sim_time and wall < sensor.arrival + max_age  # in a fast simulation
                outdated = now > sensor.time + max_age and not on_its_way
                if outdated or wall > max(sensor.arrival, began) + _PATIENCE:
                    raise InputError(f"the robot stands: {problem}")
            self._wall.wait(self._lock, _POLL)

    def _at_rest(self) -> bool:
        return bool((np.abs(self._odometry.value.twist) < _AT_REST).all())

    def _reset_pose(self) -> None:
        if any(self._node.call(service, EMPTY) for service in RESETS):
            return
        if sys.stdin is not None and sys.stdin.isatty():
            input(PROMPT)

    def _robot_state(self, duration: float) -> RobotState:
        """Make the robot state of the last sensor data, `duration` [s] after the previous one."""
        (x, y, yaw), (v, w) = self._odometry.value.pose, self._odometry.value.twist
        origin_x, origin_y, origin_yaw = self._origin
        start_x, start_y, start_yaw = self._initial_state.pose[0].tolist()
        cos, sin = math.cos(start_yaw - origin_yaw), math.sin(start_yaw - origin_yaw)
        east, north = x - origin_x, y - origin_y
        heading = math.remainder(start_yaw + yaw - origin_yaw, math.tau)
        pose = np.array([start_x + cos * east - sin * north, start_y + sin * east + cos * north, heading])
        self.travelled, self._place = np.array([math.dist(pose[:2], self._place)]), pose[:2]
        bumped, self._bumped = self._bumped or self._pressed, False
        acceleration, self._speed = (v - self._speed) / duration, v
        twist, command = np.array([v, w]), np.array(self._command)
        arrays = (pose, twist, pose, twist, self._ranges.value, bumped, command, acceleration)
        return RobotState.of_one(arrays, self._initial_state, self)


def _age_problem(age: float) -> str:
    """Return why a scan of this age [s] cannot be used; "" if it can."""
    if abs(age) < _OTHER_CLOCK:
        return stale("scan", age)
    return (
        "the scans have the time of another clock; if that of a simulation, begin after it, and in ROS 2 with "
        "use_sim_time"
    )
