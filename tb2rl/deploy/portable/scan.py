"""From the scan of any planar laser scanner, mounted anywhere, to the ranges that a policy was trained with.

Each reading is a point in the robot's frame. From one reading to the next the surface goes on straight, if it is one
surface; at an edge it is as near as the nearer of the two. All this is then seen from the middle of the axle, where the
simulated laser is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from .policy_contract import Needs, are_usable
from .readings import NEIGHBOURS, Scan, distances_of, goes_around

BEYOND = math.radians(2)  # so far beyond its ends a scan still covers
_NARROW = math.radians(100)  # depth cameras see 45 to 90 degrees
_SMALL, _SLOPE = 0.1, 1.0  # [m] and metres a metre: steps between readings of one surface that need no other sign
_LARGE = 0.5  # [m] a larger step is an edge whatever it looks like
_IN_LINE = 0.25  # share of a larger step by which it may miss the line through the readings beside it
_SNAP = 0.01  # share of the angle between readings: a beam as near as that to a reading is that reading


@dataclass(frozen=True)
class Mounting:
    """Where the scanner is in the robot's frame.

    Attributes:
        x, y: Ahead of the middle of the axle, and to the left of it [m].
        yaw: Where its angle 0 looks, counted to the left from straight ahead [rad].
        upside_down: Whether it hangs head first, so that its angles count clockwise.

    Raises:
        ValueError: For a number that is not finite, or larger than `LARGEST`.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False

    def __post_init__(self) -> None:
        if not are_usable((self.x, self.y, self.yaw)):
            where = "{}, {}, {}".format(self.x, self.y, self.yaw)
            raise ValueError("the mounting takes finite numbers x, y [m] and yaw [rad], got " + where)


@dataclass(frozen=True)
class Seen:
    """What the robot sees along the beams of a policy.

    Attributes:
        ranges: See `Sensed.ranges`, shape (beams,).
        sure: Which beams lie between neighbouring readings, shape (beams,), bool; where the scanner sits ahead of the
            axle, the last reading of a scan stands for what lies beside the robot.
        lacks: What the policy needs and the scan does not show, in plain words; "": nothing.
    """

    ranges: np.ndarray
    sure: np.ndarray
    lacks: str = ""


@dataclass(frozen=True)
class _Aim:
    """Where the readings of scans of one kind look, right to left.

    Attributes:
        order: Puts readings as they come into that order.
        angles: In the robot's frame, ascending [rad], shape (readings,).
        along, across: Where the scanner is, as seen along each of its readings, and to the left of it [m].
        lacks: See `Seen.lacks`; by the directions alone.
    """

    order: slice
    angles: np.ndarray
    along: np.ndarray
    across: np.ndarray
    lacks: str


@dataclass(frozen=True)
class _Sections:
    """Stretches of what was seen, each from one direction to another, as seen from the axle; shape (sections,).

    Attributes:
        right, left: The two directions [rad].
        right_range, left_range: How far it is there [m].
        straight: Whether it is one surface between them.
        sure: Whether there is a reading at both ends.
    """

    right: np.ndarray
    left: np.ndarray
    right_range: np.ndarray
    left_range: np.ndarray
    straight: np.ndarray
    sure: np.ndarray


