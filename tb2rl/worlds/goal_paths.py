"""Paths from anywhere in a world to a goal: their lengths, and the points ahead on them.

The floor is a grid of squares (`tb2rl.worlds.floor`), path lengths come from fast marching. Squares near a wall cost
more, so that paths keep off walls where they can.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.fast_marching import march
from tb2rl.worlds.floor import MOST_SQUARES, SIDE, Floor, GrowingTable, nearest_square
from tb2rl.worlds.world import World

GOALS = 4  # random ones in each world, beside its own
OWN = 0  # number of a world's own goal; random ones have the numbers from 1
KEEP_OFF = 0.35  # [m] between robot and walls, below which squares cost more
_TIGHT = 0.15  # [m] gap at which a square costs about twice; the cost grows with the inverse square of the gap
_MOST_COST = 20.0  # worth any detour; with higher costs the slope would lead nowhere
_FINE = 0.05  # [m] side of a square: 0.1 m cannot tell a gap in which the robot sticks from one of half a metre
_STEP = 0.5 * _FINE  # [m] along a path: longer steps cut corners
_NEAR = 0.25  # [m] from the goal, within which a path is straight
_GOAL_ROOM = 0.3  # [m] around a random goal, where there is so much


class GoalPaths:
    """The paths to some goals in each of some worlds, computed for each goal when it is first used.

    A goal is identified by the index of its world and its number there: `OWN`, or 1 to `GOALS` for random goals, which
    are the same in every process.

    Args:
        worlds: The worlds.
        radius: Radius of the robot [m].
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._goals = np.full((len(worlds) * (GOALS + 1), 2), np.nan)
        self._begins = np.full(len(self._goals), -1)  # offset of a goal's field in `_lengths`; -1: not computed yet
        self._grids = np.zeros((len(worlds), 5))  # rows, columns, x and y of the first square's centre, side [m]
        self._floors: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._lengths = GrowingTable()

    def goals(self, worlds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Goals: x, y [m], shape (num_envs, 2), for worlds and numbers of shape (num_envs,)."""
        return self._goals[self._fields(worlds, numbers)]

    def path_length(self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Path lengths to goals [m], (num_envs,), from x, y [m], shape (num_envs, 2) or more columns."""
        lengths, places = np.empty(len(places)), np.array(places)  # compiled once, for arrays of one kind
        fields = self._fields(worlds, numbers)
        _interpolate(self._begins[fields], self._grids[worlds], self._lengths.rows, places, lengths)
        return lengths

    def lookahead_point(
        self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray, lookahead: float
    ) -> np.ndarray:
        """Points `lookahead` [m] ahead on the paths, or goals that are nearer, shape (num_envs, 2)."""
        fields, points, places = self._fields(worlds, numbers), np.empty((len(places), 2)), np.array(places)
        begins, goals = self._begins[fields], self._goals[fields]
        points_ahead(begins, self._grids[worlds], self._lengths.rows, places, goals, lookahead, points)
        return points

    def _fields(self, worlds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        fields = worlds * (GOALS + 1) + numbers
        missing = self._begins[fields] < 0
        if missing.any():
            for field in np.unique(fields[missing]).tolist():
                self._add(field, *divmod(field, GOALS + 1))
        return fields

    def _add(self, field: int, world: int, number: int) -> None:
        """Compute the paths to a goal."""
        if world not in self._floors:
            self._floors[world] = self._floor(world)
        costs, goal_squares = self._floors[world]
        self._goals[field] = goal = self._goal(world, number, goal_squares)
        self._begins[field] = self._lengths.append(_march_to(goal, costs, self._grids[world]).ravel())

    def _floor(self, world: int) -> tuple[np.ndarray, np.ndarray]:
        """Cost of each square, 0 if blocked, and x, y of the squares that random goals are drawn from."""
        x0, y0, x1, y1 = self._worlds[world].bounds
        side = _FINE if (x1 - x0) * (y1 - y0) <= MOST_SQUARES * _FINE**2 else SIDE
        floor = Floor.of(self._worlds[world], self._radius + KEEP_OFF, side)
        self._grids[world] = *floor.clearance.shape, *floor.corner, side
        reached = floor.steps_from(*self._worlds[world].start[:2], self._radius) >= 0
        roomy = reached & (floor.clearance >= _GOAL_ROOM)
        return _costs(floor.clearance, self._radius), floor.centres(roomy if roomy.any() else reached)

    def _goal(self, world: int, number: int, squares: np.ndarray) -> tuple[float, float]:
        own = self._worlds[world].goal
        if number == OWN:
            return (math.nan, math.nan) if own is None else own[:2]
        x, y = squares[np.random.default_rng((world, number)).integers(len(squares))].tolist()
        return x, y


def march_from(clearance: np.ndarray, radius: float, goal: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Path length from all squares of a map to a goal [m], see `GoalPaths`.

    Args:
        clearance: Of each square, at most `KEEP_OFF` more than the radius [m], shape (rows, columns).
        radius: Radius of the robot [m].
        goal: x, y [m], shape (2,).
        grid: Rows, columns, x and y of the first square's centre, side of a square [m], shape (5,).
    """
    return _march_to(goal.tolist(), _costs(clearance, radius), grid)


def _march_to(goal: Sequence[float], costs: np.ndarray, grid: np.ndarray) -> np.ndarray:
    rows, columns, left, bottom, side = grid.tolist()
    row, column = nearest_square(goal[1], bottom, side, rows), nearest_square(goal[0], left, side, columns)
    return march(costs, row, column, side)


def _costs(clearance: np.ndarray, radius: float) -> np.ndarray:
    """Factor on the length of a path over each square; 0 where a robot of that radius [m] does not fit."""
    gap = np.maximum(clearance - radius, 1e-3)
    costs = 1.0 + (_TIGHT / gap) ** 2 - (_TIGHT / KEEP_OFF) ** 2
    return np.where(clearance >= radius, np.minimum(costs, _MOST_COST), 0.0)


def shortest_path_length(world: World, radius: float) -> float:
    """Length of the shortest path from a world's start to its goal for a robot of that radius [m]; inf without one.

    It is up to a twentieth too long, because the grid keeps some centimetres off corners and fast marching rounds up.
    """
    assert world.goal is not None
    floor = Floor.of(world, radius + SIDE)
    start, goal = floor.square_at(*world.start[:2]), floor.square_at(*world.goal[:2])
    if floor.steps_from(*world.start[:2], radius)[goal] < 0:
        return math.inf
    return float(march(np.where(floor.clearance >= radius, 1.0, 0.0), *goal, SIDE)[start])


@njit(cache=True)
def _within_grid(grid, x, y):
    """Lower left of the four squares around a point, and the point's offsets between their centres, from 0 to 1."""
    across = min(max((x - grid[2]) / grid[4], 0.0), grid[1] - 1.0)
    along = min(max((y - grid[3]) / grid[4], 0.0), grid[0] - 1.0)
    column, row = min(int(across), max(int(grid[1]) - 2, 0)), min(int(along), max(int(grid[0]) - 2, 0))
    return row, column, along - row, across - column


@njit(cache=True)
def _interpolate(begins, grids, values, places, lengths):
    """Interpolate path lengths (num_envs,) linearly between the centres of squares; see `GoalPaths.path_length`."""
    for i in range(places.shape[0]):
        row, column, up, right = _within_grid(grids[i], places[i, 0], places[i, 1])
        columns = int(grids[i, 1])
        east, north = 1 if columns > 1 else 0, columns if grids[i, 0] > 1.0 else 0
        at = begins[i] + row * columns + column
        below = (1 - right) * values[at] + right * values[at + east]
        above = (1 - right) * values[at + north] + right * values[at + north + east]
        lengths[i] = (1 - up) * below + up * above


@njit(cache=True)
def _downhill(begin, grid, values, row, column, up, right):
    """Direction of the path at a point, interpolated linearly between the directions of the four squares around it.

    The direction of a square leads to its nearer neighbours, as in fast marching. In a valley between costly squares it
    leads along the valley, while the slope between the squares would oscillate across it.
    """
    rows, columns = int(grid[0]), int(grid[1])
    down_x, down_y = 0.0, 0.0
    for i in range(2):
        for j in range(2):
            share = (up if i else 1.0 - up) * (right if j else 1.0 - right)
            r, c = min(row + i, rows - 1), min(column + j, columns - 1)
            at = begin + r * columns + c
            here = values[at]
            west = values[at - 1] if c > 0 else np.inf
            east = values[at + 1] if c + 1 < columns else np.inf
            south = values[at - columns] if r > 0 else np.inf
            north = values[at + columns] if r + 1 < rows else np.inf
            x = max(here - min(west, east), 0.0)
            y = max(here - min(south, north), 0.0)
            length = math.sqrt(x * x + y * y)
            if length > 0.0:
                down_x += share * (x if east < west else -x) / length
                down_y += share * (y if north < south else -y) / length
    return down_x, down_y


@njit(cache=True)
def points_ahead(begins, grids, values, places, goals, lookahead, points):
    """Write the points ahead (num_envs, 2); see `GoalPaths.lookahead_point`."""
    for i in range(places.shape[0]):
        x, y, left = places[i, 0], places[i, 1], lookahead
        while left > 0.0:
            east, north = goals[i, 0] - x, goals[i, 1] - y
            straight = math.hypot(east, north)
            if straight < max(_NEAR, 1e-9):
                share = min(1.0, left / max(straight, 1e-9))
                x, y = x + share * east, y + share * north
                break
            row, column, up, right = _within_grid(grids[i], x, y)
            down_x, down_y = _downhill(begins[i], grids[i], values, row, column, up, right)
            slope = math.hypot(down_x, down_y)
            if not slope > 1e-6:
                break  # no path leads from here
            step = min(_STEP, left)
            x, y, left = x + step * down_x / slope, y + step * down_y / slope, left - step
        points[i, 0], points[i, 1] = x, y
