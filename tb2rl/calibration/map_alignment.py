"""Aligns scans with the walls of a map, for the scales of the odometry.

The odometry may drift, so each window of time has a pose of its own in the map: the best one for the other parameters
(variable projection, Golub and Pereyra 1973). These are the parameters of `alignment`; the bias also absorbs walls that
the map draws too thick. The first pose is found by the distances from readings to the nearest wall (likelihood field,
Thrun, Burgard and Fox 2005, "Probabilistic Robotics", section 6.4).
"""

from dataclasses import dataclass

import numpy as np
import shapely

from tb2rl.calibration.alignment import BIAS, PRIOR, START, Alignment, inverse, spread_indices, transform, unit_vectors
from tb2rl.calibration.estimates import Solution, solve
from tb2rl.core import InputError
from tb2rl.deploy.bags.reading import Drive
from tb2rl.deploy.bags.scans import Scans
from tb2rl.worlds import World

_WINDOW, _BLOCK = 12.0, 3.0  # [s] over which the odometry does not drift; errors in a block depend on each other
_SCANS, _BEAMS = 250, 60  # most scans, and beams of each
_GATES = 0.5, 0.3, 0.1, 0.1, 0.1  # [m] largest distances from a reading to its wall
_MIN_SHARE = 0.6  # of the readings that lie at walls, if the map is that of the drive
_ANCHOR_PRIOR = 0.5  # [m], [rad] standard deviation of a window's pose, for directions in which no wall tells it
_SETTLING = 3  # steps to the best poses of the windows
_CELL, _YAWS, _FAR = 0.1, 48, 0.5  # the search of the first pose: [m], directions, [m] largest distance that counts
_POSITIONS, _SEARCH_READINGS = 50_000, 60  # most positions, and readings for each pose
_CANDIDATES = 30  # poses that are refined


@dataclass(frozen=True)
class _Readings:
    """Readings in the order of time, shape (readings, ...)."""

    times: np.ndarray  # [s] stamps of their scans
    windows: np.ndarray  # numbers of their windows
    ranges: np.ndarray  # [m]
    beams: np.ndarray  # unit vectors in the laser's frame


@dataclass(frozen=True)
class _Walls:
    """The nearest walls of some readings."""

    indices: np.ndarray  # of the readings, shape (n,)
    points: np.ndarray  # on the walls [m], shape (n, 2)
    normals: np.ndarray  # shape (n, 2)


