"""Converts scans of any planar laser scanner, mounted anywhere, to the ranges that a policy was trained with.

Each reading is a point in the robot's frame. Between two readings of one surface, the surface is assumed straight.
Between readings of two surfaces, an obstacle is assumed as near as the nearer reading. The beams of the policy are cast
at these surfaces from the middle of the axle, as in simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .policy_contract import Needs, are_usable

MAX_GAP = math.radians(10)  # [rad] between neighbouring readings; the surface in a wider gap is unknown
_MAX_NEAR_RANGE = 2.0  # [multiples of range_min] zeros between readings up to this range mean a very near wall
_END_MARGIN = math.radians(2)  # [rad] a scan is extended by this angle beyond its first and last reading
# A step is the difference between the distances of two neighbouring readings.
_SMALL_STEP, _SMALL_SLOPE = 0.1, 1.0  # [m], [m/m] a step up to _SMALL_STEP + _SMALL_SLOPE * arc is on one surface
_MAX_STEP = 0.5  # [m] a larger step always separates two surfaces
_LINE_TOLERANCE = 0.25  # [sizes of the step] largest deviation of one surface from a straight line
_SNAP_TOLERANCE = 0.01  # [angle increments] a beam this near to a reading gets its range


@dataclass(frozen=True)
class Scan:
    """One scan, with the fields of ROS's sensor_msgs/LaserScan.

    Attributes:
        ranges: [m], shape (readings,).
        angle_min: Direction of the first reading in the scanner's frame [rad].
        angle_increment: Angle from one reading to the next [rad]; negative: clockwise.
        range_min, range_max: The shortest and the longest range that the scanner measures [m].
    """

    ranges: np.ndarray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


def is_full_circle(angles: np.ndarray) -> bool:
    """Whether ascending angles [rad] leave no gap between the last and the first one."""
    return bool(angles[0] + math.tau - angles[-1] <= MAX_GAP)


def measured_distances(ranges: np.ndarray, angles: np.ndarray, scan: Scan) -> np.ndarray:
    """Convert readings to distances [m], which are inf without an obstacle, and NaN without a measurement.

    Drivers have different conventions for readings:

    - inf: no obstacle within `range_max` (REP 117). Older drivers send `range_max` or more instead.
    - -inf: an obstacle too near to be measured (REP 117); it is assumed at `range_min`. A positive reading below
      `range_min` is used unchanged.
    - NaN: no measurement (REP 117); the readings beside it are used.
    - 0 or less: no reflection, in many small lidars. A narrow gap of zeros is treated like NaN, a wide gap like inf,
      because open space would otherwise be full of obstacles. Zeros between two readings near `range_min` are treated
      like -inf, because a very near wall often causes zeros.

    Args:
        ranges: Readings of the scan, right to left [m], shape (readings,).
        angles: Directions of the readings, ascending [rad], shape (readings,).
        scan: The scan, which defines `range_min` and `range_max`.
    """
    distances = np.where(ranges >= scan.range_max, np.inf, ranges) if scan.range_max > 0.0 else ranges.copy()
    distances[np.isneginf(ranges)] = scan.range_min
    zeros = np.flatnonzero(np.isfinite(ranges) & (ranges <= 0.0))
    distances[zeros] = np.nan
    valid = np.flatnonzero(~np.isnan(distances))
    if not zeros.size or not valid.size:
        return distances
    index = np.searchsorted(valid, zeros)  # the valid readings on both sides of a zero define its meaning
    right, left = valid[index - 1], valid[index % valid.size]
    gaps = np.mod(angles[left] - angles[right], math.tau)
    if not is_full_circle(angles):  # zeros at the ends have a valid reading on one side only
        no_right, no_left = index == 0, index == valid.size
        right[no_right], left[no_left] = left[no_right], right[no_left]
        gaps[no_right], gaps[no_left] = angles[left[no_right]] - angles[0], angles[-1] - angles[right[no_left]]
    is_wide = (gaps > MAX_GAP) | (valid.size == 1)
    is_near = np.maximum(distances[right], distances[left]) < _MAX_NEAR_RANGE * scan.range_min
    distances[zeros] = np.where(is_near, scan.range_min, np.where(is_wide, np.inf, np.nan))
    return distances


@dataclass(frozen=True)
class Mounting:
    """The pose of the scanner in the robot's frame.

    Attributes:
        x, y: Position ahead of the middle of the axle, and to its left [m].
        yaw: Direction of the scanner's angle 0, counter-clockwise from straight ahead [rad].
        upside_down: Whether the scanner is upside down, so that its angles count clockwise.

    Raises:
        ValueError: If a number is not finite, or larger than `MAX_MAGNITUDE`.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False

    def __post_init__(self) -> None:
        if not are_usable((self.x, self.y, self.yaw)):
            raise ValueError(f"the mounting takes x, y [m], yaw [rad] up to 1e9, got {self.x}, {self.y}, {self.yaw}")


