"""Connects a driver to ROS: sensors to the driver, its commands to the wheels."""

from __future__ import annotations

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
from tb2rl.deploy import Command, Driver, Finding, Needs, TrainedPolicy
from tb2rl.deploy.portable.driver import DRIVING, DRY_RUN, REACHED
from tb2rl.deploy.portable.policy_contract import are_usable
from tb2rl.deploy.portable.preflight import STALE
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros.connection import create_node
from tb2rl.deploy.ros.messages import BILLION, BumperEvent, Diagnostics, Goal, LaserScan, Odometry, Plan, Twist
from tb2rl.deploy.ros.node import TRIGGER, Node, NullPublisher
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, DriverTopics, parse_topics
from tb2rl.deploy.ros.wall_clock import WallClock
from tb2rl.runs.loading import load

NAME = "tb2rl_driver"  # of the node
_MISSED = 1.5  # control steps without a scan after which the policy decides by the last one again
_PREFLIGHT_SCANS = 5  # before the preflight, which checks the scan rate, too
_MAX_STOPS = 10  # zero commands in a row; then other programs may drive the robot
_MAX_LATENCIES = 10_000  # stored for the final report
_OTHER_CLOCK = 1e6  # [s] larger differences are those between wall-clock time and simulated time
# All in seconds of wall-clock time:
_POLL = 0.05  # between two checks for stale data
_FROZEN = 0.2  # after which a simulated time that does not change stands still
_UNANSWERED = 0.45  # for which the wheels may go by the last command while simulated time stands still
_PATIENCE = 3.0  # after which missing sensors are reported
_REPORT_PERIOD = 1.0


def run(options: argparse.Namespace) -> None:
    """Drive until a signal ends the program."""
    if options.ros_args and options.ros == 1:
        raise InputError("--ros-args is for --ros 2")
    topics = parse_topics(options.topics, TURTLEBOT2[options.ros])
    mounting, limits = parse_mounting(options.mounting), parse_limits(options.speed)
    th.set_num_threads(1)  # a decision is too small to be parallel, and the robot's other programs need the processor
    policy = TrainedPolicy(load(options.policy, options.trust))
    driver = Driver(policy, limits, mounting, dry_run=options.dry_run)
    with closing(create_node(options.ros, NAME, options.ros_args)) as node:
        ending = threading.Event()
        for sign in termination_signals():
            signal.signal(sign, lambda *_: ending.set())
        output = "nothing: a dry run" if options.dry_run else f"commands to {topics.velocity}"
        _print(f"{options.policy} on ROS {options.ros}: scans from {topics.scan}, {output}")
        with closing(DriverNode(driver, policy.needs, node, topics, options.wait, options.dry_run)) as driver_node:
            driver_node.run(ending)


