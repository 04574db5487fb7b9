"""Cheapest paths to a goal from anywhere in a world: path lengths and lookahead points.

Path lengths come from fast marching on the grid of `tb2rl.worlds.floor`. Cells near a wall have higher costs, so that
paths keep a distance from walls where there is room. The length of a path is weighted with these costs: near walls, a
metre counts as more than a metre.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from tb2rl.core.threads import THREADS
from tb2rl.worlds.fast_marching import march
from tb2rl.worlds.floor import CELL_SIZE, MAX_CELLS, Floor, RaggedTable, nearest_cell
from tb2rl.worlds.lookahead import lookahead_points, path_lengths
from tb2rl.worlds.world import World

RANDOM_GOALS = 4  # count of random goals in each world, besides the world's own goal
OWN_GOAL = 0  # number of a world's own goal; the random goals have the numbers 1 to `RANDOM_GOALS`
PREFERRED_GAP = 0.35  # [m] between robot and walls; cells with a smaller gap cost more
_DOUBLE_COST_GAP = 0.15  # [m] cells with this gap cost about double; the additional cost grows with 1 / gap^2
_MAX_COST = 20.0  # of a cell at a wall, so that paths prefer detours; higher costs would distort path directions
_FINE_CELL = 0.05  # [m] side of a cell; with 0.1 m, passages of 0.4 m and of 0.5 m can get the same costs
_GOAL_CLEARANCE = 0.3  # [m] clearance of random goals, if any reachable cell has it


class GoalPaths:
    """Paths of a robot with a radius [m] to the goals of many worlds.

    A goal is identified by the index of its world and by its number there: `OWN_GOAL`, or 1 to `RANDOM_GOALS`. Random
    goals are the same in every process. The paths to a goal are computed at its first use, in parallel if there are
    several worlds. If further goals are needed later, and there are several threads, as many are computed as there were
    before, because two cores compute many paths at once in half the time.
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
        offsets = self._lengths.first_rows[self._goal_indices(worlds, goal_numbers)]
        positions = np.array(positions)  # always contiguous, to compile only once
        return path_lengths(offsets, self._grids[worlds], self._lengths.rows, positions)

    def lookahead_point(
        self, worlds: np.ndarray, goal_numbers: np.ndarray, positions: np.ndarray, lookahead: float
    ) -> np.ndarray:
        """Points `lookahead` [m] ahead on the paths, or the goals if they are nearer, shape (num_envs, 2)."""
        goal_indices, positions = self._goal_indices(worlds, goal_numbers), np.array(positions)
        offsets, goals = self._lengths.first_rows[goal_indices], self._goals[goal_indices]
        return lookahead_points(offsets, self._grids[worlds], self._lengths.rows, positions, goals, lookahead)

    def _goal_indices(self, worlds: np.ndarray, goal_numbers: np.ndarray) -> np.ndarray:
        """Indices of goals in `_goals` and `_lengths`; computes missing paths first."""
        indices = worlds * (RANDOM_GOALS + 1) + goal_numbers
        is_missing = self._lengths.first_rows[indices] < 0
        if is_missing.any():  # `unique` is slow, and this runs in every step
            missing = np.unique(indices[is_missing])
            self._compute_paths(self._with_next_goals(missing) if THREADS > 1 else missing)
        return indices

    def _with_next_goals(self, indices: np.ndarray) -> np.ndarray:
        """Missing goals, and the missing ones after them that are likely to be used next; ascending indices."""
        missing = np.flatnonzero(self._lengths.first_rows < 0)
        are_own = missing % (RANDOM_GOALS + 1) == OWN_GOAL
        likely = missing[are_own == (indices[-1] % (RANDOM_GOALS + 1) == OWN_GOAL)]
        count = len(self._lengths.first_rows) - len(missing) - len(indices)
        first = np.searchsorted(likely, indices[-1], side="right")
        return np.unique(np.concatenate([indices, np.roll(likely, -first)[: max(count, 0)]]))

    def _compute_paths(self, indices: np.ndarray) -> None:
        """Compute the paths to the goals with these indices, in ascending order."""
        worlds, first_goals = np.unique(indices // (RANDOM_GOALS + 1), return_index=True)
        goals_by_world = np.split(indices, first_goals[1:])
        self._lengths.reserve(sum(_grid_size(self._worlds[i // (RANDOM_GOALS + 1)])[1] for i in indices.tolist()))
        with ThreadPoolExecutor(THREADS) as threads:
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