class BeamRanges(NamedTuple):
    """A scan, converted to the beams of a policy."""

    ranges: np.ndarray  # as in `SensorData.ranges`
    problem: str = ""  # why the ranges are not usable; empty if they are


class _Sections(NamedTuple):
    """Sections of visible surfaces in polar coordinates around the middle of the axle; shape (sections,)."""

    right: np.ndarray  # directions of the ends [rad]
    left: np.ndarray
    right_range: np.ndarray  # distances of the ends [m]
    left_range: np.ndarray
    straight: np.ndarray  # whether a section belongs to one straight surface


class ScanReader:
    """Converts scans to the ranges of a policy.

    Args:
        needs: The requirements of the policy, with its beams.
        mounting: The pose of the scanner; by default above the middle of the axle and facing forward.
    """

    def __init__(self, needs: Needs, mounting: Mounting | None = None) -> None:
        self._needs, self._mounting = needs, mounting or Mounting()
        self._two_turns = np.concatenate([needs.beams, needs.beams + math.tau])

    def read(self, scan: Scan) -> BeamRanges:
        """Convert a scan."""
        increment, mounting, needs = scan.angle_increment, self._mounting, self._needs
        sign = -1.0 if mounting.upside_down else 1.0
        right_to_left = slice(None, None, -1 if sign * increment < 0.0 else 1)
        ranges = np.asarray(scan.ranges, dtype=float)[right_to_left]
        with np.errstate(invalid="ignore"):  # `_coverage_problem` rejects angles that are not finite
            angles = (mounting.yaw + sign * (scan.angle_min + increment * np.arange(len(ranges))))[right_to_left]
        problem = _coverage_problem(angles, abs(increment), needs)
        if not problem:
            distances = measured_distances(ranges, angles, scan)
            if not np.isnan(distances).all():
                sections = self._find_sections(distances, angles, scan.range_max)
                return self._cast_beams(sections, _SNAP_TOLERANCE * abs(increment))
            problem = "the scan has no valid reading; is the scanner turning?"
        return BeamRanges(np.full(len(needs.beams), needs.min_range), problem)

    def _find_sections(self, distances: np.ndarray, all_angles: np.ndarray, range_max: float) -> _Sections:
        """Find the sections between neighbouring readings, given `measured_distances` at ascending angles [rad]."""
        valid = np.flatnonzero(~np.isnan(distances))
        angles, full_circle = all_angles[valid], is_full_circle(all_angles[valid])
        if full_circle:
            valid, angles = np.append(valid, valid[0]), np.append(angles, angles[0] + math.tau)
        distances, mounting = distances[valid], self._mounting
        cos, sin = np.cos(all_angles[valid]), np.sin(all_angles[valid])  # components along and across each reading:
        along, across = mounting.x * cos + mounting.y * sin, mounting.y * cos - mounting.x * sin  # of the scanner [m]
        no_hit, horizon = np.isinf(distances), range_max if 0.0 < range_max < math.inf else self._needs.max_range
        along += np.where(no_hit, horizon, distances)  # now of each reading's point
        radius, theta = np.where(no_hit, np.inf, np.hypot(along, across)), angles + np.arctan2(across, along)
        right_end, left_end = theta[0], theta[-1]
        if not full_circle:
            right_end = max(all_angles[0] - _END_MARGIN, angles[0] - MAX_GAP)
            left_end = min(all_angles[-1] + _END_MARGIN, angles[-1] + MAX_GAP)
        right, left = np.concatenate([[right_end], theta]), np.concatenate([theta, [left_end]])
        right_range, left_range = np.concatenate([radius[:1], radius]), np.concatenate([radius, radius[-1:]])
        is_gap = np.concatenate([[False], np.diff(angles) > MAX_GAP, [False]])  # a gap keeps only its right reading
        left, left_range = np.where(is_gap, right, left), np.where(is_gap, right_range, left_range)
        straight = np.concatenate([[False], _is_one_surface(distances, angles), [False]])
        visible = left >= right  # the axle is behind the others, so that their own obstacle hides them
        return _Sections(*(part[visible] for part in (right, left, right_range, left_range, straight)))

    def _cast_beams(self, sections: _Sections, snap: float) -> BeamRanges:
        """Find the range of the nearest section along each beam; `snap` [rad] extends sections on both sides."""
        needs, beam_count = self._needs, len(self._needs.beams)
        start = needs.beams[0] + np.mod(sections.right - snap - needs.beams[0], math.tau)  # not before the first beam
        width = sections.left - sections.right
        first_beam = np.searchsorted(self._two_turns, start)
        counts = np.searchsorted(self._two_turns, start + width + 2.0 * snap, side="right") - first_beam
        section = np.repeat(np.arange(len(counts)), counts)  # a pair of section and beam for each intersection
        beam = np.arange(len(section)) + np.repeat(first_beam - np.cumsum(counts) + counts, counts)
        right, left, width = sections.right_range[section], sections.left_range[section], width[section]
        offset = self._two_turns[beam] - start[section] - snap  # of the beam from the right end [rad]
        with np.errstate(all="ignore"):
            chord = right * left * np.sin(width) / (right * np.sin(offset) + left * np.sin(width - offset))
        distances = np.where(sections.straight[section] & (width < 1.0), chord, np.minimum(right, left))
        distances = np.where(offset <= snap, right, distances)
        distances = np.where(width - offset <= snap, left, distances)
        beam %= beam_count
        ranges, is_covered = np.full(beam_count, np.inf), np.zeros(beam_count, dtype=bool)
        np.minimum.at(ranges, beam, distances)
        is_covered[beam] = True
        ranges = np.where(ranges > needs.max_range, np.inf, np.maximum(ranges, needs.min_range))
        if is_covered.all():
            return BeamRanges(ranges)
        missed = np.degrees(needs.beams[~is_covered])
        where = f"{len(missed)} of the policy's {beam_count} beams, from {missed[0]:.0f} to {missed[-1]:.0f} degrees"
        return BeamRanges(ranges, f"the scan has no valid reading for {where}")