class DriverNode:
    """Runs a driver on a robot of ROS; prints its state and the reason for which it stands.

    Args:
        needs: Requirements of the driver's policy.
        waits: Whether it waits for the service `~/start`; else it starts as soon as the preflight finds no error.
        dry_run: Whether it publishes no commands.
    """

    def __init__(
        self,
        driver: Driver,
        needs: Needs,
        node: Node,
        topics: DriverTopics,
        waits: bool,
        dry_run: bool,
        wall: WallClock | None = None,
    ) -> None:
        self._driver, self._needs, self._node, self._dry_run = driver, needs, node, dry_run
        self._wall, self._lock = wall or WallClock(), threading.RLock()  # shared with the threads of ROS
        self._sim_time = node.uses_sim_time()
        self._failure: Exception | None = None  # of a callback
        self._starts_itself, self._stops_left, self._scans, self._scan_stamp = not waits, _MAX_STOPS, 0, math.nan
        self._time, self._decided = math.nan, -math.inf
        self._time_changed = self._answered = self._reported = self._began = self._wall.now()
        self._command, self._printed, self._findings = Command(0.0, 0.0, ""), "", list[Finding]()
        self._early_goal: Goal | Plan | None = None  # until odometry names its frame
        self._frame, self._warned = "", False  # of odometry
        self._latencies: deque[tuple[float, float]] = deque(maxlen=_MAX_LATENCIES)  # [s] wall-clock, processor time
        self._velocity = node.create_publisher(topics.velocity, Twist)
        self._diagnostics = node.create_publisher("/diagnostics", Diagnostics)
        self._subscribe(topics)
        node.create_service("~/start", TRIGGER, self._guarded(self._try_to_start))
        node.create_service("~/stop", TRIGGER, self._guarded(self._stop))

    def _subscribe(self, topics: DriverTopics) -> None:
        node, guarded = self._node, self._guarded
        node.create_subscription(topics.scan, LaserScan, guarded(self._on_scan))
        node.create_subscription(topics.odometry, Odometry, guarded(self._on_odometry))
        bumper = node.create_subscription(topics.bumper, BumperEvent, guarded(self._on_bumper))
        if isinstance(bumper, NullPublisher):
            _print("the bumper is ignored: the messages of the Kobuki are not installed")
        if self._needs.goal == "goal":
            node.create_subscription(topics.goal, Goal, guarded(self._on_goal))
        if self._needs.goal == "plan":
            node.create_subscription(topics.plan, Plan, guarded(self._on_goal))

    def run(self, ending: threading.Event) -> None:
        """Drive until ROS ends the node, or the event is set."""
        while not (self._node.is_shutdown() or self._wall.wait(ending, _POLL)):
            if self._failure:
                raise self._failure
            with self._lock:
                self._poll()

    def close(self) -> None:
        """Stop the wheels, and print the latency of answers."""
        with self._lock:
            self._starts_itself = False
            self._driver.stop("the node ends")
            self._stops_left = _MAX_STOPS
        for _ in range(_MAX_STOPS):
            with self._lock, suppress(OSError):  # the terminal may be closed
                self._publish(self._driver.command(self._node.now()))
            self._wall.sleep(0.02)  # so that the last commands arrive
        if self._latencies:
            wall, cpu = (_percentiles(times) for times in zip(*self._latencies, strict=True))
            with suppress(OSError):
                _print(f"{len(self._latencies)} scans, from scan to command: {wall} (of processor time: {cpu})")

    # ---- called by the threads of ROS

    def _guarded(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Run a callback under the lock; an error ends the node, and thereby stops the wheels."""

        def guarded(*message: Any) -> Any:
            with self._lock:
                try:
                    return callback(*message)
                except Exception as error:
                    self._failure = error
                    return f"the node ends: {error}"

        return guarded

    def _on_scan(self, scan: LaserScan) -> None:
        began, worked = time.perf_counter(), time.thread_time()
        self._scans, self._scan_stamp = self._scans + 1, scan.stamp / BILLION
        self._driver.see_scan(scan.to_scan(), self._scan_stamp)
        if self._scans == 1:
            self._compare_clocks()
            self._stops_left = _MAX_STOPS  # a simulation in lockstep waits for answers from the first scan on
        if self._starts_itself and self._scans >= _PREFLIGHT_SCANS:
            self._try_to_start()
        # In simulated time the clock of the same instant may arrive after the scan.
        self._decide(self._scan_stamp if self._sim_time else self._node.now())
        self._latencies.append((time.perf_counter() - began, time.thread_time() - worked))

    def _compare_clocks(self) -> None:
        if not self._sim_time and abs(self._node.now() - self._scan_stamp) > _OTHER_CLOCK:
            _print(
                "mind: the scans have the time of another clock; if that of a simulation, start this node after it; "
                "in ROS 2 with --ros-args -p use_sim_time:=true"
            )

    def _on_odometry(self, odometry: Odometry) -> None:
        if not odometry.is_usable:
            if not self._warned:
                _print("mind: odometry is ignored if its orientation is no rotation or a number is not finite")
            self._warned = True
            return
        self._driver.see_odometry(odometry.pose, odometry.twist, odometry.stamp / BILLION)
        self._frame = odometry.frame
        if self._early_goal:
            self._on_goal(self._early_goal)

    def _on_bumper(self, event: BumperEvent) -> None:
        if event.pressed:
            self._starts_itself = False
            self._driver.bump()
            self._decide(self._node.now())

    def _on_goal(self, goal: Goal | Plan) -> None:
        self._early_goal = None
        if not self._frame:
            self._early_goal = goal
        elif goal.frame != self._frame:
            name = "goal" if isinstance(goal, Goal) else "plan"
            _print(f"this {name} is refused: it is in the frame {goal.frame!r}, and the odometry in {self._frame!r}")
        elif isinstance(goal, Goal) and are_usable(goal.position):
            self._driver.set_goal(goal.position)
            _print(f"the goal is ({goal.position[0]:.2f}, {goal.position[1]:.2f}) in {self._frame!r}")
        elif isinstance(goal, Plan) and len(goal.points) and are_usable(goal.points):
            self._driver.set_plan(goal.points)
        else:
            _print("this goal is refused: its numbers are no position")

    def _stop(self) -> str:
        self._starts_itself = False
        self._driver.stop()
        self._decide(self._node.now())
        return ""

    # ---- called with the lock held

    def _try_to_start(self) -> str:
        """Start unless the preflight finds errors; return these."""
        findings = self._driver.preflight()
        for finding in findings:
            if _without_numbers(finding.sentence) not in {_without_numbers(known.sentence) for known in self._findings}:
                _print(f"{'it stands' if finding.serious else 'mind'}: {finding.sentence}")
        self._findings = findings
        errors = "; ".join(finding.sentence for finding in findings if finding.serious)
        if not errors:
            self._starts_itself = False
            self._driver.start()
        return errors

    def _poll(self) -> None:
        """React to stale data and to a simulated time that stands still."""
        now, wall = self._node.now(), self._wall.now()
        if now != self._time:
            self._time, self._time_changed = now, wall
        if self._starts_itself and wall > self._began + _PATIENCE:
            self._began = wall
            self._try_to_start()
        if wall > self._time_changed + _FROZEN and wall > self._answered + _UNANSWERED:
            self._publish(Command(0.0, 0.0, "simulated time stands still"))
        elif now > self._scan_stamp + STALE or not self._decided <= now < self._decided + _MISSED * self._needs.period:
            self._decide(now)
        if wall > self._reported + _REPORT_PERIOD:
            self._reported = wall
            self._report()

    def _decide(self, now: float) -> None:
        self._decided, self._answered = now, self._wall.now()
        self._publish(self._driver.command(now))

    def _publish(self, command: Command) -> None:
        if command.why == DRIVING:
            self._stops_left = _MAX_STOPS
        elif self._velocity.connected():  # a command that no node receives does not count
            self._stops_left = max(0, self._stops_left - 1)
        if not self._dry_run and self._stops_left > 0:
            self._velocity.publish(Twist(command.v, command.w))
        self._command = command
        if _without_numbers(command.why) != self._printed and not self._starts_itself:  # else the preflight says why
            self._printed = _without_numbers(command.why)
            _print(command.why if command.why in (DRIVING, DRY_RUN) else f"it stands: {command.why}")

    def _report(self) -> None:
        command, errors = self._command, any(finding.serious for finding in self._findings)
        if command.why == DRY_RUN:
            _print(f"it would drive {command.wanted[0]:.2f} m/s ahead, {command.wanted[1]:.2f} rad/s to the left")
        values = {"v [m/s]": f"{command.wanted[0]:.3f}", "w [rad/s]": f"{command.wanted[1]:.3f}"}
        values |= {f"finding {number}": finding.sentence for number, finding in enumerate(self._findings, 1)}
        level = "OK" if command.why in (DRIVING, DRY_RUN, REACHED) else "ERROR" if errors else "WARN"
        stamp = round(self._node.now() * BILLION)
        self._diagnostics.publish(Diagnostics(stamp, level, f"{NAME}: policy", command.why, values))


def _print(line: str) -> None:
    print(line, flush=True)


def _without_numbers(sentence: str) -> str:
    """Return a sentence without its numbers: one that differs in numbers only is not printed again."""
    return re.sub(r"[\d.]+", "", sentence)


def _percentiles(seconds: tuple[float, ...]) -> str:
    median, most = np.percentile(seconds, [50, 99]) * 1e3
    return f"{median:.1f} ms, 99 % within {most:.1f} ms"
