"""Online mapping: each robot maps what its laser sees, and plans its path to the goal on this map."""

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.envs.scan_matching import MOUNT_YAW, NUM_ERRORS, POINT_UNIT, track
from tb2rl.simulation import RobotState, SimulationSpec
from tb2rl.simulation.spec import BOUNDS
from tb2rl.worlds.fast_marching import march_to
from tb2rl.worlds.floor import CELL_SIZE
from tb2rl.worlds.goal_paths import PREFERRED_GAP, path_costs
from tb2rl.worlds.lookahead import lookahead_points

_PLANNING_PERIOD = 6  # [control steps] between two plans, if the map has changed
_HIT_INCREMENT = 4  # added to the score of the cell where a beam ends; a passing beam subtracts 1
_MAX_HITS = 20  # largest score
_MAPPING_RANGE = 10.0  # [m] beyond which an error of the heading would misplace what a beam hits
_PASSING_GAP = 0.05  # [m] least distance behind a point at which a beam that passes it ends
_PASSING_WIDTH = 0.02  # [m] largest distance between a point and a beam that passes it
_BORDER = 2.0  # [m] of the maps around the bounds of the worlds
_MARGIN = 0.02  # [m] kept from points in addition to the robot's radius, because a map is not exact
_NEAR = 0.35  # [m] from a robot or a goal: here, paths may use cells with too little room
_NOISE = 0.08  # [m] of room that these cells may lack, because ranges are noisy
_STANDING_STEPS = 15  # control steps on the spot after which the robot takes another way
_STANDING_RADIUS = 0.15  # [m] of the spot
_ESCAPE_STEPS = 30  # control steps for which the robot leaves a spot
_ESCAPE_DISTANCE = 0.7  # [m]