class MapAlignment(Alignment):
    """The scans and the odometry of a drive, in a map; `noise` is the standard deviation of the ranges [m]."""

    def __init__(self, drive: Drive, scans: Scans, noise: float, world: World) -> None:
        super().__init__(drive, scans, noise)
        self._drive_name, self._world = drive.name, world
        rings = shapely.get_rings(shapely.get_parts(world.obstacles))
        corners, ring = shapely.get_coordinates(rings, return_index=True)
        is_wall = ring[1:] == ring[:-1]
        self._corners, along = corners[:-1][is_wall], np.diff(corners, axis=0)[is_wall]
        self._normals = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
        self._tree = shapely.STRtree(shapely.linestrings(np.stack([self._corners, self._corners + along], axis=1)))
        numbers, beams = spread_indices(len(scans.times), _SCANS), spread_indices(len(self._angles), _BEAMS)
        times, ranges = np.repeat(scans.times[numbers], len(beams)), self._ranges[np.ix_(numbers, beams)].ravel()
        directions = np.tile(unit_vectors(self._angles[beams]), (len(numbers), 1))
        seen = np.isfinite(ranges)
        times, ranges, directions = times[seen], ranges[seen], directions[seen]
        first = float(times.min(initial=scans.times[-1]))  # windows begin where the laser sees something
        windows = ((times - first) // _WINDOW).astype(int)
        self._starts = first + _WINDOW * np.arange(windows.max(initial=0) + 1)
        self._readings = _Readings(times, windows, ranges, directions)

    def solve(self) -> Solution:
        """Fit the parameters of `Alignment`; raises an `InputError` if the scans do not fit the map."""
        parameters, anchors, everything = START, self._first_anchors(), np.arange(len(self._readings.times))
        for gate in _GATES:
            walls = self._nearest_walls(everything, anchors, parameters, gate)

            def residuals(values: np.ndarray, walls: _Walls = walls, anchors: np.ndarray = anchors) -> np.ndarray:
                return self._settle(walls, anchors, values)[1]

            blocks = (self._readings.times[walls.indices] // _BLOCK).astype(int)
            solution = solve(residuals, parameters, PRIOR, blocks - blocks.min(initial=0), START)
            parameters = solution.values
            anchors, _ = self._settle(walls, anchors, parameters)
        share = len(walls.indices) / max(1, len(everything))
        if share < _MIN_SHARE:
            text = f"only {share:.0%} of its readings lie at walls of that map"
            raise InputError(f"{self._drive_name} was not recorded in {self._world.name}: {text}")
        return solution

    def _first_anchors(self) -> np.ndarray:
        """Poses in the map at the start of each window, before any parameter is known, shape (windows, 3)."""
        odometry = self.poses(self._starts, START)
        anchors = np.tile(self._search(), (len(odometry), 1))
        for window in range(len(anchors)):
            if window:
                before, now = odometry[window - 1 : window], odometry[window]
                anchors[window, :2] = transform(anchors[window - 1 : window], inverse(before, now[None, :2]))
                anchors[window, 2] = anchors[window - 1, 2] + now[2] - before[0, 2]
            readings = np.flatnonzero(self._readings.windows == window)
            anchors, _ = self._refine(readings, anchors)
        return anchors

    def _search(self) -> np.ndarray:
        """The pose in the map at the start of the first window, shape (3,)."""
        readings = np.flatnonzero(self._readings.windows == 0)
        readings = readings[spread_indices(len(readings), _SEARCH_READINGS)]
        (x0, y0, x1, y1), far = self._world.bounds, _FAR
        x, y = np.arange(x0 - far, x1 + far, _CELL), np.arange(y0 - far, y1 + far, _CELL)
        cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        points = shapely.points(cells)
        near, distances = self._tree.query_nearest(points, max_distance=far, return_distance=True, all_matches=False)
        field = np.full(len(cells), far)
        field[near[0]] = distances
        free = cells[(field > 0.15) & ~shapely.contains_xy(self._world.obstacles, *cells.T)]
        free = free[spread_indices(len(free), _POSITIONS)]
        local, poses, scores = self._local(START)[readings], [], []
        for yaw in np.linspace(-np.pi, np.pi, _YAWS, endpoint=False):
            seen = free[:, None] + transform(np.array([[0.0, 0.0, yaw]]), local)
            index = np.rint((seen - (x[0], y[0])) / _CELL).astype(int)
            inside = ((index >= 0) & (index < (len(x), len(y)))).all(axis=-1)
            found = np.where(inside, field[np.where(inside, index[..., 0] * len(y) + index[..., 1], 0)], far)
            poses.append(np.column_stack([free, np.full(len(free), yaw)]))
            scores.append(found.sum(axis=1))
        best = np.concatenate(poses)[np.argsort(np.concatenate(scores), kind="stable")[:_CANDIDATES]]
        tried = [self._refine(readings, pose[None]) for pose in best]
        anchors, _ = max(tried, key=lambda each: each[1])
        return anchors[0]

    def _refine(self, readings: np.ndarray, anchors: np.ndarray) -> tuple[np.ndarray, int]:
        """Anchors with which some readings, by their indices, lie at walls; and the number of readings that do."""
        for gate in _GATES:
            walls = self._nearest_walls(readings, anchors, START, gate)
            anchors, _ = self._settle(walls, anchors, START)
        return anchors, len(walls.indices)

    def _local(self, parameters: np.ndarray, shift: float = 0.0) -> np.ndarray:
        """Readings, shortened by `shift` [m], in the frame of the robot at the start of their window, (readings, 2)."""
        each = self._readings
        on_laser = (each.ranges - parameters[BIAS] - shift)[:, None] * each.beams
        on_floor = self._to_floor(on_laser, each.times, parameters)
        return inverse(self.poses(self._starts, parameters)[each.windows], on_floor)

    def _nearest_walls(self, readings: np.ndarray, anchors: np.ndarray, parameters: np.ndarray, gate: float) -> _Walls:
        """The walls at most a `gate` [m] away from readings with given indices."""
        gate, shift = max(gate, 4.0 * self._noise), 2.0 * self._noise  # so that noise does not reach the back of a wall
        windows = self._readings.windows[readings]
        seen, shifted = (transform(anchors[windows], self._local(parameters, each)[readings]) for each in (0.0, shift))
        near, wall = self._tree.query_nearest(shapely.points(shifted), max_distance=gate + shift, all_matches=False)
        points, normals = self._corners[wall], self._normals[wall]
        close = np.abs(((seen[near] - points) * normals).sum(axis=1)) < gate
        return _Walls(readings[near[close]], points[close], normals[close])

    def _settle(self, walls: _Walls, anchors: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The best anchors for some parameters, and the errors of readings in units of their usual size."""
        start, windows = anchors, self._readings.windows[walls.indices]
        local = self._local(parameters)[walls.indices]
        for _ in range(_SETTLING):
            errors, jacobian = self._errors(walls, anchors[windows], local)
            weighted = jacobian.T / np.sqrt(1.0 + errors**2)  # of the soft L1 loss
            squares = [_sums(windows, each * weighted, len(anchors)) for each in jacobian.T]
            matrices = np.stack(squares, axis=1) + np.eye(3) / _ANCHOR_PRIOR**2
            vectors = (start - anchors) / _ANCHOR_PRIOR**2 - _sums(windows, errors * weighted, len(anchors))
            anchors = anchors + np.linalg.solve(matrices, vectors[:, :, None])[:, :, 0]
        return anchors, self._errors(walls, anchors[windows], local)[0]

    def _errors(self, walls: _Walls, anchors: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from readings to their walls in units of their usual size, and the derivatives by x, y and yaw."""
        seen = transform(anchors, local)
        x, y = (seen - anchors[:, :2]).T
        turned = walls.normals[:, 1] * x - walls.normals[:, 0] * y
        errors = ((seen - walls.points) * walls.normals).sum(axis=1)
        return errors / self._error, np.column_stack([walls.normals, turned]) / self._error


def _sums(groups: np.ndarray, columns: np.ndarray, count: int) -> np.ndarray:
    """Sums of columns (columns, n) by group, shape (count, columns)."""
    return np.column_stack([np.bincount(groups, column, count) for column in columns])