def _coverage_problem(angles: np.ndarray, increment: float, needs: Needs) -> str:
    """Describe why ascending angles, `increment` apart [rad], miss beams; an empty string if they do not."""
    if not (np.isfinite(angles).all() and len(angles) > 1 and increment > 0.0):
        return f"a scan of {len(angles)} readings, {math.degrees(increment):.3g} degrees apart, is invalid"
    if increment > MAX_GAP and (np.abs(needs.beams[:, None] - angles).min(axis=1) > _SNAP_TOLERANCE * increment).any():
        degrees, needed = math.degrees(increment), math.degrees(MAX_GAP)
        return f"the scan has a reading every {degrees:.0f} degrees; the policy needs one every {needed:.0f}"
    span = angles[-1] - angles[0]
    outside = np.mod(needs.beams - angles[0] + _END_MARGIN, math.tau) > span + 2.0 * _END_MARGIN
    if is_full_circle(angles) or not outside.any():
        return ""
    right = math.remainder(angles[0], math.tau)
    wide_enough = span + 2.0 * _END_MARGIN >= needs.beams[-1] - needs.beams[0]
    hint = "check how the scanner is mounted" if wide_enough else "use a scanner with a wider field of view"
    training_field = _format_field(needs.beams[0], needs.beams[-1])
    return f"the scan covers {_format_field(right, right + span)}, the policy was trained with {training_field}; {hint}"


def _format_field(right: float, left: float) -> str:
    degrees = [math.degrees(angle) for angle in (left - right, right, left)]
    return "{:.0f} degrees ({:.0f} to {:.0f})".format(*degrees)


def _is_one_surface(distances: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Whether each reading and the next one hit one surface, shape (readings - 1,).

    They do if the step between them is small. On a wall seen at a flat angle, steps are large. There, each of the two
    readings must lie on the straight line through the other reading and the neighbour beyond it.
    """
    gaps = np.diff(angles)
    with np.errstate(all="ignore"):
        steps = np.abs(np.diff(distances))  # NaN between two inf
        is_same = steps <= _SMALL_STEP + _SMALL_SLOPE * gaps * np.minimum(distances[1:], distances[:-1])
        forward = _extrapolate(1.0 / distances, angles)
        backward = _extrapolate(1.0 / distances[::-1], -angles[::-1])[::-1]
        tolerance = _LINE_TOLERANCE * steps[1:-1]
        in_line = np.abs(forward - distances[2:])[:-1] <= tolerance
        is_same[1:-1] |= in_line & (np.abs(backward - distances[:-2])[1:] <= tolerance)
        is_same &= steps <= _MAX_STEP
    return is_same & (gaps > 0.0) & np.isfinite(steps)


def _extrapolate(inverse_distances: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """The distance [m] that puts each reading in line with the two before it, shape (readings - 2,).

    Along a straight line, the inverse distance is proportional to the sine of the angle between beam and line.
    """
    sines = np.sin(np.diff(angles))
    outer_sines = np.sin(angles[2:] - angles[:-2])
    return sines[:-1] / (outer_sines * inverse_distances[1:-1] - sines[1:] * inverse_distances[:-2])