class OccupancyMapper(EpisodeState):
    """Occupancy grids with a point in each cell, and the plans on them.

    A cell has a score, which is above 0 if the cell is occupied (Moravec & Elfes 1985, "High resolution maps from wide
    angle sonar"), and the mean of the points that beams have hit in it, so that thin walls and narrow doors are as
    accurate as the laser. A beam that passes this point lowers the score. Unknown space is free, as with
    `allow_unknown` in Nav2, so the plan changes with new scans. A beam without a hit tells nothing, as in Nav2 without
    `inf_is_valid`, because dark surfaces reflect nothing. The robot knows its start, and then its odometry, which scan
    matching corrects; it knows no obstacles.

    Where no path is left, the map is forgotten; a robot that stands for 1.5 s drives away from what is near, to the
    place with the most room, before it follows its plan again (as the recoveries of Nav2: clear the map, back up).

    Args:
        spec: The robot, its laser and the worlds, whose bounds determine the size of the maps.
    """

    field = "occupancy_map"

    def __init__(self, spec: SimulationSpec) -> None:
        bounds = spec.table[:, BOUNDS]
        sides = (bounds[:, [3, 2]] - bounds[:, [1, 0]]).max(axis=0) + 2 * _BORDER
        self._shape = tuple(np.ceil(sides / CELL_SIZE).astype(int) + 1)
        self._radius, self._angles = spec.robot.radius, spec.laser.angles
        self._range = min(spec.laser.max_range, _MAPPING_RANGE)

    def initial_arrays(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        shape = len(robot_state.pose), *self._shape
        return {
            "start": np.array(robot_state.pose[:, :2]),  # x, y [m]
            "pose": np.array(robot_state.pose),  # estimate of the laser's pose on the map
            "odometry": np.array(robot_state.odometry),  # of the last step
            "errors": np.zeros((shape[0], NUM_ERRORS)),  # see `tb2rl.envs.scan_matching`
            "hits": np.zeros(shape, np.int8),
            "points": np.zeros((*shape, 2), np.int8),
            "path_length": np.empty(shape, np.float32),
            "age": np.full(shape[0], _PLANNING_PERIOD),  # of the plan [control steps]
            "changes": np.ones(shape[0], np.int64),  # of the map since the plan
            "spot": np.array(robot_state.pose[:, :2]),  # where the robot was last seen to move
            "standing": np.zeros(shape[0], np.int64),  # [control steps] on this spot; negative: it escapes
            "escape": np.zeros((shape[0], 2)),  # the point to which it escapes
        }

    def update(self, robot_state: RobotState, commands: np.ndarray) -> None:
        """Add the latest scans to the maps, and renew the plans that the changes make old."""
        geometries, arrays = self._grid_geometries(robot_state), self._arrays
        poses, ranges, grids = arrays["pose"], np.array(robot_state.ranges), (arrays["hits"], arrays["points"])
        odometry, errors = np.array(robot_state.odometry), arrays["errors"]
        _localize(poses, arrays["odometry"], odometry, errors, ranges, self._angles, self._range, geometries, *grids)
        arrays["odometry"] = odometry
        _add_scans(poses, ranges, self._angles, self._range, geometries, *grids, arrays["changes"])
        arrays["age"] += 1
        self._count_standing(poses)
        is_old = (arrays["age"] >= _PLANNING_PERIOD) & (arrays["changes"] > 0)
        goals = self._goals(robot_state)
        for i in np.flatnonzero(is_old | (arrays["standing"] == _STANDING_STEPS)).tolist():
            self._plan(i, poses[i], goals[i], geometries[i])

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        lengths = self._arrays["path_length"]
        offsets = np.arange(len(lengths)) * math.prod(self._shape)  # first cell of each grid in the flat array
        poses, grids = self._arrays["pose"], self._grid_geometries(robot_state)
        points = lookahead_points(offsets, grids, lengths.ravel(), poses, self._goals(robot_state), lookahead)
        points = np.where(self._arrays["standing"][:, None] < 0, self._arrays["escape"], points)
        yaw = poses[:, 2] - self._mount_yaw
        return robot_state.pose[:, :2] + _rotate(points - poses[:, :2], robot_state.pose[:, 2] - yaw)

    @property
    def _mount_yaw(self) -> np.ndarray:
        """Estimates of the laser's yaw in the robot's frame [rad], shape (num_envs,)."""
        return self._arrays["errors"][:, MOUNT_YAW]

    def _goals(self, robot_state: RobotState) -> np.ndarray:
        """Goals x, y [m] on the maps, shape (num_envs, 2).

        A map begins with the heading of the robot as that of the laser, so it is turned by the yaw of the laser.
        """
        starts = self._arrays["start"]
        return starts + _rotate(robot_state.goal - starts, -self._mount_yaw)

    def _count_standing(self, poses: np.ndarray) -> None:
        """Count for how long each robot stands on a spot."""
        arrays = self._arrays
        arrays["standing"] += 1
        has_moved = np.hypot(*(poses[:, :2] - arrays["spot"]).T) > _STANDING_RADIUS
        begins_anew = (has_moved & (arrays["standing"] > 0)) | (arrays["standing"] == 0)
        arrays["standing"][begins_anew], arrays["spot"][begins_anew] = 0, poses[begins_anew, :2]

    def _plan(self, i: int, pose: np.ndarray, goal: np.ndarray, grid: np.ndarray) -> None:
        """Plan the path of one robot, or let it escape from a spot."""
        arrays, max_clearance = self._arrays, self._radius + PREFERRED_GAP
        clearance = np.full(self._shape, max_clearance)
        _limit_clearance(arrays["hits"][i], arrays["points"][i], max_clearance, clearance)
        if arrays["standing"][i] == _STANDING_STEPS:
            arrays["escape"][i] = _roomiest_point(clearance, grid, pose, self._radius)
            arrays["standing"][i] = -_ESCAPE_STEPS
        (row, column), (goal_row, goal_column) = _cell(grid, pose), _cell(grid, goal)
        costs = path_costs(clearance - _MARGIN, self._radius)
        for cell in ((row, column), (goal_row, goal_column)):
            _free_surroundings(costs, clearance, *cell, self._radius - _NOISE)
        lengths = march_to(costs, goal_row, goal_column, CELL_SIZE, (row, column))
        if np.isinf(lengths[row, column]):
            arrays["hits"][i] = 0
            lengths = march_to(np.ones(self._shape), goal_row, goal_column, CELL_SIZE, (row, column))
        arrays["path_length"][i], arrays["age"][i], arrays["changes"][i] = lengths, 0, 0

    def _grid_geometries(self, robot_state: RobotState) -> np.ndarray:
        """Geometry of each grid: rows, columns, x, y of the first cell's centre [m], cell size [m]; (num_envs, 5)."""
        corners = robot_state.initial_state.bounds[:, :2] - _BORDER
        ones = np.ones((len(corners), 1))
        return np.column_stack([self._shape * ones, corners, CELL_SIZE * ones])


def _rotate(vectors: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotate vectors (num_envs, 2) counter-clockwise by angles (num_envs,) [rad]."""
    (x, y), cos, sin = vectors.T, np.cos(angles), np.sin(angles)
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


@njit(cache=True)
def _localize(poses, before, odometry, errors, ranges, angles, max_range, geometries, hits, points):
    """Update the estimates of poses (num_envs, 3) and of errors (num_envs, `NUM_ERRORS`); see `track`."""
    for i in range(poses.shape[0]):
        grid = geometries[i], hits[i], points[i]
        track(poses[i], errors[i], before[i], odometry[i], ranges[i], angles, max_range, *grid)


@njit(cache=True)
def _cell(grid, position):
    """Row and column of the cell that contains a position x, y [m], or the nearest one; see `_grid_geometries`."""
    row = min(max(round((position[1] - grid[3]) / grid[4]), 0), int(grid[0]) - 1)
    return row, min(max(round((position[0] - grid[2]) / grid[4]), 0), int(grid[1]) - 1)


@njit(cache=True)
def _add_scans(poses, ranges, angles, max_range, geometries, hits, points, changes):
    """Add scans to the scores and the points; count cells that become occupied or free in `changes` (num_envs,).

    Args:
        poses, ranges: Of the robots, shape (num_envs, 3) and (num_envs, beams).
        angles: Directions of the beams [rad], shape (beams,).
        max_range: Points beyond it are not added [m].
        geometries: See `_grid_geometries`.
        hits, points: Shape (num_envs, rows, columns), and the same with a last axis x, y in `POINT_UNIT`.
    """
    rows, columns = hits.shape[1], hits.shape[2]
    for i in range(poses.shape[0]):
        x, y = poses[i, 0] - geometries[i, 2], poses[i, 1] - geometries[i, 3]
        for beam in range(ranges.shape[1]):
            heading, length = poses[i, 2] + angles[beam], ranges[i, beam]
            if length == np.inf:
                continue
            dx, dy, last_row, last_column = math.cos(heading), math.sin(heading), -1, -1
            for step in range(int(2 * min(length, max_range) / CELL_SIZE)):
                row = round(y / CELL_SIZE + 0.5 * step * dy)
                column = round(x / CELL_SIZE + 0.5 * step * dx)
                if not (0 <= row < rows and 0 <= column < columns):
                    break
                if hits[i, row, column] <= 0 or (row == last_row and column == last_column):
                    continue
                last_row, last_column = row, column
                to_x = column * CELL_SIZE + POINT_UNIT * points[i, row, column, 0] - x
                to_y = row * CELL_SIZE + POINT_UNIT * points[i, row, column, 1] - y
                is_passed = to_x * dx + to_y * dy < length - _PASSING_GAP
                if is_passed and abs(to_x * dy - to_y * dx) < _PASSING_WIDTH:
                    hits[i, row, column] -= 1
                    changes[i] += hits[i, row, column] == 0
            end_x, end_y = (x + length * dx) / CELL_SIZE, (y + length * dy) / CELL_SIZE
            row, column = round(end_y), round(end_x)
            if length > max_range or not (0 <= row < rows and 0 <= column < columns):
                continue
            score = max(hits[i, row, column], 0)
            changes[i] += score == 0
            # A point with the largest score stays, because a map that follows the pose drifts with it.
            share = _HIT_INCREMENT / (score + _HIT_INCREMENT) if score < _MAX_HITS else 0.0
            for axis, offset in enumerate((end_x - column, end_y - row)):
                new, old = 2 * 127 * offset, float(points[i, row, column, axis])
                points[i, row, column, axis] = round(old + share * (new - old))
            hits[i, row, column] = min(hits[i, row, column] + _HIT_INCREMENT, _MAX_HITS)


@njit(cache=True)
def _limit_clearance(hits, points, max_clearance, clearance):
    """Lower `clearance` (rows, columns) [m] to the distance from the points, up to `max_clearance` [m]."""
    rows, columns = hits.shape
    max_cells = int(max_clearance / CELL_SIZE + 0.5)
    for row in range(rows):
        for column in range(columns):
            if hits[row, column] <= 0:
                continue
            y = row + points[row, column, 1] * POINT_UNIT / CELL_SIZE
            x = column + points[row, column, 0] * POINT_UNIT / CELL_SIZE
            for r in range(max(row - max_cells, 0), min(row + max_cells + 1, rows)):
                for c in range(max(column - max_cells, 0), min(column + max_cells + 1, columns)):
                    clearance[r, c] = min(clearance[r, c], CELL_SIZE * math.hypot(r - y, c - x))


@njit(cache=True)
def _free_surroundings(costs, clearance, row, column, least_clearance):
    """Let paths begin or end at a cell, and near it in cells with a clearance [m] that noise may have lowered."""
    reach, highest = int(_NEAR / CELL_SIZE), costs.max()
    for r in range(max(row - reach, 0), min(row + reach + 1, costs.shape[0])):
        for c in range(max(column - reach, 0), min(column + reach + 1, costs.shape[1])):
            if costs[r, c] == 0.0 and clearance[r, c] >= least_clearance:
                costs[r, c] = highest
    costs[row, column] = max(costs[row, column], 1.0)


@njit(cache=True)
def _roomiest_point(clearance, grid, pose, radius):
    """The point x, y [m] around a robot with the most clearance, straight away from what is nearest to the robot.

    The safety filter lets a robot come no closer to obstacles that are near, so no place on the way has less clearance.
    """
    row, column = _cell(grid, pose)
    start_x, start_y, least = grid[2] + column * grid[4], grid[3] + row * grid[4], clearance[row, column]
    best, best_x, best_y = -1.0, pose[0], pose[1]
    for direction in range(16):
        heading = pose[2] + direction * math.tau / 16
        for step in range(1, int(_ESCAPE_DISTANCE / CELL_SIZE) + 1):
            x, y = start_x + step * CELL_SIZE * math.cos(heading), start_y + step * CELL_SIZE * math.sin(heading)
            row, column = _cell(grid, (x, y))
            if clearance[row, column] < (least if step <= 2 else max(least, radius)):
                break
            if clearance[row, column] >= best:  # clearances are limited, so take the farthest
                best, best_x, best_y = clearance[row, column], x, y
    return best_x, best_y
