"""Cheapest paths to a goal from anywhere in a world: path lengths and lookahead points.

Path lengths come from fast marching on the grid of `tb2rl.worlds.floor`. Cells near a wall have higher costs, so that
paths keep a distance from walls where there is room. The length of a path is weighted with these costs: near walls, a
metre counts as more than a metre.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.fast_marching import march
from tb2rl.worlds.floor import CELL_SIZE, MAX_CELLS, Floor, RaggedTable, nearest_cell
from tb2rl.worlds.world import World

RANDOM_GOALS = 4  # count of random goals in each world, besides the world's own goal
OWN_GOAL = 0  # number of a world's own goal; the random goals have the numbers 1 to `RANDOM_GOALS`
PREFERRED_GAP = 0.35  # [m] between robot and walls; cells with a smaller gap cost more
_DOUBLE_COST_GAP = 0.15  # [m] cells with this gap cost about double; the additional cost grows with 1 / gap^2
_MAX_COST = 20.0  # of a cell at a wall, so that paths prefer detours; higher costs would distort path directions
_FINE_CELL = 0.05  # [m] side of a cell; with 0.1 m, passages of 0.4 m and of 0.5 m can get the same costs
_PATH_STEP = 0.5 * _FINE_CELL  # [m] longer steps along a path would cut corners
_STRAIGHT_RADIUS = 0.25  # [m] distance from the goal below which paths are straight
_GOAL_CLEARANCE = 0.3  # [m] clearance of random goals, if any reachable cell has it


class GoalPaths:
    """Paths of a robot with a radius [m] to the goals of many worlds.

    A goal is identified by the index of its world and by its number there: `OWN_GOAL`, or 1 to `RANDOM_GOALS`. Random
    goals are the same in every process. The paths to a goal are computed at its first use, in parallel if there are
    several worlds.
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._goals = np.full((len(worlds) * (RANDOM_GOALS + 1), 2), np.nan)  # NaN: not used yet, or no own goal
        self._lengths = RaggedTable(len(self._goals))  # path lengths to each goal, from all cells of its world
        self._grids = np.zeros((len(worlds), 5))  # a row for each world, the `grid` of `path_lengths_to`

    def goals(self, worlds: np.ndarray, goal_numbers: np.ndarray) -> np.ndarray:
        """X and y of goals [m], shape (num_envs, 2), by worlds and goal numbers of shape (num_envs,)."""
        return self._goals[self._goal_indices(worlds, goal_numbers)]

    def path_length(self, worlds: np.ndarray, goal_numbers: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Path lengths to goals [m], shape (num_envs,).

        Args:
            worlds, goal_numbers: World and number of each goal, shape (num_envs,).
            positions: x, y [m] in the first two columns, such as poses, shape (num_envs, n).
        """
        lengths, positions = np.empty(len(positions)), np.array(positions)  # always contiguous, to compile only once
        offsets = self._lengths.first_rows[self._goal_indices(worlds, goal_numbers)]
        _interpolate(offsets, self._grids[worlds], self._lengths.rows, positions, lengths)
        return lengths

    def lookahead_point(
        self, worlds: np.ndarray, goal_numbers: np.ndarray, positions: np.ndarray, lookahead: float
    ) -> np.ndarray:
        """Points `lookahead` [m] ahead on the paths, or the goals if they are nearer, shape (num_envs, 2)."""
        goal_indices, positions = self._goal_indices(worlds, goal_numbers), np.array(positions)
        offsets, goals = self._lengths.first_rows[goal_indices], self._goals[goal_indices]
        points = np.empty((len(positions), 2))
        lookahead_points(offsets, self._grids[worlds], self._lengths.rows, positions, goals, lookahead, points)
        return points

    def _goal_indices(self, worlds: np.ndarray, goal_numbers: np.ndarray) -> np.ndarray:
        """Indices of goals in `_goals` and `_lengths`; computes missing paths first."""
        indices = worlds * (RANDOM_GOALS + 1) + goal_numbers
        is_missing = self._lengths.first_rows[indices] < 0
        if is_missing.any():  # `unique` is slow, and this runs in every step
            self._compute_paths(np.unique(indices[is_missing]))
        return indices

    def _compute_paths(self, indices: np.ndarray) -> None:
        """Compute the paths to the goals with these indices, in ascending order."""
        worlds, first_goals = np.unique(indices // (RANDOM_GOALS + 1), return_index=True)
        goals_by_world = np.split(indices, first_goals[1:])
        self._lengths.reserve(sum(_grid_size(self._worlds[i // (RANDOM_GOALS + 1)])[1] for i in indices.tolist()))
        with ThreadPoolExecutor(numba.config.NUMBA_NUM_THREADS) as threads:
            results = threads.map(self._paths_in_world, worlds.tolist(), goals_by_world)
            for goals, lengths in zip(goals_by_world, results, strict=True):
                for index, lengths_to_goal in zip(goals, lengths, strict=True):
                    self._lengths.add(index, lengths_to_goal)

    def _paths_in_world(self, world: int, indices: np.ndarray) -> list[np.ndarray]:
        """Path lengths to goals of one world; writes only rows of this world, because it runs in threads.

        The costs are not kept, because those of many large worlds would take gigabytes.
        """
        cell_side, _ = _grid_size(self._worlds[world])
        floor = Floor.of(self._worlds[world], self._radius + PREFERRED_GAP, cell_side)
        self._grids[world] = *floor.clearance.shape, *floor.first_centre, cell_side
        self._find_goals(world, indices, floor)
        costs = path_costs(floor.clearance, self._radius)
        return [path_lengths_to(self._goals[index], costs, self._grids[world]).ravel() for index in indices]

    def _find_goals(self, world: int, indices: np.ndarray, floor: Floor) -> None:
        """Set the goals with these indices, and all random goals of the world if any is among them."""
        first, own_goal, start = world * (RANDOM_GOALS + 1), self._worlds[world].goal, self._worlds[world].start
        if own_goal is not None:
            self._goals[first + OWN_GOAL] = own_goal[:2]
        if indices[-1] == first + OWN_GOAL or not np.isnan(self._goals[first + RANDOM_GOALS, 0]):
            return
        reachable = np.isfinite(floor.steps_from(*start[:2], self._radius))
        has_room = reachable & (floor.clearance >= _GOAL_CLEARANCE)
        cells = np.flatnonzero(has_room if has_room.any() else reachable)
        for number in range(1, RANDOM_GOALS + 1):
            cell = cells[np.random.default_rng((world, number)).integers(len(cells))]
            self._goals[first + number] = floor.centre(*divmod(cell, reachable.shape[1]))


def _grid_size(world: World) -> tuple[float, int]:
    """Side of a cell [m], and about the number of cells, for the paths in a world."""
    x0, y0, x1, y1 = world.bounds
    area = (x1 - x0) * (y1 - y0)
    cell_side = _FINE_CELL if area <= MAX_CELLS * _FINE_CELL**2 else CELL_SIZE
    return cell_side, int(min(area / cell_side**2, MAX_CELLS))  # `Floor.of` refuses more


def path_lengths_to(goal: np.ndarray, costs: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Path length from each cell of a grid to a goal [m], weighted with the costs, shape (rows, columns).

    Args:
        goal: x, y [m], shape (2,).
        costs: Costs of the cells, see `path_costs`.
        grid: Number of rows and of columns, x and y of the first cell's centre [m], side of a cell [m]; shape (5,).
    """
    rows, columns, left, bottom, cell_side = grid.tolist()
    row, column = nearest_cell(goal[1], bottom, cell_side, rows), nearest_cell(goal[0], left, cell_side, columns)
    return march(costs, row, column, cell_side)


def path_costs(clearance: np.ndarray, radius: float) -> np.ndarray:
    """Factor on the length of a path over each cell; 0 in blocked cells, where a robot of this radius [m] has no room.

    The clearances [m] must be clipped at the radius plus `PREFERRED_GAP`.
    """
    gap = np.maximum(clearance - radius, 1e-3)
    costs = 1.0 + (_DOUBLE_COST_GAP / gap) ** 2 - (_DOUBLE_COST_GAP / PREFERRED_GAP) ** 2
    return np.where(clearance >= radius, np.minimum(costs, _MAX_COST), 0.0)


def shortest_path_length(world: World, radius: float) -> float:
    """Length of the shortest path from a world's start to its goal for a robot of this radius [m]; inf without a path.

    The result is up to 5 % too long, because grid paths keep some centimetres away from corners, and fast marching
    overestimates lengths.
    """
    assert world.goal is not None
    floor = Floor.of(world, radius + CELL_SIZE)
    start, goal = floor.cell_at(*world.start[:2]), floor.cell_at(*world.goal[:2])
    if math.isinf(floor.steps_from(*world.start[:2], radius)[goal]):
        return math.inf
    return float(march(np.where(floor.clearance >= radius, 1.0, 0.0), *goal, CELL_SIZE)[start])


@njit(cache=True)
def _grid_position(grid, x, y):
    """Row and column of the lower left of the four cells around a point, and the position of the point between them.

    The position has two parts, up and right, each from 0 at the centre of the lower left cell to 1 at the next centre.
    `grid` is that of `path_lengths_to`.
    """
    column_position = min(max((x - grid[2]) / grid[4], 0.0), grid[1] - 1.0)
    row_position = min(max((y - grid[3]) / grid[4], 0.0), grid[0] - 1.0)
    column, row = min(int(column_position), max(int(grid[1]) - 2, 0)), min(int(row_position), max(int(grid[0]) - 2, 0))
    return row, column, row_position - row, column_position - column


@njit(cache=True)
def _interpolate(offsets, grids, lengths_of_cells, positions, lengths):
    """Write path lengths (num_envs,), interpolated linearly between cell centres; see `GoalPaths.path_length`.

    The `lengths_of_cells` of each environment begin at its offset (num_envs,), in the order of the cells of its grid.
    """
    for i in range(positions.shape[0]):
        row, column, up, right = _grid_position(grids[i], positions[i, 0], positions[i, 1])
        columns = int(grids[i, 1])
        to_right, to_above = 1 if columns > 1 else 0, columns if grids[i, 0] > 1.0 else 0
        cell = offsets[i] + row * columns + column
        below = (1 - right) * lengths_of_cells[cell] + right * lengths_of_cells[cell + to_right]
        above = (1 - right) * lengths_of_cells[cell + to_above] + right * lengths_of_cells[cell + to_above + to_right]
        lengths[i] = (1 - up) * below + up * above


@njit(cache=True)
def _path_direction(offset, grid, lengths_of_cells, row, column, up, right):
    """Direction of the path at a point, interpolated linearly between the directions in the four cells around it.

    `row`, `column`, `up` and `right` are those of `_grid_position`. The direction in a cell is the gradient towards its
    neighbours with shorter paths, as in fast marching. The gradient of the interpolated lengths would oscillate in a
    narrow passage between costly cells.
    """
    rows, columns = int(grid[0]), int(grid[1])
    path_x, path_y = 0.0, 0.0
    for i in range(2):
        for j in range(2):
            weight = (up if i else 1.0 - up) * (right if j else 1.0 - right)
            r, c = min(row + i, rows - 1), min(column + j, columns - 1)
            cell = offset + r * columns + c
            here = lengths_of_cells[cell]
            if here == np.inf:
                continue  # the march to an aim ended before it
            at_left = lengths_of_cells[cell - 1] if c > 0 else np.inf
            at_right = lengths_of_cells[cell + 1] if c + 1 < columns else np.inf
            below = lengths_of_cells[cell - columns] if r > 0 else np.inf
            above = lengths_of_cells[cell + columns] if r + 1 < rows else np.inf
            x = max(here - min(at_left, at_right), 0.0)
            y = max(here - min(below, above), 0.0)
            norm = math.sqrt(x * x + y * y)
            if norm > 0.0:
                path_x += weight * (x if at_right < at_left else -x) / norm
                path_y += weight * (y if above < below else -y) / norm
    return path_x, path_y


@njit(cache=True)
def lookahead_points(offsets, grids, lengths_of_cells, positions, goals, lookahead, points):
    """Write lookahead points (num_envs, 2); see `GoalPaths.lookahead_point` and `_interpolate`."""
    for i in range(positions.shape[0]):
        x, y, remaining = positions[i, 0], positions[i, 1], lookahead
        while remaining > 0.0:
            goal_dx, goal_dy = goals[i, 0] - x, goals[i, 1] - y
            goal_distance = math.hypot(goal_dx, goal_dy)
            if goal_distance < _STRAIGHT_RADIUS:
                share = min(1.0, remaining / max(goal_distance, 1e-9))
                x, y = x + share * goal_dx, y + share * goal_dy
                break
            row, column, up, right = _grid_position(grids[i], x, y)
            path_x, path_y = _path_direction(offsets[i], grids[i], lengths_of_cells, row, column, up, right)
            norm = math.hypot(path_x, path_y)
            if not norm > 1e-6:
                break  # no neighbouring cell is nearer to the goal
            step = min(_PATH_STEP, remaining)
            x, y, remaining = x + step * path_x / norm, y + step * path_y / norm, remaining - step
        points[i, 0], points[i, 1] = x, y
