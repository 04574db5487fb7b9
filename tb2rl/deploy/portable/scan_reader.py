"""Converts scans of any planar laser scanner, mounted anywhere, to the ranges that a policy was trained with.

Each reading is a point in the robot's frame. Between two readings of one surface, the surface is straight; at an edge,
it is as near as the nearer reading. All sections are then seen from the middle of the axle, as by the simulated laser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .policy_contract import Needs, are_usable
from .scan import NEIGHBOURS, Scan, is_full_circle, measured_distances

BEYOND = math.radians(2)  # a scan covers this much beyond its ends
_NARROW = math.radians(100)  # depth cameras see 45 to 90 degrees
_SMALL, _SLOPE = 0.1, 1.0  # [m] and metres a metre: steps between readings of one surface that need no other sign
_LARGE = 0.5  # [m] a larger step is always an edge
_IN_LINE = 0.25  # share of a larger step by which it may miss the line through the readings beside it
_SNAP = 0.01  # share of the angle between readings: a beam this near to a reading is that reading


@dataclass(frozen=True)
class Mounting:
    """The pose of the scanner in the robot's frame.

    Attributes:
        x, y: Forward of the middle of the axle, and to the left of it [m].
        yaw: Direction of its angle 0, counter-clockwise from straight ahead [rad].
        upside_down: Whether it is mounted head first, so that its angles count clockwise.

    Raises:
        ValueError: For a number that is not finite, or larger than `LARGEST`.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False

    def __post_init__(self) -> None:
        if not are_usable((self.x, self.y, self.yaw)):
            raise ValueError(f"the mounting takes finite x, y [m] and yaw [rad], got {self.x}, {self.y}, {self.yaw}")


@dataclass(frozen=True)
class BeamRanges:
    """The ranges along the beams of a policy, see `SensorData`, and what they lack, in plain words; "": nothing."""

    ranges: np.ndarray
    problem: str = ""


@dataclass(frozen=True)
class _Sections:
    """Sections of the seen surfaces, as seen from the axle; shape (sections,).

    Attributes:
        right, left: Directions of the ends [rad].
        right_range, left_range: Distances of the ends [m].
        straight: Whether a section is one straight surface.
    """

    right: np.ndarray
    left: np.ndarray
    right_range: np.ndarray
    left_range: np.ndarray
    straight: np.ndarray


class ScanReader:
    """Converts scans to the ranges of a policy.

    Args:
        needs: For the beams of the policy.
        mounting: The pose of the scanner; None: above the middle of the axle, looking forward.
    """

    def __init__(self, needs: Needs, mounting: Mounting | None = None) -> None:
        self._needs, self._mounting = needs, mounting or Mounting()
        self._two_turns = np.concatenate([needs.beams, needs.beams + math.tau])

    def read(self, scan: Scan) -> BeamRanges:
        """Convert a scan."""
        step, mounting = scan.angle_increment, self._mounting
        clockwise = -1.0 if mounting.upside_down else 1.0
        right_to_left = slice(None, None, -1 if clockwise * step < 0.0 else 1)
        ranges = np.asarray(scan.ranges, dtype=float)[right_to_left]
        with np.errstate(invalid="ignore"):  # of scans that are refused below
            angles = (mounting.yaw + clockwise * (scan.angle_min + step * np.arange(len(ranges))))[right_to_left]
        problem = _coverage_problem(angles, abs(step), self._needs)
        if problem:
            return self._unusable(problem)
        distances = measured_distances(ranges, angles, scan)
        if np.isnan(distances).all():
            return self._unusable("the scan has no valid reading at all; is the scanner turning?")
        return self._cast(self._sections(distances, angles, scan.range_max), _SNAP * abs(step))

    def _unusable(self, problem: str) -> BeamRanges:
        return BeamRanges(np.full(len(self._needs.beams), self._needs.min_range), problem)

    def _sections(self, distances: np.ndarray, all_angles: np.ndarray, range_max: float) -> _Sections:
        """The sections between the readings, from one end of the scan to the other.

        Args:
            distances: From `measured_distances` [m].
            all_angles: Directions of the readings in the robot's frame, ascending [rad].
            range_max: Of the scan [m].
        """
        valid = np.flatnonzero(~np.isnan(distances))
        angles, full_circle = all_angles[valid], is_full_circle(all_angles[valid])
        if full_circle:
            valid, angles = np.append(valid, valid[0]), np.append(angles, angles[0] + math.tau)
        distances, mounting = distances[valid], self._mounting
        cos, sin = np.cos(all_angles[valid]), np.sin(all_angles[valid])
        along, across = mounting.x * cos + mounting.y * sin, mounting.y * cos - mounting.x * sin  # of the scanner
        nothing, horizon = np.isinf(distances), range_max if 0.0 < range_max < math.inf else self._needs.max_range
        along += np.where(nothing, horizon, distances)
        radius, theta = np.where(nothing, np.inf, np.hypot(along, across)), angles + np.arctan2(across, along)
        first, last = (theta[0], theta[-1]) if full_circle else _covered(all_angles, angles)
        right, left = np.concatenate([[first], theta]), np.concatenate([theta, [last]])
        right_range, left_range = np.concatenate([radius[:1], radius]), np.concatenate([radius, radius[-1:]])
        apart = np.concatenate([[False], np.diff(angles) > NEIGHBOURS, [False]])  # points without a surface between
        left, left_range = np.where(apart, right, left), np.where(apart, right_range, left_range)
        straight = np.concatenate([[False], _is_one_surface(distances, angles), [False]])
        visible = left >= right  # others are seen from behind, so something hides them
        return _Sections(*(part[visible] for part in (right, left, right_range, left_range, straight)))

    def _cast(self, sections: _Sections, snap: float) -> BeamRanges:
        """The nearest section along each beam."""
        needs, beams = self._needs, len(self._needs.beams)
        turned = needs.beams[0] + np.mod(sections.right - snap - needs.beams[0], math.tau)
        width = sections.left - sections.right
        begin = np.searchsorted(self._two_turns, turned)
        count = np.searchsorted(self._two_turns, turned + width + 2.0 * snap, side="right") - begin
        section = np.repeat(np.arange(len(count)), count)  # a pair of section and beam for each intersection
        beam = np.arange(len(section)) + np.repeat(begin - np.cumsum(count) + count, count)
        offset = self._two_turns[beam] - turned[section] - snap
        distances = _intersect(sections, section, offset, width[section], snap)
        beam %= beams
        ranges, met = np.full(beams, np.inf), np.zeros(beams, dtype=bool)
        np.minimum.at(ranges, beam, distances)
        met[beam] = True
        ranges = np.where(ranges > needs.max_range, np.inf, np.maximum(ranges, needs.min_range))
        return BeamRanges(ranges, "" if met.all() else _gap(needs.beams[~met], beams))


