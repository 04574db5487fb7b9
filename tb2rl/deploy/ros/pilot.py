"""A driver on a graph of ROS: hands it what the robot senses, and tells the wheels what it says; it knows no ROS."""

from __future__ import annotations

import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from tb2rl.deploy import Command, Driver, Finding, Needs
from tb2rl.deploy import Scan as Turn
from tb2rl.deploy.portable.driver import DRIVING, DRY_RUN, REACHED
from tb2rl.deploy.portable.policy_contract import are_usable
from tb2rl.deploy.portable.preflight import STALE
from tb2rl.deploy.ros.graph import TRIGGER, Graph, Nobody
from tb2rl.deploy.ros.messages import BILLION, Bump, Goal, Odometry, Plan, Report, Scan, Velocity
from tb2rl.deploy.ros.topics import DriverTopics

NAME = "tb2rl_driver"  # of the node
_LOOK_UP = 0.05  # [s] of wall-clock time between looks whether something went stale
_REST = 1.5  # control steps without a scan after which the policy goes by the last one again
_JUDGED = 5  # scans before a preflight: how often they come is among what it judges
_FROZEN = 0.2  # [s] of wall-clock time in which simulated time does not go on: it stands still
_UNANSWERED = 0.45  # [s] of wall-clock time; so long the wheels may then go by the last command
_PATIENCE = 3.0  # [s] of wall-clock time; it waits no longer for them
_EACH = 1.0  # [s] of wall-clock time between reports
_ANOTHER = 1e6  # [s] between two clocks of which one counts from the beginning of a simulation
_STOPS = 10  # times that the wheels are told to stand; then somebody else may drive the robot
_TIMES = 10_000  # answers that are remembered


