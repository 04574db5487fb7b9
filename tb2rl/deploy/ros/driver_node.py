"""The ROS node that drives a robot by a policy: subscribes to sensors, publishes velocity commands."""

import argparse
import math
import re
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Any

import numpy as np
import torch as th

from tb2rl.core.errors import InputError
from tb2rl.deploy import Command, Driver, Finding, TrainedPolicy
from tb2rl.deploy.portable.driver import DRIVING, DRY_RUN, MAX_AGE, REACHED, STOPPED
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros import create_node
from tb2rl.deploy.ros.events import Event, subscribe_to_events
from tb2rl.deploy.ros.messages import BILLION, Diagnostics, Goal, LaserScan, Odometry, Plan, Twist
from tb2rl.deploy.ros.node import TRIGGER, Node, WallClock
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, DriverTopics, parse_topics
from tb2rl.runs.loading import load

NODE_NAME = "tb2rl_driver"
_MAX_SCAN_GAP = 1.5  # [control steps] if no scan arrives for this long, the policy decides by the last scan again
_PREFLIGHT_SCANS = 5  # number of scans before the first preflight, because it checks the scan rate
_ZERO_COMMAND_REPEATS = 10  # zero commands after a stop; then nothing is published, so that others can drive the robot
# All in seconds of wall-clock time:
_POLL_PERIOD = 0.05  # of the checks for stale data
_FROZEN_TIME = 0.2  # simulated time is frozen if it has not changed for this long
_COMMAND_TIMEOUT = 0.45  # maximum age of the last command while simulated time is frozen; then the robot stops
_PREFLIGHT_PERIOD = 3.0  # of repeated preflights, which report missing sensors
_DIAGNOSTICS_PERIOD = 1.0
_INTERVENTION_PERIOD = 2.0  # least time between printed interventions of filters
_PUBLISH_PAUSE = 0.02  # between zero commands at the end, so that the last ones arrive


def run(options: argparse.Namespace) -> None:
    """Drive until a signal ends the program."""
    topics = parse_topics(options.topics, TURTLEBOT2[options.ros])
    mounting, limits = parse_mounting(options.mounting), parse_limits(options.speed)
    th.set_num_threads(1)  # because inference is too small to be parallel, and the robot's other programs need the CPU
    policy = TrainedPolicy(load(options.policy, options.trust))
    try:
        driver = Driver(policy, limits, mounting, options.dry_run, options.safe)
    except ValueError as error:
        raise InputError(f"{error}; --safe off drives without the safety filter") from None
    with closing(create_node(options.ros, NODE_NAME, options.ros_args)) as node:
        shutdown = threading.Event()
        for termination_signal in termination_signals():
            signal.signal(termination_signal, lambda *_: shutdown.set())
        output = "no commands (dry run)" if options.dry_run else f"commands to {topics.velocity}"
        _print(f"{options.policy} on ROS {options.ros}: scans from {topics.scan}, {output}")
        with closing(DriverNode(driver, node, topics, options.wait)) as driver_node:
            driver_node.run(shutdown)


