"""The preflight check: what does not fit between a policy and its robot."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from tb2rl.envs.filters import SpeedLimits

from .path import PlannedPath
from .policy_contract import Needs, Point, Pose, Speeds
from .scan import Scan

STALE = 0.5  # [s] a robot stops if its data is older
_RARELY = 1.2  # times the control step: scans of this period are frequent enough
_NEAR = 0.1  # [m] close by, in which a scanner may be blind


@dataclass(frozen=True)
class Finding:
    """One mismatch, as a sentence; if it is serious, the robot does not drive."""

    sentence: str
    serious: bool


@dataclass
class Inputs:
    """The latest data of a robot; None or NaN for what has not come yet.

    Attributes:
        scan_stamps: Times of the latest scans [s], the newest last.
        odometry_stamp: Time of `pose` and `twist` [s].
    """

    scan: Scan | None = None
    scan_stamps: deque[float] = field(default_factory=lambda: deque(maxlen=20))
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Speeds = (0.0, 0.0)
    odometry_stamp: float = math.nan
    goal: Point | None = None
    plan: PlannedPath | None = None

    @property
    def scan_period(self) -> float:
        """The mean time between scans [s]; NaN: unknown."""
        stamps = self.scan_stamps
        return (stamps[-1] - stamps[0]) / (len(stamps) - 1) if len(stamps) > 1 else math.nan


def missing(needs: Needs, inputs: Inputs) -> list[str]:
    """The data that the policy needs and that has not come yet."""
    waits = {
        "a scan": inputs.scan is None,
        "odometry": bool(needs.uses_odometry or needs.goal) and math.isnan(inputs.odometry_stamp),
        "a goal": bool(needs.goal) and inputs.goal is None,
        "a plan": needs.goal == "plan" and inputs.plan is None,
    }
    return [name for name, waiting in waits.items() if waiting]


def check_inputs(needs: Needs, inputs: Inputs, scan_problem: str, limits: SpeedLimits) -> list[Finding]:
    """What does not fit, the serious findings first.

    Args:
        needs: The requirements of the policy.
        inputs: The data so far.
        scan_problem: See `BeamRanges.problem`.
        limits: The limits of the robot.
    """
    period = inputs.scan_period
    serious = [f"no {name.split()[-1]} has come yet" for name in missing(needs, inputs)]
    if scan_problem:
        serious.append(scan_problem)
    if period >= STALE:
        serious.append(f"a scan comes every {period:.2g} s, and the robot stops if it is {STALE:g} s old")
    remarks = _remarks(needs, inputs.scan, period, limits)
    return [Finding(sentence, True) for sentence in serious] + [Finding(sentence, False) for sentence in remarks]


def _remarks(needs: Needs, scan: Scan | None, period: float, limits: SpeedLimits) -> list[str]:
    """Mismatches with which the robot can drive."""
    remarks = []
    if needs.period * _RARELY < period < STALE:
        remarks.append(
            f"a scan comes every {period:.2g} s, the policy decides every {needs.period:g} s: at times by the same scan"
        )
    if scan and 0.0 < scan.range_max < needs.max_range:
        trained = f"the policy was trained with {needs.max_range:g} m"
        remarks.append(f"the scanner sees {scan.range_max:.3g} m far, {trained}: walls beyond look like open space")
    if scan and scan.range_min > needs.min_range + _NEAR:
        remarks.append(f"the scanner sees nothing nearer than {scan.range_min:.3g} m")
    if needs.max_speed > limits.speed:
        remarks.append(f"the policy drives up to {needs.max_speed:.3g} m/s; it is slowed to {limits.speed:.3g}")
    if needs.max_turn_rate > limits.turn_rate:
        slowed = f"it is slowed to {limits.turn_rate:.3g}"
        remarks.append(f"the policy turns up to {needs.max_turn_rate:.3g} rad/s; {slowed}")
    return remarks