class ScanReader:
    """Turns scans into what a policy sees.

    Args:
        needs: Which beams it was trained with.
        mounting: Where the scanner is; None: above the middle of the axle, looking ahead.
    """

    def __init__(self, needs: Needs, mounting: Optional[Mounting] = None) -> None:
        self._needs, self._mounting = needs, mounting or Mounting()
        self._twice = np.concatenate([needs.beams, needs.beams + math.tau])
        self._kind: Optional[Tuple[float, float, int]] = None

    def read(self, scan: Scan) -> Seen:
        """What the policy sees of a scan."""
        kind = (scan.angle_min, scan.angle_increment, len(scan.ranges))
        if kind != self._kind:
            self._aim, self._kind = _aimed(kind, self._mounting, self._needs), kind
        if self._aim.lacks:
            return self._nothing(self._aim.lacks)
        ranges = np.asarray(scan.ranges, dtype=float)[self._aim.order]
        distances = distances_of(ranges, self._aim.angles, scan)
        if np.isnan(distances).all():
            return self._nothing("the scan has no valid reading at all; is the scanner turning?")
        sections = self._sections(distances, scan.range_max)
        return self._look(sections, _SNAP * abs(scan.angle_increment))

    def _nothing(self, lacks: str) -> Seen:
        beams = len(self._needs.beams)
        return Seen(np.full(beams, self._needs.min_range), np.zeros(beams, dtype=bool), lacks)

    def _sections(self, distances: np.ndarray, range_max: float) -> _Sections:
        """What lies between readings, from one end of the scan to the other; from `distances_of`."""
        aim = self._aim
        valid = np.flatnonzero(~np.isnan(distances))
        angles, around = aim.angles[valid], goes_around(aim.angles[valid])
        if around:
            valid, angles = np.append(valid, valid[0]), np.append(angles, angles[0] + math.tau)
        distances = distances[valid]
        nothing, reach = np.isinf(distances), range_max if 0.0 < range_max < math.inf else self._needs.max_range
        ahead, across = np.where(nothing, reach, distances) + aim.along[valid], aim.across[valid]
        seen, theta = np.where(nothing, np.inf, np.hypot(ahead, across)), angles + np.arctan2(across, ahead)
        first, last = (theta[0], theta[-1]) if around else _ends(aim.angles, angles)
        right, left = np.concatenate([[first], theta]), np.concatenate([theta, [last]])
        right_range, left_range = np.concatenate([seen[:1], seen]), np.concatenate([seen, seen[-1:]])
        apart = np.concatenate([[False], np.diff(angles) > NEIGHBOURS, [False]])  # these are readings, and no more
        left, left_range = np.where(apart, right, left), np.where(apart, right_range, left_range)
        straight = np.concatenate([[False], _is_one_surface(distances, angles), [False]])
        sure = np.concatenate([[False], np.ones(len(theta) - 1, dtype=bool), [False]])
        parts, open_to_us = (right, left, right_range, left_range, straight, sure), left >= right
        return _Sections(*(part[open_to_us] for part in parts))  # others are seen from behind, so something hides them

    def _look(self, sections: _Sections, snap: float) -> Seen:
        """What the beams meet first."""
        needs, beams = self._needs, len(self._needs.beams)
        turned = needs.beams[0] + np.mod(sections.right - snap - needs.beams[0], math.tau)
        width = sections.left - sections.right
        begin = np.searchsorted(self._twice, turned)
        count = np.searchsorted(self._twice, turned + width + 2.0 * snap, side="right") - begin
        section = np.repeat(np.arange(len(count)), count)
        at = np.arange(len(section)) + np.repeat(begin - np.cumsum(count) + count, count)
        into = self._twice[at] - turned[section] - snap
        near = _along(sections, section, into, width[section], snap)
        at %= beams
        ranges, met, sure = np.full(beams, np.inf), np.zeros(beams, dtype=bool), np.zeros(beams, dtype=bool)
        np.minimum.at(ranges, at, near)
        met[at], sure[at[sections.sure[section]]] = True, True
        ranges = np.where(ranges > needs.max_range, np.inf, np.maximum(ranges, needs.min_range))
        return Seen(ranges, sure, "" if met.all() else _gap(needs.beams[~met], beams))


def _aimed(kind: Tuple[float, float, int], mounting: Mounting, needs: Needs) -> _Aim:
    """Where the readings of a kind of scan look: its `angle_min`, `angle_increment` and number of readings."""
    first, step, readings = kind
    clockwise = -1.0 if mounting.upside_down else 1.0
    order = slice(None, None, -1 if clockwise * step < 0.0 else 1)
    with np.errstate(invalid="ignore"):  # of scans that are refused below
        angles = (mounting.yaw + clockwise * (first + step * np.arange(readings)))[order]
        cos, sin = np.cos(angles), np.sin(angles)
    along, across = mounting.x * cos + mounting.y * sin, mounting.y * cos - mounting.x * sin
    return _Aim(order, angles, along, across, _uncovered(angles, abs(step), needs))