class DriverNode:
    """Connects a driver to ROS topics; prints when the robot drives, and why it stops.

    In a dry run no commands are published. If the node `waits`, it drives when the service `~/start` is called; else
    once the preflight finds no error.
    """

    def __init__(self, driver: Driver, node: Node, topics: DriverTopics, waits: bool) -> None:
        self._driver, self._node, self._autostart = driver, node, not waits
        self._clock, self._uses_sim_time = WallClock(), node.uses_sim_time()
        self._lock = threading.RLock()  # shared with the threads of ROS
        self._callback_error: Exception | None = None
        self._zero_repeats_left, self._scan_count, self._scan_stamp = _ZERO_COMMAND_REPEATS, 0, math.nan
        self._last_ros_time, self._last_decision_time = math.nan, -math.inf  # [s] of ROS time
        # [s] of wall-clock time; the last tick is the last change of the ROS time:
        self._last_tick = self._last_command_time = self._last_diagnostics = self._last_preflight = self._clock.now()
        self._printed_intervention, self._next_intervention_time = "", -math.inf
        self._command, self._printed_state, self._findings = Command(0.0, 0.0, ""), "", list[Finding]()
        self._pending_goal: Goal | Plan | None = None  # waits for the first odometry, whose frame it must have
        self._odometry_frame, self._has_odometry_warning = "", False
        self._latencies: deque[tuple[float, float]] = deque(maxlen=10_000)  # [s] wall-clock time, processor time
        self._velocity = node.create_publisher(topics.velocity, Twist)
        self._diagnostics = node.create_publisher("/diagnostics", Diagnostics)
        node.create_subscription(topics.scan, LaserScan, self._guarded(self._on_scan))
        node.create_subscription(topics.odometry, Odometry, self._guarded(self._on_odometry))
        if not subscribe_to_events(node, topics, self._guarded(self._on_event)):
            _print("warning: the messages of the Kobuki are not installed: only events of std_msgs/Bool stop the robot")
        if driver.needs.goal == "goal":
            node.create_subscription(topics.goal, Goal, self._guarded(self._on_goal))
        if driver.needs.goal == "plan":
            node.create_subscription(topics.plan, Plan, self._guarded(self._on_goal))
        node.create_service("~/start", TRIGGER, self._guarded(self._try_to_start))
        node.create_service("~/stop", TRIGGER, self._guarded(self._stop))

    def run(self, shutdown: threading.Event) -> None:
        """Drive until ROS shuts the node down, or the event is set."""
        while not (self._is_over() or self._clock.wait(shutdown, _POLL_PERIOD)):
            if self._callback_error:
                raise self._callback_error
            with self._lock:
                self._poll()

    def _is_over(self) -> bool:
        """Whether `run` ends; a subclass may add reasons."""
        return self._node.is_shutdown()

    def close(self) -> None:
        """Stop the robot, and print the latency from scan to command."""
        with self._lock:
            self._autostart, self._zero_repeats_left = False, _ZERO_COMMAND_REPEATS
            self._driver.stop("the node ends")
        for _ in range(_ZERO_COMMAND_REPEATS):
            with self._lock, suppress(OSError):  # `_print` fails if the terminal is closed
                self._publish(self._driver.command(self._node.now()))
            self._clock.sleep(_PUBLISH_PAUSE)
        filters = self._driver.filters
        with suppress(OSError):
            if filters.interventions:
                _print(f"the safety filter changed {filters.interventions} of {filters.decisions} commands")
            if self._latencies:
                percentiles = np.percentile(self._latencies, [50, 99], axis=0).T * 1e3
                wall, cpu = (f"{median:.1f} ms, 99 % within {p99:.1f} ms" for median, p99 in percentiles)
                times = f"median time from scan to command: {wall} (of processor time: {cpu})"
                _print(f"{len(self._latencies)} scans, {times}")

    # ---- callbacks, in threads of ROS

    def _guarded(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a callback: the lock is held, and an exception ends the node; a service then returns the error."""

        def guarded(*message: Any) -> Any:
            with self._lock:
                try:
                    return callback(*message)
                except Exception as error:
                    self._callback_error = error
                    return f"the node ends: {error}"

        return guarded

    def _on_scan(self, scan: LaserScan) -> None:
        wall_start, cpu_start = time.perf_counter(), time.thread_time()
        self._scan_count, self._scan_stamp = self._scan_count + 1, scan.stamp / BILLION
        self._driver.see_scan(scan.to_scan(), self._scan_stamp)
        if self._scan_count == 1:
            self._zero_repeats_left = _ZERO_COMMAND_REPEATS  # because a simulation in lockstep waits for commands
        if self._autostart and self._scan_count >= _PREFLIGHT_SCANS:
            self._try_to_start()
        # In simulated time, a scan may arrive before the /clock message of its time stamp.
        self._decide(self._scan_stamp if self._uses_sim_time else self._node.now())
        self._latencies.append((time.perf_counter() - wall_start, time.thread_time() - cpu_start))

    def _on_odometry(self, odometry: Odometry) -> None:
        if self._driver.see_odometry(odometry.pose, odometry.twist, odometry.stamp / BILLION):
            self._odometry_frame = odometry.frame
            if self._pending_goal:
                self._on_goal(self._pending_goal)
        elif not self._has_odometry_warning:
            self._has_odometry_warning = True
            _print("warning: odometry is ignored: its orientation is invalid, or a number is not finite or too large")

    def _on_event(self, event: Event) -> None:
        self._driver.see_event(event.why, event.is_active, event.part)
        if event.is_active:
            self._stop(event.why)

    def _on_goal(self, goal: Goal | Plan) -> None:
        frame, name = self._odometry_frame, type(goal).__name__.lower()
        self._pending_goal = None if frame else goal
        if frame and goal.frame != frame:
            hint = f"send it in the frame of the odometry, {frame!r}"
            _print(f"the {name} is ignored: its frame is {goal.frame!r}; {hint}")
        elif frame:
            try:
                if isinstance(goal, Plan):
                    self._driver.set_plan(goal.points)
                else:
                    self._driver.set_goal(goal.position)
                    _print(f"the goal is ({goal.position[0]:.2f}, {goal.position[1]:.2f}) in {frame!r}")
            except ValueError as error:
                _print(f"the {name} is ignored: {error}")

    def _stop(self, why: str = STOPPED) -> str:
        self._autostart = False
        self._driver.stop(why)
        self._decide(self._node.now())
        return ""

    # ---- called with the lock held

    def _try_to_start(self) -> str:
        """Start if the preflight finds no error; returns the errors it found."""
        printed = {_remove_numbers(finding.message) for finding in self._findings}
        self._findings = self._driver.preflight()
        for finding in self._findings:
            if _remove_numbers(finding.message) not in printed:
                _print(f"{'error' if finding.is_error else 'warning'}: {finding.message}")
        errors = "; ".join(finding.message for finding in self._findings if finding.is_error)
        if not errors:
            self._autostart = False
            self._driver.start()
        return errors

    def _poll(self) -> None:
        """Stop the robot if data is stale or simulated time is frozen; repeat the preflight and the diagnostics."""
        ros_time, wall_time = self._node.now(), self._clock.now()
        last_decision, max_gap = self._last_decision_time, _MAX_SCAN_GAP * self._driver.needs.period
        if ros_time != self._last_ros_time:
            self._last_ros_time, self._last_tick = ros_time, wall_time
        if self._autostart and wall_time > self._last_preflight + _PREFLIGHT_PERIOD:
            self._last_preflight = wall_time
            self._try_to_start()
        if wall_time > self._last_tick + _FROZEN_TIME and wall_time > self._last_command_time + _COMMAND_TIMEOUT:
            self._publish(Command(0.0, 0.0, "simulated time is frozen"))
        elif ros_time > self._scan_stamp + MAX_AGE or not last_decision <= ros_time < last_decision + max_gap:
            self._decide(ros_time)  # by the last scan; if that is stale, the driver stops the robot
        if wall_time > self._last_diagnostics + _DIAGNOSTICS_PERIOD:
            self._last_diagnostics = wall_time
            self._publish_diagnostics()

    def _decide(self, ros_time: float) -> None:
        self._last_decision_time, self._last_command_time = ros_time, self._clock.now()
        self._publish(self._driver.command(ros_time))

    def _publish(self, command: Command) -> None:
        if command.why == DRIVING:
            self._zero_repeats_left = _ZERO_COMMAND_REPEATS
        elif self._velocity.connected():  # zero commands count only if a node receives them
            self._zero_repeats_left = max(0, self._zero_repeats_left - 1)
        if not self._driver.dry_run and self._zero_repeats_left > 0:
            self._velocity.publish(Twist(command.v, command.w))
        self._command = command
        if command.intervention != self._printed_intervention and self._clock.now() > self._next_intervention_time:
            self._printed_intervention = command.intervention
            self._next_intervention_time = self._clock.now() + _INTERVENTION_PERIOD
            _print(f"slowed: {command.intervention}" if command.intervention else "not slowed any more")
        state = _remove_numbers(command.why)
        if state != self._printed_state and not self._autostart:  # before the start, the preflight prints its findings
            self._printed_state = state
            _print(command.why if command.why in (DRIVING, DRY_RUN) else f"stopped: {command.why}")

    def _publish_diagnostics(self) -> None:
        command, (v, w) = self._command, self._command.wanted
        if command.why == DRY_RUN:
            _print(f"dry run: {v:.2f} m/s ahead, {w:.2f} rad/s to the left")
        level = "ERROR" if any(finding.is_error for finding in self._findings) else "WARN"
        level = "OK" if command.why in (DRIVING, DRY_RUN, REACHED) else level
        values = {"v [m/s]": f"{v:.3f}", "w [rad/s]": f"{w:.3f}"}
        values |= {"filters": command.intervention} if command.intervention else {}
        values |= {f"finding {number}": finding.message for number, finding in enumerate(self._findings, 1)}
        stamp = round(self._node.now() * BILLION)
        self._diagnostics.publish(Diagnostics(stamp, level, f"{NODE_NAME}: policy", command.why, values))


def _print(line: str) -> None:
    print(line, flush=True)


def _remove_numbers(message: str) -> str:
    """Remove the numbers, because messages that differ only in numbers are printed once."""
    return re.sub(r"[\d.]+", "", message)
