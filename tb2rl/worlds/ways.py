"""The ways from anywhere in a world to a goal: how far it is by way, and where the way leads next.

The floor is a grid of squares, see `tb2rl.worlds.floor`. How far each is from the goal is found by fast marching
(Sethian 1996, "A fast marching level set method for monotonically advancing fronts"), which unlike steps from square to
square knows every direction. A way near a wall counts as longer than it is, so that a way keeps off where it can.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.compiled import njit
from tb2rl.worlds.floor import SIDE, Floor
from tb2rl.worlds.world import World

GOALS = 4  # random ones in each world, beside its own
OWN = 0  # number of a world's own goal; random ones have the numbers from 1
KEEP_OFF = 0.5  # [m] from walls: a way nearer than that counts as longer
_DEARER = 3.0  # times, at a touch; farther away less, by the square
_BEYOND = 3.0  # times as long as it is, off all ways, where only rounding gets to
_SHORT = 0.5 * SIDE  # [m] of a step along a way
_NEAR = 2.5 * SIDE  # [m] from here on a way leads straight to the goal
_GOAL_ROOM = 0.3  # [m] between a random goal and what stands around it, where there is so much


class Ways:
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
        self._grids = np.zeros((len(worlds), 4))  # rows, columns, x and y of the first square's middle [m]
        self._floors: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._used, self._room = 0, np.empty(0, dtype=np.float32)

    def goals(self, worlds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Where goals are: x, y [m], shape (robots, 2), for worlds and numbers of shape (robots,)."""
        return self._goals[self._fields(worlds, numbers)]

    def to_go(self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray) -> np.ndarray:
        """How long the ways are from places x, y [m], shape (robots, 2) or more columns, to goals [m], (robots,)."""
        lengths, places = np.empty(len(places)), np.array(places)  # compiled once, for arrays of one kind
        fields = self._fields(worlds, numbers)
        _lengths(self._begins[fields], self._grids[worlds], self._room, places, lengths)
        return lengths

    def ahead(self, worlds: np.ndarray, numbers: np.ndarray, places: np.ndarray, reach: float) -> np.ndarray:
        """The points on the ways that are `reach` [m] ahead, or the goals if these are nearer, shape (robots, 2)."""
        fields, points, places = self._fields(worlds, numbers), np.empty((len(places), 2)), np.array(places)
        points_ahead(self._begins[fields], self._grids[worlds], self._room, places, self._goals[fields], reach, points)
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
        rows, columns, left, bottom = self._grids[world]
        row, column = _square(goal[1], bottom, rows), _square(goal[0], left, columns)
        self._room[self._used : needed] = _march(dear, row, column).ravel()
        self._begins[field], self._used = self._used, needed

    def _floor(self, world: int) -> tuple[np.ndarray, np.ndarray]:
        """How many times as long as it is each square's way counts, 0: no way; and x, y of those to have a goal in."""
        floor = Floor.of(self._worlds[world], KEEP_OFF)
        (left, bottom), clearance = floor.corner, floor.clearance
        self._grids[world] = *clearance.shape, left, bottom
        dear = _dear(clearance, self._radius)
        reached = floor.steps_from(*self._worlds[world].start[:2], self._radius) >= 0
        roomy = reached & (clearance >= _GOAL_ROOM)
        row, column = np.nonzero(roomy if roomy.any() else reached)
        return dear, np.column_stack([left + SIDE * column, bottom + SIDE * row])

    def _goal(self, world: int, number: int, squares: np.ndarray) -> tuple[float, float]:
        own = self._worlds[world].goal
        if number == OWN:
            return (math.nan, math.nan) if own is None else own[:2]
        x, y = squares[np.random.default_rng((world, number)).integers(len(squares))].tolist()
        return x, y


