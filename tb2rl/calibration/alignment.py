"""Aligns scans of different times by point-to-line distances (Censi 2008, "An ICP variant using a point-to-line
metric"): the scales of the odometry, the delay of the scans' stamps, and the laser's mounting and bias are those with
which the scans fit best.

Lines are fitted to neighbouring readings. The middles of lines in partner scans are compared with the line at their
direction, as seen from a reference scan. Only relative poses over some seconds count, so that odometry may drift.
"""

import math
from dataclasses import dataclass

import numpy as np

from tb2rl.calibration.estimates import Solution, solve
from tb2rl.calibration.laser import used_beams
from tb2rl.deploy.bags.reading import Drive
from tb2rl.deploy.bags.scans import Scans

DISTANCE, TURN, DELAY, X, Y, YAW, BIAS = range(7)
START = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
PRIOR = np.array([0.1, 0.1, 0.15, 0.15, 0.15, 0.3, 0.1])  # standard deviations: ratio, ratio, s, m, m, rad, m
_SPANS, _GATES = (1.5, 4.0, 12.0, 12.0), (0.5, 0.3, 0.2, 0.1)  # [s] between the scans of a pair; [m] largest distances
_REFERENCES, _PARTNERS, _LINES = 600, 3, 60  # most reference scans, partners of each, and lines of a partner
_BLOCK = 3.0  # [s] errors of references in one block depend on each other
_MAX_RANGE = 12.0  # [m] readings that are used
_MIN_COSINE = 0.3  # of the angle between a beam and the normal of a wall
_MIN_AGREEMENT = 0.978  # cosine of the angle between the normals of two lines on the same wall
_MIN_ERROR = 0.004  # [m] of a distance, without noise


@dataclass(frozen=True)
class Lines:
    """A line for each beam of some scans, shape (scans, beams, 2): its middle and its normal."""

    points: np.ndarray
    normals: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True)
class Matches:
    """Middles of lines in partner scans, and the lines with which they are compared; all of shape (matches, ...)."""

    reference_times: np.ndarray  # [s]
    partner_times: np.ndarray  # [s]
    readings: np.ndarray  # points x, y [m] in the laser's frame of the partner
    reading_directions: np.ndarray
    points: np.ndarray  # of the lines [m], in the laser's frame of the reference
    directions: np.ndarray
    normals: np.ndarray
    clusters: np.ndarray  # number of the block of time of the reference


