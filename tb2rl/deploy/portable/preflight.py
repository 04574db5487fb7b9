"""What does not fit between a policy and the robot that it is to drive, in plain words, before it drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional

from .policy_contract import Needs, Speeds
from .readings import Scan

STALE = 0.5  # [s] nobody drives by data that is older
_RARELY = 1.2  # times the control step: scans that come as often as that are often enough
_NEAR = 0.1  # [m] that a scanner may miss close by


@dataclass(frozen=True)
class Limits:
    """What a robot can do, or is to do, at most.

    Attributes:
        speed: Ahead and back [m/s], above 0; inf: no limit.
        turn_rate: To both sides [rad/s], above 0; inf: no limit.

    Raises:
        ValueError: For another number.
    """

    speed: float = math.inf
    turn_rate: float = math.inf

    def __post_init__(self) -> None:
        for name, unit in (("speed", "m/s"), ("turn_rate", "rad/s")):
            if not getattr(self, name) > 0.0:  # NaN is not, either
                raise ValueError("{} takes {} above 0, got {}".format(name, unit, getattr(self, name)))

    def slowed(self, v: float, w: float) -> Speeds:
        """These speeds, slowed to the limits on the same arc."""
        share = min(1.0, self.speed / max(abs(v), 1e-9), self.turn_rate / max(abs(w), 1e-9))
        return _within(float(share * v), self.speed), _within(float(share * w), self.turn_rate)


@dataclass(frozen=True)
class Finding:
    """Something that does not fit.

    Attributes:
        sentence: What.
        serious: Whether the robot does not drive like that.
    """

    sentence: str
    serious: bool


@dataclass(frozen=True)
class Situation:
    """What is known of a robot.

    Attributes:
        scan: Its last; None: there was none yet.
        scan_period: From one scan to the next [s]; NaN: not known.
        lacks: What the scan does not show, see `Seen.lacks`.
        counts: Whether there is odometry.
        has_goal, has_plan: Whether it was told a goal, and has a plan or a planner.
        limits: What it can do.
    """

    scan: Optional[Scan]
    scan_period: float
    lacks: str
    counts: bool
    has_goal: bool
    has_plan: bool
    limits: Limits


def find_misfits(needs: Needs, robot: Situation) -> List[Finding]:
    """What does not fit, the serious things first."""
    serious = {
        "no scan has come yet": robot.scan is None,
        robot.lacks: bool(robot.lacks),
        "the policy needs odometry, and none has come yet": bool(needs.uses_odometry or needs.goal)
        and not robot.counts,
        "the policy drives to a goal, and it was told none": bool(needs.goal) and not robot.has_goal,
        "the policy follows a planned way, and there is neither a plan nor a planner": (
            needs.goal == "plan" and not robot.has_plan
        ),
        f"a scan comes every {robot.scan_period:.2g} s, and the robot stops if it is {STALE:g} s old": (
            robot.scan_period >= STALE
        ),
    }
    found = [Finding(sentence, True) for sentence, holds in serious.items() if holds]
    return found + [Finding(sentence, False) for sentence in _remarks(needs, robot)]


def _within(value: float, limit: float) -> float:
    """The product above may be larger than the limit by its rounding."""
    return min(max(value, -limit), limit)


def _remarks(needs: Needs, robot: Situation) -> List[str]:
    """What does not fit, and yet it can drive."""
    scan, limits, remarks = robot.scan, robot.limits, []
    if needs.period * _RARELY < robot.scan_period < STALE:
        decides = f"the policy decides every {needs.period:g} s"
        remarks.append(f"a scan comes every {robot.scan_period:.2g} s, {decides}: at times by the same scan")
    if scan and 0.0 < scan.range_max < needs.max_range:
        trained = f"the policy was trained with {needs.max_range:g} m"
        remarks.append(f"the scanner sees {scan.range_max:.3g} m far, {trained}: walls beyond look like open space")
    if scan and scan.range_min > needs.min_range + _NEAR:
        remarks.append(f"the scanner sees nothing nearer than {scan.range_min:.3g} m")
    if needs.max_speed > limits.speed:
        remarks.append(f"the policy drives up to {needs.max_speed:.3g} m/s; it is slowed to {limits.speed:.3g}")
    if needs.max_turn_rate > limits.turn_rate:
        remarks.append(
            f"the policy turns up to {needs.max_turn_rate:.3g} rad/s; it is slowed to {limits.turn_rate:.3g}"
        )
    return remarks