def march_from(clearance: np.ndarray, radius: float, goal: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """How far it is to a goal from all squares of a map, see `Ways`.

    Args:
        clearance: Of each square, at most `KEEP_OFF` [m], shape (rows, columns).
        radius: Of the robot [m].
        goal: x, y [m], shape (2,).
        grid: Rows, columns, x and y of the first square's middle [m], shape (4,).
    """
    rows, columns, left, bottom = grid
    x, y = goal.tolist()
    return _march(_dear(clearance, radius), _square(y, bottom, rows), _square(x, left, columns))


def _dear(clearance: np.ndarray, radius: float) -> np.ndarray:
    """How many times as long as it is the way over each square counts; 0: a robot with that radius [m] has none."""
    return np.where(clearance >= radius, 1.0 + (_DEARER - 1.0) * (1.0 - clearance / KEEP_OFF) ** 2, 0.0)


def shortest_way(world: World, radius: float) -> float:
    """The shortest way from a world's start to its goal for a robot with that radius [m]; inf: there is none.

    The grid makes it up to a twentieth too long: it keeps some centimetres off corners, and fast marching rounds up.
    """
    assert world.goal is not None
    floor = Floor.of(world, radius + SIDE)
    (left, bottom), (rows, columns) = floor.corner, floor.clearance.shape
    row, column = _square(world.goal[1], bottom, rows), _square(world.goal[0], left, columns)
    if floor.steps_from(*world.start[:2], radius)[row, column] < 0:
        return math.inf
    field = _march(np.where(floor.clearance >= radius, 1.0, 0.0), row, column)
    return float(field[_square(world.start[1], bottom, rows), _square(world.start[0], left, columns)])


def _square(at: float, first: float, count: float) -> int:
    """The row or column, of so many, in which a coordinate is, or the nearest one; NaN is in the first."""
    return 0 if math.isnan(at) else int(min(max(round((at - first) / SIDE), 0), count - 1))


@njit(cache=True, nogil=True)
def _march(dear, row, column):
    """How far it is to the square `row`, `column` [m] from all squares, shape (rows, columns), float32.

    Args:
        dear: How many times as long as it is a way over each square counts, 0: there is none, shape (rows, columns).
        row, column: Where the goal is.
    """
    rows, columns = dear.shape
    far = np.full((rows, columns), np.inf)
    far[row, column] = 0.0
    keys, cells, size = np.empty(8 * rows * columns), np.empty(8 * rows * columns, dtype=np.int64), 0
    size = _push(keys, cells, size, 0.0, row * columns + column)
    while size:
        i, j, key = cells[0] // columns, cells[0] % columns, keys[0]
        size = _pop(keys, cells, size)
        if key > far[i, j]:
            continue  # a shorter way was found since
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if not (0 <= r < rows and 0 <= c < columns) or dear[r, c] == 0.0:
                continue
            step = SIDE * dear[r, c]
            across = min(far[r, c - 1] if c > 0 else np.inf, far[r, c + 1] if c + 1 < columns else np.inf)
            along = min(far[r - 1, c] if r > 0 else np.inf, far[r + 1, c] if r + 1 < rows else np.inf)
            way = min(across, along) + step
            if abs(across - along) < step:
                way = 0.5 * (across + along + math.sqrt(2.0 * step * step - (across - along) ** 2))
            if way < far[r, c]:
                far[r, c] = way
                size = _push(keys, cells, size, way, r * columns + c)
    _go_on_beyond(far, cells)
    return far.astype(np.float32)


@njit(cache=True, nogil=True)
def _go_on_beyond(far, queue):
    """Let squares without a way be as far as the nearest one with a way, and `_BEYOND` times the way there.

    The nearest, and not the one that leads on best: else what is on the other side of a thin wall would count here.

    Args:
        far: Of each square [m], inf: without a way, shape (rows, columns).
        queue: Room for their numbers.
    """
    rows, columns = far.shape
    first, last = 0, 0
    for i in range(rows):
        for j in range(columns):
            if np.isfinite(far[i, j]):
                queue[last], last = i * columns + j, last + 1
    while first < last:
        i, j = queue[first] // columns, queue[first] % columns
        first += 1
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if 0 <= r < rows and 0 <= c < columns and not np.isfinite(far[r, c]):
                far[r, c] = far[i, j] + _BEYOND * SIDE
                queue[last], last = r * columns + c, last + 1


@njit(cache=True, nogil=True)
def _push(keys, cells, size, key, cell):
    """Put a cell on the heap of which `size` places are used; the new size."""
    at = size
    while at > 0 and keys[(at - 1) // 2] > key:
        keys[at], cells[at] = keys[(at - 1) // 2], cells[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at], cells[at] = key, cell
    return size + 1


@njit(cache=True, nogil=True)
def _pop(keys, cells, size):
    """Take the cell with the least key from the heap; the new size."""
    size -= 1
    key, cell, at = keys[size], cells[size], 0
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[at], cells[at] = keys[below], cells[below]
        at = below
    keys[at], cells[at] = key, cell
    return size


@njit(cache=True)
def _within_grid(grid, x, y):
    """The lower left of the four squares around a place, and how far between their middles it is, from 0 to 1."""
    across = min(max((x - grid[2]) / SIDE, 0.0), grid[1] - 1.0)
    along = min(max((y - grid[3]) / SIDE, 0.0), grid[0] - 1.0)
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
    """Write how long the ways are (robots,), between the squares' middles linearly; see `Ways.to_go`."""
    for i in range(places.shape[0]):
        row, column, up, right = _within_grid(grids[i], places[i, 0], places[i, 1])
        a, b, c, d = _corners(begins[i], grids[i], values, row, column)
        lengths[i] = (1 - up) * ((1 - right) * a + right * b) + up * ((1 - right) * c + right * d)


@njit(cache=True)
def points_ahead(begins, grids, values, places, goals, reach, points):
    """Write the points ahead (robots, 2), down the slope of how far it is; see `Ways.ahead`."""
    for i in range(places.shape[0]):
        x, y, left = places[i, 0], places[i, 1], reach
        while left > 0.0:
            east, north = goals[i, 0] - x, goals[i, 1] - y
            straight = math.hypot(east, north)
            if straight < max(_NEAR, 1e-9):
                share = min(1.0, left / max(straight, 1e-9))
                x, y = x + share * east, y + share * north
                break
            row, column, up, right = _within_grid(grids[i], x, y)
            a, b, c, d = _corners(begins[i], grids[i], values, row, column)
            down_x, down_y = (1 - up) * (a - b) + up * (c - d), (1 - right) * (a - c) + right * (b - d)
            slope = math.hypot(down_x, down_y)
            if not slope > 1e-6:
                break  # a place without a way
            step = min(_SHORT, left)
            x, y, left = x + step * down_x / slope, y + step * down_y / slope, left - step
        points[i, 0], points[i, 1] = x, y
