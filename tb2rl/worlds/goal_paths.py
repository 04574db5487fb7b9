"""The ways from anywhere in a world to a goal: how far it is by way, and where the way leads next.

The floor is a grid of squares, see `tb2rl.worlds.floor`. How far each is from the goal is found by fast marching, see
`tb2rl.worlds.marching`. A way near a wall counts as longer than it is, so that a way keeps off where it can.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import MOST_SQUARES, SIDE, Floor
from tb2rl.worlds.marching import march
from tb2rl.worlds.world import World

GOALS = 4  # random ones in each world, beside its own
OWN = 0  # number of a world's own goal; random ones have the numbers from 1
KEEP_OFF = 0.35  # [m] between robot and walls: a way that comes nearer counts as longer
_TIGHT = 0.15  # [m] there it counts as about twice as long; beyond, by the square of the gap
_DEAREST = 20.0  # times as long: worth any detour, and no more, or the slope leads nowhere
_FINE = 0.05  # [m] of a square: those of 0.1 m cannot tell a gap in which the robot sticks from one of half a metre
_SHORT = 0.5 * _FINE  # [m] of a step along a way: longer ones cut corners
_NEAR = 0.25  # [m] from here on a way leads straight to the goal
_GOAL_ROOM = 0.3  # [m] between a random goal and what stands around it, where there is so much


class GoalPaths:
    """The ways to some goals in each of some worlds; those to a goal are found when they are first asked for.

    A goal is named by its world's index and its number there: `OWN`, or 1 to `GOALS` for random ones, which are the
    same in every process.

    Args:
        worlds: Which.
        radius: Of the robot [m].
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._goals = np.full((len(worlds) * (GOALS + 1), 2), np.nan)
        self._begins = np.full(len(self._goals), -1)  # where a field begins among the values; -1: not there yet
        self._grids = np.zeros((len(worlds), 5))  # rows, columns, x and y of the first square's middle, side [m]
        self._floors: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._used, self._room = 0, np.empty(0, dtype=np.float32)

    def goals(self, worlds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Where goals are: x, y [m], shape (num_envs, 2), for worlds and numbers of shape (num_envs,)."""
        return self._goals[self._fields(worlds, numbers)]

    def path_length(self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray) -> np.ndarray:
        """How long the ways are from places x, y [m], shape (num_envs, 2) or more columns, to goals [m],
        (num_envs,).
        """
        lengths, places = np.empty(len(places)), np.array(places)  # compiled once, for arrays of one kind
        fields = self._fields(worlds, numbers)
        _lengths(self._begins[fields], self._grids[worlds], self._room, places, lengths)
        return lengths

    def lookahead_point(
        self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray, lookahead: float
    ) -> np.ndarray:
        """The points on the ways that are `lookahead` [m] ahead, or the goals if these are nearer, shape (num_envs,
        2).
        """
        fields, points, places = self._fields(worlds, numbers), np.empty((len(places), 2)), np.array(places)
        points_ahead(
            self._begins[fields], self._grids[worlds], self._room, places, self._goals[fields], lookahead, points
        )
        return points

    def _fields(self, worlds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        fields = worlds * (GOALS + 1) + numbers
        missing = self._begins[fields] < 0
        if missing.any():
            for field in np.unique(fields[missing]).tolist():
                self._add(field, *divmod(field, GOALS + 1))
        return fields

    def _add(self, field: int, world: int, number: int) -> None:
        """Find the ways to a goal; the table grows by half, so that it is seldom copied."""
        if world not in self._floors:
            self._floors[world] = self._floor(world)
        dear, reachable = self._floors[world]
        self._goals[field] = goal = self._goal(world, number, reachable)
        needed = self._used + dear.size
        if needed > len(self._room):
            grown = np.empty(needed + needed // 2, dtype=np.float32)
            grown[: self._used] = self._room[: self._used]
            self._room = grown
        self._room[self._used : needed] = _march_to(goal, dear, self._grids[world]).ravel()
        self._begins[field], self._used = self._used, needed

    def _floor(self, world: int) -> tuple[np.ndarray, np.ndarray]:
        """How many times as long as it is each square's way counts, 0: no way; and x, y of those to have a goal in."""
        x0, y0, x1, y1 = self._worlds[world].bounds
        side = _FINE if (x1 - x0) * (y1 - y0) <= MOST_SQUARES * _FINE**2 else SIDE
        floor = Floor.of(self._worlds[world], self._radius + KEEP_OFF, side)
        (left, bottom), clearance = floor.corner, floor.clearance
        self._grids[world] = *clearance.shape, left, bottom, side
        dear = _dear(clearance, self._radius)
        reached = floor.steps_from(*self._worlds[world].start[:2], self._radius) >= 0
        roomy = reached & (clearance >= _GOAL_ROOM)
        row, column = np.nonzero(roomy if roomy.any() else reached)
        return dear, np.column_stack([left + side * column, bottom + side * row])

    def _goal(self, world: int, number: int, squares: np.ndarray) -> tuple[float, float]:
        own = self._worlds[world].goal
        if number == OWN:
            return (math.nan, math.nan) if own is None else own[:2]
        x, y = squares[np.random.default_rng((world, number)).integers(len(squares))].tolist()
        return x, y


def march_from(clearance: np.ndarray, radius: float, goal: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """How far it is to a goal from all squares of a map, see `GoalPaths`.

    Args:
        clearance: Of each square, at most `KEEP_OFF` more than the radius [m], shape (rows, columns).
        radius: Of the robot [m].
        goal: x, y [m], shape (2,).
        grid: Rows, columns, x and y of the first square's middle, side of a square [m], shape (5,).
    """
    return _march_to(goal.tolist(), _dear(clearance, radius), grid)


def _march_to(goal: Sequence[float], dear: np.ndarray, grid: np.ndarray) -> np.ndarray:
    rows, columns, left, bottom, side = grid.tolist()
    return march(dear, _square(goal[1], bottom, side, rows), _square(goal[0], left, side, columns), side)


def _dear(clearance: np.ndarray, radius: float) -> np.ndarray:
    """How many times as long as it is the way over each square counts; 0: a robot with that radius [m] has none."""
    gap = np.maximum(clearance - radius, 1e-3)
    longer = 1.0 + (_TIGHT / gap) ** 2 - (_TIGHT / KEEP_OFF) ** 2
    return np.where(clearance >= radius, np.minimum(longer, _DEAREST), 0.0)


def shortest_way(world: World, radius: float) -> float:
    """The shortest way from a world's start to its goal for a robot with that radius [m]; inf: there is none.

    The grid makes it up to a twentieth too long: it keeps some centimetres off corners, and fast marching rounds up.
    """
    assert world.goal is not None
    floor = Floor.of(world, radius + SIDE)
    (left, bottom), (rows, columns) = floor.corner, floor.clearance.shape
    row, column = _square(world.goal[1], bottom, SIDE, rows), _square(world.goal[0], left, SIDE, columns)
    if floor.steps_from(*world.start[:2], radius)[row, column] < 0:
        return math.inf
    field = march(np.where(floor.clearance >= radius, 1.0, 0.0), row, column, SIDE)
    return float(field[_square(world.start[1], bottom, SIDE, rows), _square(world.start[0], left, SIDE, columns)])


def _square(at: float, first: float, side: float, count: float) -> int:
    """The row or column, of so many, in which a coordinate is, or the nearest one; NaN is in the first."""
    return 0 if math.isnan(at) else int(min(max(round((at - first) / side), 0), count - 1))


@njit(cache=True)
def _within_grid(grid, x, y):
    """The lower left of the four squares around a place, and how far between their middles it is, from 0 to 1."""
    across = min(max((x - grid[2]) / grid[4], 0.0), grid[1] - 1.0)
    along = min(max((y - grid[3]) / grid[4], 0.0), grid[0] - 1.0)
    column, row = min(int(across), max(int(grid[1]) - 2, 0)), min(int(along), max(int(grid[0]) - 2, 0))
    return row, column, along - row, across - column


@njit(cache=True)
def _corners(begin, grid, values, row, column):
    """How far it is from the four squares around a place: lower left, lower right, upper left, upper right [m]."""
    columns = int(grid[1])
    right = 1 if columns > 1 else 0
    up = columns if grid[0] > 1.0 else 0
    at = begin + row * columns + column
    return values[at], values[at + right], values[at + up], values[at + up + right]


@njit(cache=True)
def _lengths(begins, grids, values, places, lengths):
    """Write how long the ways are (num_envs,), between the squares' middles linearly; see `GoalPaths.path_length`."""
    for i in range(places.shape[0]):
        row, column, up, right = _within_grid(grids[i], places[i, 0], places[i, 1])
        a, b, c, d = _corners(begins[i], grids[i], values, row, column)
        lengths[i] = (1 - up) * ((1 - right) * a + right * b) + up * ((1 - right) * c + right * d)


@njit(cache=True)
def _downhill(begin, grid, values, row, column, up, right):
    """Where it gets nearer around a place: between the four squares' own directions linearly.

    A square's own is towards its nearer neighbours, as marching found them: in a valley between dear squares it leads
    along, where the slope between the squares leads from one side to the other and back.
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
    """Write the points ahead (num_envs, 2), downhill in how far it is; see `GoalPaths.ahead`."""
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
                break  # a place without a way
            step = min(_SHORT, left)
            x, y, left = x + step * down_x / slope, y + step * down_y / slope, left - step
        points[i, 0], points[i, 1] = x, y