def _uncovered(angles: np.ndarray, step: float, needs: Needs) -> str:
    """What scans with readings at these ascending angles, so far apart [rad], never show, in words."""
    if not (np.isfinite(angles).all() and len(angles) > 1 and step > 0.0):
        return f"a scan of {len(angles)} readings, {math.degrees(step):.3g} degrees apart, shows nothing"
    if step > NEIGHBOURS and (np.abs(needs.beams[:, None] - angles).min(axis=1) > _SNAP * step).any():
        most = math.degrees(NEIGHBOURS)
        return f"the scan has one reading in {math.degrees(step):.0f} degrees; the policy needs one in {most:.0f}"
    span, margin = angles[-1] - angles[0], BEYOND
    beyond = np.mod(needs.beams - angles[0] + margin, math.tau) > span + 2.0 * margin
    if goes_around(angles) or not beyond.any():
        return ""
    right = math.remainder(angles[0], math.tau)
    scan = f"the scan covers {_field(right, right + span)}"
    trained = f"the policy was trained with {_field(needs.beams[0], needs.beams[-1])}"
    if span < _NARROW:
        hint = "so narrow a scan, as of a depth camera, is not enough"
    else:
        hint = "check how the scanner is mounted" if span >= needs.field_of_view else "it takes another scanner"
    return f"{scan}, {trained}; {hint}"


def _field(right: float, left: float) -> str:
    degrees = [math.degrees(angle) for angle in (left - right, right, left)]
    return "{:.0f} degrees ({:.0f} to {:.0f})".format(*degrees)


def _gap(missed: np.ndarray, beams: int) -> str:
    right, left = math.degrees(missed[0]), math.degrees(missed[-1])
    where = f"from {right:.0f} to {left:.0f} degrees"
    return f"the scan has no valid reading for {len(missed)} of the policy's {beams} beams, {where}"


def _ends(angles: np.ndarray, valid: np.ndarray) -> Tuple[float, float]:
    """How far a scan with readings at `angles` covers [rad], if those at `valid` are the ones that count."""
    right = max(angles[0] - BEYOND, valid[0] - NEIGHBOURS)
    return right, min(angles[-1] + BEYOND, valid[-1] + NEIGHBOURS)


def _is_one_surface(distances: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Whether each reading and the next one hit one surface, (readings,) to (readings - 1,).

    Where the step between them is small, or all goes on as a straight line from the reading before to the one after
    them, as at a wall that is seen at a low angle. (Along a straight line 1 / distance is a sine of the angle.)
    """
    gaps = np.diff(angles)
    with np.errstate(all="ignore"):
        steps = np.abs(np.diff(distances))  # NaN between two inf
        small = steps <= _SMALL + _SLOPE * gaps * np.minimum(distances[1:], distances[:-1])
        on, back = _on_line(1.0 / distances, angles), _on_line(1.0 / distances[::-1], -angles[::-1])[::-1]
        allowed = _IN_LINE * steps
        on_line = np.abs(on - distances[2:])[:-1] <= allowed[1:-1]
        small[1:-1] |= on_line & (np.abs(back - distances[:-2])[1:] <= allowed[1:-1])
        small &= steps <= _LARGE
    return small & (gaps > 0.0) & np.isfinite(steps)


def _on_line(inverse: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """How far the line through two readings in a row is at the third, from inverse distances: (n,) to (n - 2,)."""
    gaps = np.sin(np.diff(angles))
    both = np.sin(angles[2:] - angles[:-2])
    return gaps[:-1] / (both * inverse[1:-1] - gaps[1:] * inverse[:-2])


def _along(sections: _Sections, number: np.ndarray, into: np.ndarray, width: np.ndarray, snap: float) -> np.ndarray:
    """How far it is [m] within the sections of these numbers, `into` of their `width` [rad] from the right."""
    right, left = sections.right_range[number], sections.left_range[number]
    near = np.minimum(right, left)
    with np.errstate(all="ignore"):
        chord = right * left * np.sin(width) / (right * np.sin(into) + left * np.sin(width - into))
    near = np.where(sections.straight[number] & (width < 1.0), chord, near)
    near = np.where(into <= snap, right, near)
    return np.where(width - into <= snap, left, near)