class Pilot:
    """A driver at the wheel of the robot of a graph. Says in plain lines what it does, and why it stands.

    Args:
        driver: What drives.
        needs: What its policy needs.
        graph: Where.
        topics: By which names.
        waits: Whether it waits for the service `~/start`; else it starts as soon as nothing serious is in the way.
        dry_run: Whether it tells the wheels nothing.
    """

    def __init__(
        self, driver: Driver, needs: Needs, graph: Graph, topics: DriverTopics, waits: bool, dry_run: bool
    ) -> None:
        self._driver, self._needs, self._graph, self._dry_run = driver, needs, graph, dry_run
        self._turn = threading.Lock()  # whose it is: ours, or that of a thread of ROS
        self._simulated = graph.time_is_simulated()
        self._failure: Exception | None = None  # in a thread of ROS
        self._armed, self._stops, self._scans, self._scanned = not waits, _STOPS, 0, math.nan
        self._clock, self._asked = math.nan, -math.inf
        self._moved = self._answered = self._reported = self._began = time.monotonic()
        self._command, self._told, self._findings = Command(0.0, 0.0, ""), "", list[Finding]()
        self._goal: Goal | Plan | None = None  # until it is known in which frame the odometry counts
        self._frame, self._warned = "", False  # of odometry
        self._took: deque[tuple[float, float]] = deque(maxlen=_TIMES)  # [s] of wall-clock and of processor time
        self._velocity = graph.publisher(topics.velocity, Velocity)
        self._diagnostics = graph.publisher("/diagnostics", Report)
        self._listen(topics)
        graph.serve("~/start", TRIGGER, self._guarded(self._try_to_start))
        graph.serve("~/stop", TRIGGER, self._guarded(self._stop))

    def _listen(self, topics: DriverTopics) -> None:
        graph, guarded = self._graph, self._guarded
        graph.listen(topics.scan, Scan, guarded(self._see_scan))
        graph.listen(topics.odometry, Odometry, guarded(self._see_odometry))
        if isinstance(graph.listen(topics.bumper, Bump, guarded(self._feel)), Nobody):
            _tell("the bumper is not heard: the messages of the Kobuki are not installed")
        if self._needs.goal == "goal":
            graph.listen(topics.goal, Goal, guarded(self._hear_goal))
        if self._needs.goal == "plan":
            graph.listen(topics.plan, Plan, guarded(self._hear_goal))

    def run(self, ending: threading.Event) -> None:
        """Drive until ROS ends the node, or the event is set."""
        while not (self._graph.is_over() or ending.wait(_LOOK_UP)):
            if self._failure:
                raise self._failure
            with self._turn:
                self._look()

    def close(self) -> None:
        """Tell the wheels to stand, and say how fast scans were answered."""
        with self._turn:
            self._armed = False
            self._driver.stop("the node ends")
            self._stops = _STOPS
        for _ in range(_STOPS):
            with self._turn, suppress(OSError):  # the terminal may be gone
                self._say(self._driver.command(self._graph.now()))
            time.sleep(0.02)  # the last words shall be heard
        if self._took:
            wall, cpu = (_percentiles(times) for times in zip(*self._took, strict=True))
            with suppress(OSError):
                _tell(f"{len(self._took)} scans, from scan to command: {wall} (of processor time: {cpu})")

    # ---- what the threads of ROS call

    def _guarded(self, called: Callable[..., Any]) -> Callable[..., Any]:
        """One at a time; an error ends the node, and so stops the wheels, but not the thread of ROS."""

        def guarded(*message: Any) -> Any:
            with self._turn:
                try:
                    return called(*message)
                except Exception as error:
                    self._failure = error
                    return f"the node ends: {error}"

        return guarded

    def _see_scan(self, scan: Scan) -> None:
        began, worked = time.perf_counter(), time.thread_time()
        turn = Turn(scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        self._scans, self._scanned = self._scans + 1, scan.stamp / BILLION
        self._driver.see_scan(turn, self._scanned)
        if self._scans == 1:
            self._compare_clocks()
            self._stops = _STOPS  # a simulation in lockstep waits for answers from the first scan on
        if self._armed and self._scans >= _JUDGED:
            self._try_to_start()
        # The clock comes on a topic of its own, maybe after the scan of the same simulated instant.
        self._ask(self._scanned if self._simulated else self._graph.now())
        self._took.append((time.perf_counter() - began, time.thread_time() - worked))

    def _compare_clocks(self) -> None:
        if not self._simulated and abs(self._graph.now() - self._scanned) > _ANOTHER:
            _tell(
                "mind: the scans have the time of another clock; if that of a simulation, start this node after it; "
                "in ROS 2 with --ros-args -p use_sim_time:=true"
            )

    def _see_odometry(self, odometry: Odometry) -> None:
        if not odometry.is_usable:
            if not self._warned:
                _tell("mind: odometry is ignored if its orientation is no rotation or a number is not finite")
            self._warned = True
            return
        self._driver.see_odometry(odometry.pose, odometry.twist, odometry.stamp / BILLION)
        self._frame = odometry.frame
        if self._goal:
            self._hear_goal(self._goal)

    def _feel(self, bump: Bump) -> None:
        if bump.pressed:
            self._armed = False
            self._driver.bump()
            self._ask(self._graph.now())

    def _hear_goal(self, goal: Goal | Plan) -> None:
        self._goal = None
        if not self._frame:
            self._goal = goal
        elif goal.frame != self._frame:
            what = "goal" if isinstance(goal, Goal) else "plan"
            _tell(f"this {what} is refused: it is in the frame {goal.frame!r}, and the odometry in {self._frame!r}")
        elif isinstance(goal, Goal) and are_usable(goal.place):
            self._driver.set_goal(goal.place)
            _tell(f"the goal is ({goal.place[0]:.2f}, {goal.place[1]:.2f}) in {self._frame!r}")
        elif isinstance(goal, Plan) and len(goal.points) and are_usable(goal.points):
            self._driver.set_plan(goal.points)
        else:
            _tell("this goal is refused: it is no place")

    def _stop(self) -> str:
        self._armed = False
        self._driver.stop()
        self._ask(self._graph.now())
        return ""

    # ---- what they and our own thread do in turns

    def _try_to_start(self) -> str:
        """Start, unless something serious is in the way: that."""
        findings = self._driver.preflight()
        for finding in findings:
            if _words(finding.sentence) not in {_words(known.sentence) for known in self._findings}:
                _tell(f"{'it stands' if finding.serious else 'mind'}: {finding.sentence}")
        self._findings = findings
        serious = "; ".join(finding.sentence for finding in findings if finding.serious)
        if not serious:
            self._armed = False
            self._driver.start()
        return serious

    def _look(self) -> None:
        """Notice what does not come; a clock of a simulation may stand still."""
        now, wall = self._graph.now(), time.monotonic()
        if now != self._clock:
            self._clock, self._moved = now, wall
        if self._armed and wall > self._began + _PATIENCE:
            self._began = wall
            self._try_to_start()
        if wall > self._moved + _FROZEN and wall > self._answered + _UNANSWERED:
            self._say(Command(0.0, 0.0, "simulated time stands still"))
        elif now > self._scanned + STALE or not self._asked <= now < self._asked + _REST * self._needs.period:
            self._ask(now)
        if wall > self._reported + _EACH:
            self._reported = wall
            self._report()

    def _ask(self, now: float) -> None:
        self._asked, self._answered = now, time.monotonic()
        self._say(self._driver.command(now))

    def _say(self, command: Command) -> None:
        if command.why == DRIVING:
            self._stops = _STOPS
        elif self._velocity.connected():  # what nobody hears does not count
            self._stops = max(0, self._stops - 1)
        if not self._dry_run and self._stops > 0:
            self._velocity.say(Velocity(command.v, command.w))
        self._command = command
        if _words(command.why) != self._told and not self._armed:  # then the preflight says why
            self._told = _words(command.why)
            _tell(command.why if command.why in (DRIVING, DRY_RUN) else f"it stands: {command.why}")

    def _report(self) -> None:
        command, serious = self._command, any(finding.serious for finding in self._findings)
        fine = command.why in (DRIVING, DRY_RUN, REACHED)
        if command.why == DRY_RUN:
            _tell(f"it would drive {command.wanted[0]:.2f} m/s ahead, {command.wanted[1]:.2f} rad/s to the left")
        values = {"v [m/s]": f"{command.wanted[0]:.3f}", "w [rad/s]": f"{command.wanted[1]:.3f}"}
        values |= {f"finding {number}": finding.sentence for number, finding in enumerate(self._findings, 1)}
        level = "OK" if fine else "ERROR" if serious else "WARN"
        stamp = round(self._graph.now() * BILLION)
        self._diagnostics.say(Report(stamp, level, f"{NAME}: policy", command.why, values))


def _tell(line: str) -> None:
    print(line, flush=True)


def _words(sentence: str) -> str:
    """A sentence without its numbers: said once, it is not said again because one of them is another."""
    return re.sub(r"[\d.]+", "", sentence)


def _percentiles(seconds: tuple[float, ...]) -> str:
    median, most = np.percentile(seconds, [50, 99]) * 1e3
    return f"{median:.1f} ms, 99 % within {most:.1f} ms"
