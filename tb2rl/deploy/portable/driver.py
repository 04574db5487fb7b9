"""Drives one robot with a policy: scans, odometry and bumper in, velocity commands out.

The driver has no clock and no threads. The caller passes times [s] of one clock and calls `command` at least ten times
a second. The policy decides once per control step. Each call of `command` checks the age of the data.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from tb2rl.envs.filters import SpeedLimits

from .filter_chain import FilterChain
from .path import PlannedPath
from .policy_contract import Point, Policy, Pose, SensorData, Speeds, are_usable
from .scan_reader import Mounting, Scan, ScanReader

DRIVING, DRY_RUN, NOT_STARTED = "driving", "dry run", "not started"
BUMPED, REACHED, STOPPED = "the bumper was touched", "the goal is reached", "told to stop"
CLIFF, WHEEL_DROP = "a cliff sensor sees no floor", "a wheel hangs in the air"
BUTTON = "a button was pressed"
MAX_AGE = 0.5  # [s] of sensor data; with older data the robot stops
_ZERO_SPEEDS: Speeds = (0.0, 0.0)
_MAX_CLOCK_DIFFERENCE = 1e6  # [s] if the clocks differ by more, one shows simulated and one wall-clock time
_MAX_EARLINESS = 0.1  # [control steps] a decision may come early by this much, because clocks jitter
_MAX_WAIT = 2.0  # [control steps] a decision that lies farther ahead is made at once, because the clock was set back
_MAX_SCAN_PERIOD = 1.2  # [control steps] a warning is given if scans arrive less often
_RANGE_MIN_TOLERANCE = 0.1  # [m] a warning is given if `range_min` exceeds that of the training by more


@dataclass(frozen=True)
class Finding:
    """Missing data, or a mismatch between policy and robot; an error prevents driving, a warning does not."""

    message: str
    is_error: bool


@dataclass(frozen=True)
class Command:
    """The command for the base.

    Attributes:
        v: Forward speed [m/s].
        w: Turn rate to the left [rad/s].
        why: "driving", or the reason for a stop in plain words.
        wanted: The v and w after all filters, which a dry run does not send; zeros if the robot is stopped.
        intervention: Why filters changed the command of the policy; empty if they did not, or do not say.
    """

    v: float
    w: float
    why: str
    wanted: Speeds = _ZERO_SPEEDS
    intervention: str = ""


class Driver:
    """Drives one robot with a policy. Example::

        driver = Driver(policy)
        driver.see_scan(Scan(ranges, angle_min, angle_increment, range_min, range_max), stamp)
        driver.start()
        command = driver.command(now)  # command.v, command.w, command.why

    The robot is stopped until `start`, and while data that the policy needs is missing or older than half a second. A
    contact and `stop` end the drive until the next `start`. A reached goal ends the drive until another goal is set.
    After every stop the policy starts a new episode.

    Args:
        policy: The policy; its `filters`, if it has any, change the commands before the limits. From its attribute
            `safety`, if it has one, the driver makes the safety filter, which comes first.
        limits: Speed limits of this robot; faster commands are slowed down on the same arc.
        mounting: The pose of the scanner; by default above the middle of the axle and facing forward.
        dry_run: Whether to stand still, and only report the commands in `Command.wanted`.
        safe: Setting of the safety filter, "usual", "guaranteed" or "off".

    Attributes:
        filters: The filters, with the number of their interventions.

    Raises:
        ValueError: If the laser of the policy does not suffice for the setting of the safety filter.
    """

    def __init__(
        self,
        policy: Policy,
        limits: SpeedLimits | None = None,
        mounting: Mounting | None = None,
        dry_run: bool = False,
        safe: str = "usual",
    ) -> None:
        self._policy, self.needs, self.dry_run = policy, policy.needs, dry_run
        self._limits, self._reader = limits or SpeedLimits(), ScanReader(policy.needs, mounting)
        self.filters = FilterChain(policy, self._limits, mounting, safe)
        self._scan: Scan | None = None
        self._scan_stamps: deque[float] = deque(maxlen=20)  # [s] of the latest scans, the newest last
        self._needs_odometry = self.needs.uses_odometry or self.needs.goal is not None
        self._pose, self._twist, self._odometry_stamp = (0.0, 0.0, 0.0), _ZERO_SPEEDS, math.nan  # NaN: no odometry yet
        self._goal: Point | None = None
        self._reached_goal: Point | None = None
        self._plan: PlannedPath | None = None
        self._events: set[tuple[str, int]] = set()  # reasons and parts of events that last
        self._stop_reason = NOT_STARTED  # why the robot is stopped until the next `start`, or an empty string
        self._in_episode = False
        self._wanted = self._last_command = _ZERO_SPEEDS
        self._next_decision_time = -math.inf

    def see_scan(self, scan: Scan, stamp: float) -> None:
        """Pass a scan with its time stamp [s]."""
        if self._scan_stamps and not stamp > self._scan_stamps[-1]:
            self._scan_stamps.clear()  # the clock was set back, or the stamp is repeated or NaN
        self._scan_stamps.append(stamp)
        self._scan = scan

    def see_odometry(self, pose: Pose, twist: Speeds, stamp: float) -> bool:
        """Pass pose and twist with their time stamp [s]; returns False and ignores them if a number is unusable."""
        usable = are_usable((*pose, *twist))
        if usable:
            self._pose, self._twist, self._odometry_stamp = pose, twist, stamp
        return usable

    def bump(self) -> None:
        """Report a contact, which stops the robot until the next `start`."""
        self.stop(BUMPED)

    def see_event(self, why: str, is_active: bool, part: int = 0) -> None:
        """Pass the begin or the end of an event of the base, which stops the robot until it has ended and `start`.

        Args:
            why: Reason of the stop, such as `CLIFF`.
            is_active: Whether the event begins.
            part: Number of the part of the base, such as one of several cliff sensors.
        """
        if is_active:
            self._events.add((why, part))
            self.stop(why)
        else:
            self._events.discard((why, part))

    def set_goal(self, goal: Point) -> None:
        """Set the goal, x, y [m] in the odometry frame.

        Raises:
            ValueError: If a number is not finite, or above 1e9 (`MAX_MAGNITUDE`).
        """
        if not are_usable(goal):
            raise ValueError("the goal has a number that is not finite, or too large: {}, {}".format(*goal))
        if self._goal is None or math.dist(self._goal, goal) > self.needs.goal_radius:
            self._in_episode = False  # another goal starts another episode
        self._goal = goal

    def set_plan(self, points: np.ndarray) -> None:
        """Set the path to follow, x, y [m] in the odometry frame, shape (points, 2); its end is the goal.

        Raises:
            ValueError: If there are no points, or a number is not finite, or above 1e9 (`MAX_MAGNITUDE`).
        """
        self._plan = PlannedPath(points)
        self.set_goal(self._plan.end)

    def start(self) -> None:
        """Drive as soon as all needed data has arrived, unless an event of the base lasts."""
        self._stop_reason, self._reached_goal, self._in_episode = self._lasting_event(), None, False

    def stop(self, why: str = STOPPED) -> None:
        """Stop the robot until the next `start`."""
        self._stop_reason = why

    def preflight(self) -> list[Finding]:
        """Missing data, and mismatches of policy and robot in the data that has arrived, errors first."""
        needs, limits, scan, stamps = self.needs, self._limits, self._scan, self._scan_stamps
        event = self._lasting_event()
        errors, warnings = [*([event] if event else []), *self._missing_data()], []
        problem = self._reader.read(scan).problem if scan else ""
        if problem:
            errors.append(problem)
        interval = (stamps[-1] - stamps[0]) / (len(stamps) - 1) if len(stamps) > 1 else math.nan
        if interval >= MAX_AGE:
            errors.append(f"a scan arrives every {interval:.2g} s, but the robot stops after {MAX_AGE:g} s without one")
        elif interval > needs.period * _MAX_SCAN_PERIOD:
            warnings.append(f"a scan arrives every {interval:.2g} s, but the policy decides every {needs.period:g} s")
        if scan and 0.0 < scan.range_max < needs.max_range:  # 0: the scanner does not state it
            training = f"the policy was trained with {needs.max_range:g} m"
            warnings.append(f"beyond {scan.range_max:.3g} m the scanner sees no walls; {training}")
        if scan and scan.range_min > needs.min_range + _RANGE_MIN_TOLERANCE:
            warnings.append(f"the scanner sees nothing nearer than {scan.range_min:.3g} m")
        if needs.max_speed > limits.speed:
            warnings.append(f"the policy's {needs.max_speed:.3g} m/s are limited to {limits.speed:.3g} m/s")
        if needs.max_turn_rate > limits.turn_rate:
            warnings.append(f"the policy's {needs.max_turn_rate:.3g} rad/s are limited to {limits.turn_rate:.3g} rad/s")
        return [Finding(error, True) for error in errors] + [Finding(warning, False) for warning in warnings]

    def command(self, now: float) -> Command:
        """Return the command for the base at the time `now` [s]."""
        why = self._stop_reason or self._data_problem(now) or self._check_arrival_at_goal()
        if not why and self._begin_control_step(now):
            why = self._decide(now)
        if why:
            self._in_episode, self._last_command = False, _ZERO_SPEEDS
            return Command(0.0, 0.0, why)
        self._last_command = _ZERO_SPEEDS if self.dry_run else self._wanted
        why = DRY_RUN if self.dry_run else DRIVING
        return Command(*self._last_command, why, self._wanted, self.filters.intervention)

    def _lasting_event(self) -> str:
        """The reason of an event that lasts, or an empty string."""
        return min(self._events)[0] if self._events else ""

    def _missing_data(self) -> list[str]:
        """Describe the data that the policy needs and that has not arrived yet."""
        goal_kind = self.needs.goal
        missing = {
            "scan": self._scan is None,
            "odometry": self._needs_odometry and math.isnan(self._odometry_stamp),
            "goal": goal_kind is not None and self._goal is None,
            "plan": goal_kind == "plan" and self._plan is None,
        }
        return [f"no {name} has arrived yet" for name, is_missing in missing.items() if is_missing]

    def _data_problem(self, now: float) -> str:
        """Describe the missing or stale data that stops the robot; an empty string if there is none."""
        scan_problem = age_problem("scan", now - self._scan_stamps[-1]) if self._scan else ""
        missing = self._missing_data()
        if scan_problem or missing:
            return scan_problem or missing[0]
        return age_problem("odometry", now - self._odometry_stamp) if self._needs_odometry else ""

    def _check_arrival_at_goal(self) -> str:
        """Record a reached goal; returns `REACHED` if it is or was reached, else an empty string."""
        if self._goal is None or not self.needs.goal:
            return ""
        if math.dist(self._pose[:2], self._goal) <= self.needs.goal_radius:
            self._reached_goal = self._goal
        return REACHED if self._reached_goal == self._goal else ""

    def _begin_control_step(self, now: float) -> bool:
        """Begin a control step in a new episode, or when the last step is over; returns whether one began."""
        period, delay = self.needs.period, now - self._next_decision_time
        if self._in_episode and -_MAX_WAIT * period < delay < -_MAX_EARLINESS * period:
            return False
        is_on_time = self._in_episode and abs(delay) < 0.5 * period
        self._next_decision_time = (self._next_decision_time if is_on_time else now) + period
        return True

    def _decide(self, now: float) -> str:
        """Ask the policy for the next command; returns the reason for a stop, or an empty string."""
        assert self._scan is not None
        ranges, problem = self._reader.read(self._scan)
        if problem:
            return problem
        if not self._in_episode:
            self._policy.reset()
            self.filters.reset()
        self._in_episode = True
        plan = self._plan if self.needs.goal == "plan" else None
        waypoint = plan.lookahead_point(self._pose, self.needs.lookahead) if plan else None
        bumped = False  # after a contact the policy is not asked
        # Without odometry, the robot is assumed to obey.
        twist = self._last_command if age_problem("odometry", now - self._odometry_stamp) else self._twist
        sensor_data = SensorData(ranges, self._pose, twist, bumped, self._last_command, self._goal, waypoint)
        speeds = self._policy.act(sensor_data)
        if all(map(math.isfinite, speeds)):
            speeds, problem = self.filters(speeds, sensor_data, self._scan, now - self._scan_stamps[-1])
        if problem:
            return problem
        if not all(map(math.isfinite, speeds)):
            return "the policy or a filter returned {} and {} in place of finite speeds".format(*speeds)
        self._wanted = speeds
        return ""


def age_problem(sensor: str, age: float) -> str:
    """Describe the problem with data of this age [s]; an empty string if there is none."""
    if -MAX_AGE <= age <= MAX_AGE:
        return ""
    if abs(age) > _MAX_CLOCK_DIFFERENCE:
        hint = "for a simulated robot start the simulation first, and in ROS 2 set use_sim_time:=true"
        return f"the last {sensor} has the time of another clock; {hint}"
    if age < -MAX_AGE:
        return f"the last {sensor} is stamped {-age:.1f} s ahead: synchronise the clocks"
    return f"the last {sensor} is {age:.1f} s old"  # also for a NaN age
