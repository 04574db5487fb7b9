"""A robot with ROS, driven in real time behind the interface of a simulator; odometry replaces the true pose."""

import atexit
import math
import sys
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy import ScanReader, SpeedLimits
from tb2rl.deploy.portable.driver import MAX_AGE, age_problem
from tb2rl.deploy.portable.policy_contract import are_usable
from tb2rl.deploy.ros.events import Event, subscribe_to_events
from tb2rl.deploy.ros.messages import BILLION, LaserScan, Odometry, Twist
from tb2rl.deploy.ros.node import EMPTY, Node, WallClock
from tb2rl.deploy.ros.topics import DriverTopics
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.simulator import Generators

PROMPT = "Move the robot to the start of the episode, then press Enter: "
_RESET_SERVICES = ("/gazebo/reset_world", "/reset_world")  # of Gazebo in ROS 1 and in ROS 2
_ZERO_COMMAND = (0.0, 0.0)
_ZERO_COMMAND_REPEATS = 10  # number of zero commands in a row; then other programs can drive the robot
_MAX_REST_SPEEDS = (0.02, 0.05)  # [m/s], [rad/s] of a robot at rest, because odometry is noisy
_MAX_EARLINESS, _MAX_LATENESS = 0.1, 0.5  # [control steps] a step may end this much before or after its planned end
_SCANS_AFTER_RESET = 2  # number of scans to wait for; the first may be from before the reset
# All in seconds of wall-clock time:
_POLL_PERIOD = 0.02
_WATCHDOG_PERIOD = 0.2  # also the period of repeated commands, because a base stops 0.6 s after the last command
_SIMULATED_REPEAT_PERIOD = 2.0  # longer, because a simulation may take a repeated command for the answer to a scan
_WATCHDOG_TIMEOUT = 0.5  # the robot stops if the next step begins later
_SENSOR_TIMEOUT = 10.0  # for the first sensor data, and for data while simulated time is frozen
_MAX_BRAKING_TIME = 3.0  # a reset waits no longer for a robot to come to rest


class _LastData(NamedTuple):
    """The last data of a sensor."""

    value: Any = None
    ros_time: float = -math.inf  # [s] of its arrival; in simulated time its stamp
    wall_time: float = -math.inf  # [s] of its arrival
    message_count: int = 0


