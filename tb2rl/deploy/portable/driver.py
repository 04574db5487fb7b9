"""Drives one robot by a policy: scan, odometry and bumper in, velocity commands out.

The driver has no clock and no threads. The caller passes times [s] of one clock and asks for a command ten times a
second or more often. The policy decides once per control step; stale data is noticed at the next question.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Sequence

import numpy as np

from tb2rl.envs.filters import Filter, SpeedLimits

from .path import PlannedPath
from .policy_contract import Point, Policy, Pose, SensorData, Speeds, are_usable
from .preflight import STALE, Finding, Inputs, check_inputs, missing
from .scan import Scan
from .scan_reader import Mounting, ScanReader

DRIVING, DRY_RUN, NOT_STARTED = "driving", "dry run", "not started"
BUMPED, REACHED, STOPPED = "the bumper was touched", "the goal is reached", "told to stop"
_STILL: Speeds = (0.0, 0.0)
_EARLY = 0.1  # share of the control step by which a question may come early, because clocks jitter


@dataclass(frozen=True)
class Command:
    """The command for the base.

    Attributes:
        v: Forward [m/s].
        w: To the left [rad/s].
        why: "driving", or why the robot stands, in plain words.
        wanted: The command that a dry run withholds; else v and w.
    """

    v: float
    w: float
    why: str
    wanted: Speeds = _STILL


class Driver:
    """Drives one robot by a policy.

        driver = Driver(policy)
        driver.see_scan(Scan(ranges, angle_min, angle_increment, range_min, range_max), stamp)
        driver.start()
        command = driver.command(now)  # command.v, command.w, command.why

    The robot stands until `start`, while data that the policy needs is missing, and while data is older than half a
    second. A touch of the bumper and `stop` end the drive until the next `start`; a goal ends it until there is another
    goal. After every stop the policy starts a new episode.

    Args:
        policy: The policy.
        limits: Speed limits of this robot; faster commands are slowed down on the same arc.
        mounting: Where its scanner is; None: above the middle of the axle, looking forward.
        dry_run: Whether to stand and only report the commands.
        filters: Filters of the commands, before the limits; None: the policy's own `filters`, if it has any.
    """

    def __init__(
        self,
        policy: Policy,
        limits: SpeedLimits | None = None,
        mounting: Mounting | None = None,
        dry_run: bool = False,
        filters: Sequence[Filter] | None = None,
    ) -> None:
        self._policy, self._needs, self._dry_run = policy, policy.needs, dry_run
        self._limits = limits or SpeedLimits()
        self._filters = [*(getattr(policy, "filters", ()) if filters is None else filters), self._limits]
        self._reader, self._inputs = ScanReader(policy.needs, mounting), Inputs()
        self._reached: Point | None = None  # the last goal
        self._halt = NOT_STARTED  # why the robot stands until `start`; "": it does not
        self._in_episode = False
        self._wanted, self._driven = _STILL, _STILL
        self._due = -math.inf  # time of the next decision

    def see_scan(self, scan: Scan, stamp: float) -> None:
        """Take a scan of a time [s]."""
        stamps = self._inputs.scan_stamps
        if stamps and not stamp > stamps[-1]:
            stamps.clear()  # the clock was set back
        stamps.append(stamp)
        self._inputs.scan = scan

    def see_odometry(self, pose: Pose, twist: Speeds, stamp: float) -> None:
        """Take pose and twist of a time [s]; ignore them if a number is not finite or is larger than `LARGEST`."""
        if are_usable((*pose, *twist)):
            self._inputs.pose, self._inputs.twist, self._inputs.odometry_stamp = pose, twist, stamp

    def bump(self) -> None:
        """Stand until the next `start`, because the base touches something."""
        self.stop(BUMPED)

    def set_goal(self, goal: Point) -> None:
        """Set the goal, x, y [m] in the odometry frame.

        Raises:
            ValueError: If a number is not finite, or larger than `LARGEST`.
        """
        if not are_usable(goal):
            raise ValueError("a goal has a number that is not finite, or too large: {}, {}".format(*goal))
        if self._inputs.goal is None or math.dist(self._inputs.goal, goal) > self._needs.goal_radius:
            self._in_episode = False  # another goal starts another episode
        self._inputs.goal = goal

    def set_plan(self, points: np.ndarray) -> None:
        """Set the path to follow, x, y [m] in the odometry frame, shape (points, 2); its end is the goal.

        Raises:
            ValueError: If it is not one.
        """
        self._inputs.plan = plan = PlannedPath(points)
        self.set_goal(plan.end)

    def start(self) -> None:
        """Drive as soon as the needed data is there."""
        self._halt, self._reached, self._in_episode = "", None, False

    def stop(self, why: str = STOPPED) -> None:
        """Stand until the next `start`."""
        self._halt = why

    def preflight(self) -> list[Finding]:
        """What does not fit, by the data so far."""
        problem = self._reader.read(self._inputs.scan).problem if self._inputs.scan else ""
        return check_inputs(self._needs, self._inputs, problem, self._limits)

    def command(self, now: float) -> Command:
        """The command for the base at this time [s]."""
        why = self._halt or self._missing_data(now) or self._arrival()
        if not why and self._is_due(now):
            why = self._decide()
        if why:
            self._in_episode, self._driven = False, _STILL
            return Command(0.0, 0.0, why)
        self._driven = _STILL if self._dry_run else self._wanted
        return Command(*self._driven, DRY_RUN if self._dry_run else DRIVING, self._wanted)

    def _missing_data(self, now: float) -> str:
        """What the policy waits for; "": nothing."""
        inputs, needs = self._inputs, self._needs
        old = stale("scan", now - inputs.scan_stamps[-1]) if inputs.scan else ""
        waits = [f"waiting for {name}" for name in missing(needs, inputs)]
        if old or waits:
            return old or waits[0]
        return stale("odometry", now - inputs.odometry_stamp) if needs.uses_odometry or needs.goal else ""

    def _arrival(self) -> str:
        goal = self._inputs.goal
        if not self._needs.goal or goal is None:
            return ""
        if math.dist(self._inputs.pose[:2], goal) <= self._needs.goal_radius:
            self._reached = goal
        return REACHED if self._reached == goal else ""

    def _is_due(self, now: float) -> bool:
        """Whether the policy has to decide: at the start of an episode, then once in each control step."""
        period = self._needs.period
        late = now - self._due
        if self._in_episode and -2.0 * period < late < -_EARLY * period:
            return False
        self._due = self._due + period if self._in_episode and abs(late) < 0.5 * period else now + period
        return True

    def _decide(self) -> str:
        """Ask the policy for the next command; returns why there is none, else ""."""
        inputs, needs = self._inputs, self._needs
        assert inputs.scan is not None
        beams = self._reader.read(inputs.scan)
        if beams.problem:
            return beams.problem
        if not self._in_episode:
            self._policy.reset()
            for each in self._filters:
                each.reset(1)
        self._in_episode = True
        plan = inputs.plan if needs.goal == "plan" else None
        waypoint = plan.lookahead_point(inputs.pose, needs.lookahead) if plan else None
        sensed = SensorData(beams.ranges, inputs.pose, inputs.twist, False, self._driven, inputs.goal, waypoint)
        command = self._policy.act(sensed)
        wanted = self._filtered(command, sensed) if all(map(math.isfinite, command)) else command
        if not all(map(math.isfinite, wanted)):
            return "the policy gave no speeds, but {} and {}".format(*wanted)
        self._wanted = wanted
        return ""

    def _filtered(self, command: Speeds, sensed: SensorData) -> Speeds:
        names = ("ranges", "pose", "twist", "bumped", "command")
        robot_state: Any = SimpleNamespace(**{name: np.array([getattr(sensed, name)]) for name in names})
        commands = np.array([command])
        for each in self._filters:
            commands = each(commands, robot_state)
        v, w = commands[0].tolist()
        return v, w


def stale(name: str, age: float) -> str:
    """Why data of this age [s] is of no use; "": it is current."""
    if -STALE <= age <= STALE:
        return ""
    if age < -STALE:
        return f"the last {name} is stamped {-age:.1f} s ahead: the clocks differ"
    return f"the last {name} is {age:.1f} s old"  # NaN, too