def _coverage_problem(angles: np.ndarray, step: float, needs: Needs) -> str:
    """What scans with readings at these ascending angles, `step` apart [rad], never show; "": nothing."""
    if not (np.isfinite(angles).all() and len(angles) > 1 and step > 0.0):
        return f"a scan of {len(angles)} readings, {math.degrees(step):.3g} degrees apart, shows nothing"
    if step > NEIGHBOURS and (np.abs(needs.beams[:, None] - angles).min(axis=1) > _SNAP * step).any():
        most = math.degrees(NEIGHBOURS)
        return f"the scan has one reading in {math.degrees(step):.0f} degrees; the policy needs one in {most:.0f}"
    span, margin = angles[-1] - angles[0], BEYOND
    beyond = np.mod(needs.beams - angles[0] + margin, math.tau) > span + 2.0 * margin
    if is_full_circle(angles) or not beyond.any():
        return ""
    right = math.remainder(angles[0], math.tau)
    if span < _NARROW:
        hint = "so narrow a scan, as of a depth camera, is not enough"
    else:
        wide_enough = span >= needs.beams[-1] - needs.beams[0]
        hint = "check how the scanner is mounted" if wide_enough else "it takes another scanner"
    trained = _field(needs.beams[0], needs.beams[-1])
    return f"the scan covers {_field(right, right + span)}, the policy was trained with {trained}; {hint}"


def _field(right: float, left: float) -> str:
    degrees = [math.degrees(angle) for angle in (left - right, right, left)]
    return "{:.0f} degrees ({:.0f} to {:.0f})".format(*degrees)


def _gap(missed: np.ndarray, beams: int) -> str:
    right, left = math.degrees(missed[0]), math.degrees(missed[-1])
    where = f"from {right:.0f} to {left:.0f} degrees"
    return f"the scan has no valid reading for {len(missed)} of the policy's {beams} beams, {where}"


def _covered(angles: np.ndarray, valid: np.ndarray) -> tuple[float, float]:
    """The ends of what a scan covers [rad], with readings at `angles`, of which those at `valid` are valid."""
    right = max(angles[0] - BEYOND, valid[0] - NEIGHBOURS)
    return right, min(angles[-1] + BEYOND, valid[-1] + NEIGHBOURS)


def _is_one_surface(distances: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Whether each reading and the next one hit one surface, (readings,) to (readings - 1,).

    They do if the step between them is small, or if both lie on the straight line through the reading before and the
    one after, as at a wall seen at a low angle. (Along a straight line 1 / distance is a sine of the angle.)
    """
    gaps = np.diff(angles)
    with np.errstate(all="ignore"):
        steps = np.abs(np.diff(distances))  # NaN between two inf
        small = steps <= _SMALL + _SLOPE * gaps * np.minimum(distances[1:], distances[:-1])
        forward = _extrapolate(1.0 / distances, angles)
        backward = _extrapolate(1.0 / distances[::-1], -angles[::-1])[::-1]
        allowed = _IN_LINE * steps
        in_line = np.abs(forward - distances[2:])[:-1] <= allowed[1:-1]
        small[1:-1] |= in_line & (np.abs(backward - distances[:-2])[1:] <= allowed[1:-1])
        small &= steps <= _LARGE
    return small & (gaps > 0.0) & np.isfinite(steps)


def _extrapolate(inverse: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """The distance of the line through two readings in a row at the third, from inverse distances: (n,) to (n - 2,)."""
    gaps = np.sin(np.diff(angles))
    both = np.sin(angles[2:] - angles[:-2])
    return gaps[:-1] / (both * inverse[1:-1] - gaps[1:] * inverse[:-2])


def _intersect(
    sections: _Sections, index: np.ndarray, offset: np.ndarray, width: np.ndarray, snap: float
) -> np.ndarray:
    """The distances [m] of the sections with these indices, `offset` of their `width` [rad] from the right end."""
    right, left = sections.right_range[index], sections.left_range[index]
    distances = np.minimum(right, left)
    with np.errstate(all="ignore"):
        chord = right * left * np.sin(width) / (right * np.sin(offset) + left * np.sin(width - offset))
    distances = np.where(sections.straight[index] & (width < 1.0), chord, distances)
    distances = np.where(offset <= snap, right, distances)
    return np.where(width - offset <= snap, left, distances)
