"""Drives one robot by a policy: scan, odometry and bumper in, two speeds out.

It has no clock and no threads. Whoever carries the messages says when each was made and what time it is, in seconds of
one clock, and asks for a command ten times a second or more often: the policy decides as seldom as it was trained to,
and that data went stale is noticed at the next question.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional

import numpy as np

from .policy_contract import Point, Policy, Pose, Sensed, Speeds, are_usable
from .preflight import STALE, Finding, Limits, Situation, find_misfits
from .readings import Scan
from .scan import Mounting, ScanReader
from .way import PlannedWay, Planner, distance

DRIVING, DRY_RUN, NOT_STARTED = "driving", "dry run", "not started"
BUMPED, REACHED, TOLD_TO_STOP = "the bumper was touched", "the goal is reached", "told to stop"
_STILL: Speeds = (0.0, 0.0)
_EARLY = 0.1  # share of the control step by which a question may come early: clocks jitter


@dataclass(frozen=True)
class Command:
    """What to tell the base now.

    Attributes:
        v: Ahead [m/s].
        w: To the left [rad/s].
        why: "driving", or why the robot is to stand, in plain words.
        wanted: The speeds that a dry run does not drive; else v and w.
    """

    v: float
    w: float
    why: str
    wanted: Speeds = _STILL


class Driver:
    """A policy at the wheel of one robot.

        driver = Driver(policy)
        driver.see_scan(Scan(ranges, angle_min, angle_increment, range_min, range_max), stamp)
        driver.start()
        command = driver.command(now)  # command.v, command.w, command.why

    It stands until `start`, while it waits for what the policy needs, and while data is older than half a second; then
    it drives on. A touch of the bumper and `stop` end the drive until the next `start`, a goal that is reached until
    there is another. After every stop the policy begins anew: it remembers nothing of what was before.

    Args:
        policy: What decides.
        limits: What this robot can do, and is to do, at most; what is faster is slowed down on the same arc.
        mounting: Where its scanner is; None: above the middle of the axle, looking ahead.
        planner: What knows the way, for a policy that follows one; or see `set_plan`.
        dry_run: Whether it only says what it would drive.
    """

    def __init__(
        self,
        policy: Policy,
        limits: Optional[Limits] = None,
        mounting: Optional[Mounting] = None,
        planner: Optional[Planner] = None,
        dry_run: bool = False,
    ) -> None:
        self._policy, self._needs, self._dry_run = policy, policy.needs, dry_run
        self._limits, self._planner = limits or Limits(), planner
        self._reader = ScanReader(policy.needs, mounting)
        self._scan: Optional[Scan] = None
        self._scanned: Deque[float] = deque(maxlen=20)  # when
        self._pose: Pose = (0.0, 0.0, 0.0)
        self._twist, self._counted = _STILL, math.nan
        self._goal: Optional[Point] = None
        self._reached: Optional[Point] = None  # the goal that was
        self._halt = NOT_STARTED  # why it stands whatever comes in; "": it does not
        self._going = False  # whether the policy is in the middle of an episode
        self._wanted, self._told = _STILL, _STILL
        self._due = -math.inf  # when the policy is to decide next

    def see_scan(self, scan: Scan, stamp: float) -> None:
        """Take what the scanner measured at a time [s]."""
        if self._scanned and not stamp > self._scanned[-1]:
            self._scanned.clear()  # the clock was set back
        self._scan = scan
        self._scanned.append(stamp)

    def see_odometry(self, pose: Pose, twist: Speeds, stamp: float) -> None:
        """Take where the robot is by its odometry, and how fast, at a time [s].

        If a number is not finite, or larger than `LARGEST`, it is ignored: then the odometry before becomes stale.
        """
        if are_usable((*pose, *twist)):
            self._pose, self._twist, self._counted = pose, twist, stamp

    def bump(self) -> None:
        """The base touches something: stand until the next `start`."""
        self.stop(BUMPED)

    def set_goal(self, goal: Point) -> None:
        """Where to get, x, y [m] in the odometry frame.

        Raises:
            ValueError: If a number is not finite, or larger than `LARGEST`.
        """
        if not are_usable(goal):
            raise ValueError("a goal has a number that is not finite, or too large: {}, {}".format(*goal))
        if self._goal is None or distance(self._goal, goal) > self._needs.goal_radius:
            self._going = False  # another way, another episode
        self._goal = goal

    def set_plan(self, points: np.ndarray) -> None:
        """A way to follow, x, y [m] in the odometry frame, shape (points, 2); its end is the goal.

        Raises:
            ValueError: If it is not one.
        """
        self._planner = way = PlannedWay(points)
        self.set_goal(way.end)

    def start(self) -> None:
        """Drive, as soon as there is what it takes."""
        self._halt, self._reached, self._going = "", None, False

    def stop(self, why: str = TOLD_TO_STOP) -> None:
        """Stand until the next `start`."""
        self._halt = why

    def preflight(self) -> List[Finding]:
        """What does not fit, by all that has come in so far; nothing: it fits."""
        period = math.nan
        if len(self._scanned) > 1:
            period = (self._scanned[-1] - self._scanned[0]) / (len(self._scanned) - 1)
        lacks = self._reader.read(self._scan).lacks if self._scan else ""
        counts, plans = not math.isnan(self._counted), self._planner is not None
        situation = Situation(self._scan, period, lacks, counts, self._goal is not None, plans, self._limits)
        return find_misfits(self._needs, situation)

    def command(self, now: float) -> Command:
        """What to tell the base at this time [s]."""
        why = self._halt or self._waits(now) or self._arrived()
        if not why and self._is_due(now):
            why = self._decide(now)
        if why:
            self._going, self._told = False, _STILL
            return Command(0.0, 0.0, why)
        self._told = _STILL if self._dry_run else self._wanted
        return Command(*self._told, DRY_RUN if self._dry_run else DRIVING, self._wanted)

    def _waits(self, now: float) -> str:
        """What it waits for; "": nothing."""
        if self._scan is None:
            return "waiting for a scan"
        old = stale("scan", now - self._scanned[-1])
        needs = self._needs
        if old or not (needs.uses_odometry or needs.goal):
            return old
        if math.isnan(self._counted):
            return "waiting for odometry"
        if needs.goal and self._goal is None:
            return "waiting for a goal"
        if needs.goal == "plan" and self._planner is None:
            return "waiting for a plan"
        return stale("odometry", now - self._counted)

    def _arrived(self) -> str:
        if not self._needs.goal or self._goal is None:
            return ""
        if distance(self._pose[:2], self._goal) <= self._needs.goal_radius:
            self._reached = self._goal
        return REACHED if self._reached == self._goal else ""

    def _is_due(self, now: float) -> bool:
        """Whether the policy is to decide: first, and then once in each control step."""
        period = self._needs.period
        late = now - self._due
        if self._going and -2.0 * period < late < -_EARLY * period:
            return False
        self._due = self._due + period if self._going and abs(late) < 0.5 * period else now + period
        return True

    def _decide(self, now: float) -> str:
        """Ask the policy; returns why it could not be asked, else ""."""
        assert self._scan is not None
        seen = self._reader.read(self._scan)
        if seen.lacks:
            return seen.lacks
        waypoint = None
        if self._needs.goal == "plan" and self._planner and self._goal:
            waypoint = self._planner.lookahead_point(self._pose, self._goal, self._needs.lookahead)
            if waypoint is None:
                return "the planner finds no way to the goal"
        if not self._going:
            self._policy.begin()
        self._going = True
        sensed = Sensed(seen.ranges, self._pose, self._twist, False, self._told, self._goal, waypoint)
        v, w = self._policy.act(sensed)
        if not (math.isfinite(v) and math.isfinite(w)):
            return "the policy gave no speeds, but {} and {}".format(v, w)
        self._wanted = self._limits.slowed(v, w)
        return ""


def stale(what: str, age: float) -> str:
    """Why data of this age [s] cannot be driven by; "": it can."""
    if -STALE <= age <= STALE:
        return ""
    if age < -STALE:
        return "the last {} is stamped {:.1f} s ahead: the clocks differ".format(what, -age)
    return "the last {} is {:.1f} s old".format(what, age)  # NaN, too