class Alignment:
    """The scans and the odometry of a drive; `noise` is the standard deviation of the ranges [m]."""

    def __init__(self, drive: Drive, scans: Scans, noise: float) -> None:
        self._odometry = drive.odometry
        self._times = self._odometry[:, 0] - self._odometry[:, 6]
        self._scan_times, (self._ranges, self._angles) = scans.times, used_beams(scans)
        self._ranges[~(self._ranges < _MAX_RANGE)] = np.nan
        self._window = max(1, round((0.03 + 2.5 * noise) / float(np.median(np.diff(self._angles)))))
        self._noise = noise
        self._error = max(_MIN_ERROR, 1.2 * noise * math.sqrt(2.0 / (2 * self._window + 1)))  # between two means
        yaw = np.unwrap(self._odometry[:, 3])
        steps = np.diff(self._odometry[:, 1:3], axis=0)
        heading = yaw[:-1] + 0.5 * np.diff(yaw)
        self._arcs = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)  # [m] between two messages
        self._yaw = yaw - yaw[0]

    def solve(self) -> Solution:
        """Fit the parameters, by the columns above; from scans that are near in time to those that are far."""
        rng, parameters = np.random.default_rng(0), START
        for span, gate in zip(_SPANS, _GATES, strict=True):
            matches = self._match(parameters, span, max(gate, 4.0 * self._noise), rng)

            def residuals(values: np.ndarray, matches: Matches = matches, bias: float = parameters[BIAS]) -> np.ndarray:
                return self._distances(values, matches, bias) / self._error

            clusters = matches.clusters - matches.clusters.min(initial=0)
            solution = solve(residuals, parameters, PRIOR, clusters, START)
            parameters = solution.values
        return solution

    def poses(self, times: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Poses x, y, yaw of the robot at times [s], by the odometry corrected by its scales, shape (times, 3)."""
        yaw = self._yaw / parameters[TURN]
        heading, arcs = yaw[:-1] + 0.5 * np.diff(yaw), self._arcs / parameters[DISTANCE]
        x, y = (np.concatenate([[0.0], np.cumsum(arcs * each(heading))]) for each in (np.cos, np.sin))
        return np.column_stack([np.interp(times, self._times, column) for column in (x, y, yaw)])

    def points(self, numbers: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Readings x, y [m] of scans in one frame, shape (readings, 2)."""
        ranges = self._ranges[numbers] - parameters[BIAS]
        readings = (ranges[..., None] * unit_vectors(self._angles)).reshape(-1, 2)
        times = np.repeat(self._scan_times[numbers], len(self._angles))
        found = self._to_floor(readings, times, parameters)
        return found[np.isfinite(found[:, 0])]

    def _to_floor(self, points: np.ndarray, times: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Points in the laser's frame at stamps [s], in the frame of the odometry; both have the shape (points, 2)."""
        on_robot = transform(parameters[None, [X, Y, YAW]], points)
        return transform(self.poses(times - parameters[DELAY], parameters), on_robot)

    def _match(self, parameters: np.ndarray, span: float, gate: float, rng: np.random.Generator) -> Matches:
        """Pair scans up to `span` [s] apart, and readings with lines up to `gate` [m] apart."""
        pairs = self._pairs(span, rng)
        numbers, pairs = np.unique(pairs, return_inverse=True)
        references, partners = pairs.reshape(2, -1)
        lines, scan_times = self._lines(numbers, parameters[BIAS]), self._scan_times[numbers]
        beams, directions = spread_indices(len(self._angles), _LINES), unit_vectors(self._angles)
        pair, beam = (each.ravel() for each in np.meshgrid(np.arange(len(partners)), beams, indexing="ij"))
        partner = partners[pair], beam
        times = scan_times[references[pair]], scan_times[partners[pair]]
        seen = self._into_reference(lines.points[partner], *times, parameters)
        step = float(np.median(np.diff(self._angles)))
        with np.errstate(invalid="ignore"):
            position = (np.arctan2(seen[:, 1], seen[:, 0]) - self._angles[0]) / step
        inside = (position > -0.5) & (position < len(self._angles) - 0.5)
        reference = references[pair], np.where(inside, np.round(np.nan_to_num(position)), 0).astype(int)
        points, normals = lines.points[reference], lines.normals[reference]
        difference, tips = seen - points, lines.points[partner] + lines.normals[partner]
        partner_normals = self._into_reference(tips, *times, parameters) - seen
        with np.errstate(invalid="ignore"):
            near = (np.abs((difference * normals).sum(axis=1)) < gate) & (np.hypot(*difference.T) < 2.0 * gate + 0.1)
            near &= np.abs((seen * normals).sum(axis=1)) > _MIN_COSINE * np.hypot(*seen.T)
            near &= np.abs((partner_normals * normals).sum(axis=1)) > _MIN_AGREEMENT
        keep = inside & near & lines.valid[reference] & lines.valid[partner]
        blocks = (times[0] // _BLOCK).astype(int)
        columns = *times, lines.points[partner], directions[beam], points, directions[reference[1]], normals, blocks
        return Matches(*(column[keep] for column in columns))

    def _pairs(self, span: float, rng: np.random.Generator) -> np.ndarray:
        """Numbers of reference scans and of their partners, up to `span` [s] apart, shape (2, pairs)."""
        count = len(self._scan_times)
        references = spread_indices(count, _REFERENCES)
        targets = self._scan_times[references, None] + rng.uniform(-span, span, (len(references), _PARTNERS))
        partners = np.clip(np.searchsorted(self._scan_times, targets), 0, count - 1)
        pairs = np.stack([np.repeat(references, _PARTNERS), partners.ravel()])
        return pairs[:, pairs[0] != pairs[1]]

    def _lines(self, numbers: np.ndarray, bias: float) -> Lines:
        """Fit a line to the neighbours of each reading, by principal components."""
        directions = unit_vectors(self._angles)
        points = (self._ranges[numbers] - bias)[..., None] * directions
        finite = np.isfinite(points[..., 0])
        x, y = np.where(finite, points[..., 0], 0.0), np.where(finite, points[..., 1], 0.0)
        columns = np.stack([finite.astype(float), x, y, x * x, x * y, y * y])
        width = 2 * self._window + 1
        padded = np.pad(columns, ((0, 0), (0, 0), (self._window + 1, self._window)))
        sums = np.cumsum(padded, axis=-1)
        count, x, y, xx, xy, yy = sums[..., width:] - sums[..., :-width]
        count = np.maximum(count, 1.0)
        mean = np.stack([x / count, y / count], axis=-1)
        mean_x, mean_y = mean[..., 0], mean[..., 1]
        xx, xy, yy = xx / count - mean_x**2, xy / count - mean_x * mean_y, yy / count - mean_y**2
        half_difference = np.hypot(0.5 * (xx - yy), xy)
        least = np.sqrt(np.maximum(0.5 * (xx + yy) - half_difference, 0.0))
        normal_angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + math.pi / 2
        normals = unit_vectors(normal_angle)
        facing = np.abs((normals * directions).sum(axis=-1)) > _MIN_COSINE
        long = 0.5 * (xx + yy) + half_difference > 9.0 * least**2  # a line, not a cloud
        valid = finite & (count > 0.6 * width) & (least < 1.15 * self._noise + 0.003) & facing & long
        return Lines(mean, normals, valid)

    def _into_reference(
        self, readings: np.ndarray, reference_times: np.ndarray, partner_times: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """Move readings from the laser's frame at the partner's times into that at the reference's times."""
        references = self.poses(reference_times - parameters[DELAY], parameters)
        on_robot = inverse(references, self._to_floor(readings, partner_times, parameters))
        return inverse(parameters[None, [X, Y, YAW]], on_robot)

    def _distances(self, parameters: np.ndarray, matches: Matches, bias: float) -> np.ndarray:
        """Distances of readings from their lines [m], shape (matches,); both were made with a `bias`."""
        change = parameters[BIAS] - bias
        readings = matches.readings - change * matches.reading_directions
        seen = self._into_reference(readings, matches.reference_times, matches.partner_times, parameters)
        return ((seen - matches.points + change * matches.directions) * matches.normals).sum(axis=1)


def spread_indices(count: int, most: int) -> np.ndarray:
    """At most so many indices, evenly spread over `count` ones."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def unit_vectors(angles: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def transform(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) in the frames of poses (n, 3), in the frame of the poses."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = points.T
    return np.column_stack([poses[:, 0] + cos * x - sin * y, poses[:, 1] + sin * x + cos * y])


def inverse(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) in the frame of the poses, in the frames of poses (n, 3)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = (points - poses[:, :2]).T
    return np.column_stack([cos * x + sin * y, cos * y - sin * x])