class RemoteRobot:
    """A robot with ROS as a `tb2rl.simulation.Simulator` with one environment, without saved states and images.

    A step ends with a scan near its planned end, and steps have the right mean duration. At a reset Gazebo moves its
    robot to the start. Without Gazebo, the user is asked to move the robot; without a terminal, it starts where it is.
    The initial state defines the pose at the start, and odometry measures the motion from there.

    The robot stops:

    - on contact, and on the other events of the base, which count as a contact,
    - when scans or odometry are missing for half a second,
    - when no step follows for half a second,
    - between episodes and at the end.

    Commands beyond the `limits` are slowed down on the same arc. `close` closes the `node`, too.
    """

    num_envs = 1
    travelled: np.ndarray

    def __init__(
        self, spec: SimulationSpec, node: Node, topics: DriverTopics, reader: ScanReader, limits: SpeedLimits
    ) -> None:
        self.spec, self._node, self._topics, self._limits, self._reader = spec, node, topics, limits, reader
        self._clock, self._uses_sim_time = WallClock(), node.uses_sim_time()
        self._condition = threading.Condition()  # its lock is shared with the threads of ROS and the watchdog
        self._ranges = self._odometry = _LastData()
        self._scan_problem = ""  # why the last scan cannot be used
        self._had_contact = self._closed = False  # contact: since the last robot state
        self._events = set[tuple[str, int]]()  # reasons and parts of events of the base that last
        self._command, self._zero_repeats_left, self._last_publish_time = _ZERO_COMMAND, 0, -math.inf
        self._repeat_until = -math.inf  # ROS time [s] until which the command is repeated; -inf outside steps and waits
        self._watchdog_deadline = math.inf  # wall-clock time [s]
        self._velocity = node.create_publisher(topics.velocity, Twist)
        node.create_subscription(topics.scan, LaserScan, self._on_scan)
        node.create_subscription(topics.odometry, Odometry, self._on_odometry)
        subscribe_to_events(node, topics, self._on_event)
        self._end_watchdog = self._clock.repeat(_WATCHDOG_PERIOD, self._watch)
        atexit.register(self.close)

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        """Stop the robot, have it moved to the start, and wait for sensor data; see `tb2rl.simulation.Simulator`.

        Raises:
            InputError: If sensors are missing, or the robot was closed.
        """
        if self._closed:
            raise InputError("the environment of the robot is closed: make another one")
        self._stop_and_wait_until(lambda: True)  # until there is sensor data
        was_moved = any(self._node.call(service, EMPTY) for service in _RESET_SERVICES)
        if not was_moved and sys.stdin is not None and sys.stdin.isatty():
            input(PROMPT)
        scans_needed, deadline = self._ranges.message_count + _SCANS_AFTER_RESET, self._clock.now() + _MAX_BRAKING_TIME

        def is_ready() -> bool:
            at_rest = (np.abs(self._odometry.value.twist) < _MAX_REST_SPEEDS).all()
            return self._ranges.message_count >= scans_needed and (at_rest or self._clock.now() > deadline)

        self._stop_and_wait_until(is_ready)
        with self._condition:
            self._initial_state, self._origin, self._speed = initial_state, self._odometry.value.pose, 0.0
            self._had_contact, self._step_end, self._position = False, -math.inf, initial_state.pose[0, :2]
            return self._robot_state(math.inf)  # inf, so that the acceleration is 0

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        """Drive until the scan that ends the step; see `tb2rl.simulation.Simulator`.

        Raises:
            InputError: If scans or odometry are missing for half a second.
        """
        with self._condition:
            scan_count, start = self._ranges.message_count, self._node.now()
            if abs(start - self._step_end) > duration:  # at the first step, after a break, or if the clock was set back
                self._step_end = start
            self._step_end += duration
            latest_end, self._watchdog_deadline = self._step_end + _MAX_LATENESS * duration, math.inf
            self._repeat_until = earliest_end = self._step_end - _MAX_EARLINESS * duration
            self._send(self._limits(commands)[0].tolist())

            def is_over() -> bool:
                too_early = start - duration < self._ranges.ros_time < earliest_end  # if older, the clock was set back
                scan_ends_step = self._ranges.message_count > scan_count and not too_early
                return scan_ends_step or self._node.now() > latest_end

            try:
                self._wait_until(is_over, MAX_AGE)
                deadline = self._clock.now() + _POLL_PERIOD if self._uses_sim_time else -math.inf
                while self._odometry.ros_time < self._ranges.ros_time and self._clock.now() < deadline:
                    self._clock.wait(self._condition, _POLL_PERIOD)  # for the odometry of the same instant
            except BaseException:
                self._send(_ZERO_COMMAND)
                raise
            finally:
                self._repeat_until, self._watchdog_deadline = -math.inf, self._clock.now() + _WATCHDOG_TIMEOUT
            return self._robot_state(duration)

    def _unsupported(self, *_: Any, **__: Any) -> NoReturn:
        raise InputError("a robot with ROS has no copies, saved states or camera images; use a simulator for these")

    __reduce__ = state = restore = render_camera = _unsupported

    def reset_at(self, indices: Any, initial_state: InitialState, rng: Any = None) -> tuple[RobotState, RobotState]:
        """Start a new episode of the only environment, see `reset`; `indices` and `rng` are ignored."""
        robot_state = self.reset(initial_state, np.random.default_rng())
        return robot_state, robot_state

    def close(self) -> None:
        """Stop the robot, and leave ROS."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        self._end_watchdog()
        for _ in range(_ZERO_COMMAND_REPEATS):
            with self._condition:
                self._send(_ZERO_COMMAND)
            self._clock.sleep(_POLL_PERIOD)  # so that the last commands arrive
        self._node.close()

    # ---- called by the threads of ROS and the watchdog

    def _ros_time_of(self, message: LaserScan | Odometry) -> float:
        # A message may arrive before the /clock message of the same instant, so simulated time is read from its stamp.
        return message.stamp / BILLION if self._uses_sim_time else self._node.now()

    def _on_scan(self, message: LaserScan) -> None:
        with self._condition:
            ros_time = self._ros_time_of(message)
            ranges, problem = self._reader.read(message.to_scan())
            self._scan_problem = problem or age_problem("scan", ros_time - message.stamp / BILLION)
            if not self._scan_problem:
                self._ranges = _LastData(ranges, ros_time, self._clock.now(), self._ranges.message_count + 1)
            if ros_time < self._repeat_until:
                self._publish()  # because a simulation in lockstep waits for an answer to each scan
            self._condition.notify_all()

    def _on_odometry(self, message: Odometry) -> None:
        if are_usable((*message.pose, *message.twist)):
            with self._condition:
                ros_time, count = self._ros_time_of(message), self._odometry.message_count + 1
                self._odometry = _LastData(message, ros_time, self._clock.now(), count)
                self._condition.notify_all()

    def _on_event(self, event: Event) -> None:
        with self._condition:
            self._events.discard((event.why, event.part))
            if event.is_active:
                self._events.add((event.why, event.part))
                self._had_contact = True
                self._send(_ZERO_COMMAND)

    def _watch(self) -> None:
        """Stop the robot if the next step is late; repeat zero commands, and the command of a step in progress."""
        with self._condition:
            now, repeat_period = self._clock.now(), _SIMULATED_REPEAT_PERIOD if self._uses_sim_time else 0.0
            must_repeat = self._zero_repeats_left > 0 or self._repeat_until > -math.inf
            if now > self._watchdog_deadline and self._command != _ZERO_COMMAND:
                self._send(_ZERO_COMMAND)
            elif must_repeat and now > self._last_publish_time + repeat_period:
                self._publish()

    # ---- called with the lock of `_condition` held

    def _send(self, command: tuple[float, float]) -> None:
        self._command, self._zero_repeats_left = command, _ZERO_COMMAND_REPEATS if command == _ZERO_COMMAND else 0
        self._publish()

    def _publish(self) -> None:
        self._zero_repeats_left, self._last_publish_time = max(0, self._zero_repeats_left - 1), self._clock.now()
        self._velocity.publish(Twist(*self._command))

    def _stop_and_wait_until(self, condition: Callable[[], bool]) -> None:
        """Stop the robot and wait, see `_wait_until`; repeat the zero command after each scan."""
        with self._condition:
            self._repeat_until = math.inf
            self._send(_ZERO_COMMAND)
            try:
                self._wait_until(condition)
            finally:
                self._repeat_until = -math.inf

    def _wait_until(self, condition: Callable[[], bool], max_age: float = math.inf) -> None:
        """Wait until there are odometry and a usable scan, and a condition holds.

        Raises:
            InputError: If sensor data is older than `max_age` [s], or none arrives for ten seconds of wall-clock time.
        """
        wait_start = self._clock.now()
        while not (self._ranges.message_count and self._odometry.message_count and condition()):
            now, wall_time = self._node.now(), self._clock.now()
            scan_problem = self._scan_problem or f"no scan arrives on {self._topics.scan}"
            odometry_problem = f"no odometry arrives on {self._topics.odometry}"
            for sensor, problem in ((self._ranges, scan_problem), (self._odometry, odometry_problem)):
                # In a fast simulation, data that has just arrived can already be old in simulated time.
                has_just_arrived = self._uses_sim_time and wall_time < sensor.wall_time + max_age
                is_too_old = now > sensor.ros_time + max_age and not has_just_arrived
                if is_too_old or wall_time > max(sensor.wall_time, wait_start) + _SENSOR_TIMEOUT:
                    raise InputError(f"the robot was stopped: {problem}")
            self._clock.wait(self._condition, _POLL_PERIOD)

    def _robot_state(self, duration: float) -> RobotState:
        """Make the robot state from the last sensor data, `duration` [s] after the previous robot state."""
        (x, y, yaw), (v, w) = self._odometry.value.pose, self._odometry.value.twist
        origin_x, origin_y, origin_yaw = self._origin
        start_x, start_y, start_yaw = self._initial_state.pose[0].tolist()
        cos, sin = math.cos(start_yaw - origin_yaw), math.sin(start_yaw - origin_yaw)
        dx, dy = x - origin_x, y - origin_y
        heading = math.remainder(start_yaw + yaw - origin_yaw, math.tau)
        pose = np.array([start_x + cos * dx - sin * dy, start_y + sin * dx + cos * dy, heading])
        self.travelled, self._position = np.array([math.dist(pose[:2], self._position)]), pose[:2]
        bumped, self._had_contact = self._had_contact or bool(self._events), False
        acceleration, self._speed = (v - self._speed) / duration, v
        twist, command = np.array([v, w]), np.array(self._command)
        arrays = (pose, twist, pose, twist, self._ranges.value, bumped, command, acceleration)
        return RobotState.for_one_robot(arrays, self._initial_state, self)
