"""Path lengths between cells, and lookahead points along paths, in compiled code for many environments.

Arguments in common: `grids` has a row for each environment, the `grid` of `tb2rl.worlds.goal_paths.path_lengths_to`;
shape (num_envs, 5). `lengths_of_cells` (cells,), float32, has the path lengths in the cells of all grids [m]; those of
an environment begin at its offset (num_envs,), in the order of the cells of its grid. `positions` has x, y [m] in the
first two columns, such as poses.

A lookahead point is the end of a walk of short steps, each of which waits for the memory, a root and divisions of the
step before. The walks of several robots therefore advance together: while one waits, the processor computes others.
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.threads import parallel_if_long

_PATH_STEP = 0.05  # [m] a fine cell; 1 % of the points 1.5 m ahead are 1 cm or more from those of a quarter of the step
_MAX_TURN = 0.3  # [rad] of a path in a step, if it is no kink
_STRAIGHT_RADIUS = 0.25  # [m] distance from the goal below which paths are straight
_LENGTH_TIME, _STEP_TIME = 0.1e-6, 30e-9  # [s] estimated duration for a robot: of its path length, of a step of a walk
_COUNT = 32  # robots that advance together; 16 to 128 are about as fast
# The cells around a point, from which the directions in the four nearest, numbers 3, 4, 7 and 8, are computed: rows and
# columns counted from one below and one to the left of number 3.
_CELL_ROWS = (0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3)
_CELL_COLUMNS = (1, 2, 0, 1, 2, 3, 0, 1, 2, 3, 1, 2)
_VALUES = (
    "rows", "columns", "left", "bottom", "cell_side",  # the grid
    "goal_x", "goal_y", "x", "y", "remaining",  # [m] goal, position, and remaining length of the walk
    "row", "column", "up", "right",  # see `_grid_position`
    "path_x", "path_y", "norm",  # direction of the path, and length of this vector
    "last_x", "last_y",  # unit vector of the direction at the step before; 0 at the first
)  # fmt: skip
# Values of `_COUNT` robots in one record. The compiler vectorises no loop over separate arrays, as they might overlap.
_WALKS = np.dtype([(name, "f8", _COUNT) for name in _VALUES] + [("lengths", "f8", (len(_CELL_ROWS), _COUNT))])


def path_lengths(
    offsets: np.ndarray, grids: np.ndarray, lengths_of_cells: np.ndarray, positions: np.ndarray
) -> np.ndarray:
    """Path lengths [m], interpolated linearly between cell centres, shape (num_envs,)."""
    lengths = np.empty(len(positions))
    arguments = offsets, grids, lengths_of_cells, positions, lengths
    parallel_if_long(_interpolate, len(positions), _LENGTH_TIME, *arguments)
    return lengths


def lookahead_points(
    offsets: np.ndarray,
    grids: np.ndarray,
    lengths_of_cells: np.ndarray,
    positions: np.ndarray,
    goals: np.ndarray,
    lookahead: float,
) -> np.ndarray:
    """Points `lookahead` [m] ahead on the paths, or the goals (num_envs, 2) if they are nearer, shape (num_envs, 2)."""
    points = np.empty((len(positions), 2))
    arguments = offsets, grids, lengths_of_cells, positions, goals, float(lookahead), points
    parallel_if_long(_walk_all, len(positions), _STEP_TIME * (1.0 + lookahead / _PATH_STEP), *arguments)
    return points


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _grid_position(rows, columns, left, bottom, cell_side, x, y):
    """Row and column of the lower left of the four cells around a point, and the position of the point between them.

    The position has two parts, up and right, each from 0 at the centre of the lower left cell to 1 at the next centre.
    All numbers are floats, for vectorised loops; the first five are the grid.
    """
    column_position = min(max((x - left) / cell_side, 0.0), columns - 1.0)
    row_position = min(max((y - bottom) / cell_side, 0.0), rows - 1.0)
    column = min(np.floor(column_position), max(columns - 2.0, 0.0))
    row = min(np.floor(row_position), max(rows - 2.0, 0.0))
    return row, column, row_position - row, column_position - column


@njit(cache=True, nogil=True, **NO_REFCOUNT, error_model="numpy")
def _interpolate(first, end, offsets, grids, lengths_of_cells, positions, lengths):
    """Write `path_lengths` of the environments `first` to `end` - 1."""
    for i in range(first, end):
        grid = grids[i, 0], grids[i, 1], grids[i, 2], grids[i, 3], grids[i, 4]
        row, column, up, right = _grid_position(*grid, positions[i, 0], positions[i, 1])
        columns = int(grids[i, 1])
        to_right, to_above = 1 if columns > 1 else 0, columns if grids[i, 0] > 1.0 else 0
        cell = offsets[i] + int(row) * columns + int(column)
        below = (1 - right) * lengths_of_cells[cell] + right * lengths_of_cells[cell + to_right]
        above = (1 - right) * lengths_of_cells[cell + to_above] + right * lengths_of_cells[cell + to_above + to_right]
        lengths[i] = (1 - up) * below + up * above


@njit(cache=True, nogil=True, error_model="numpy")
def _walk_all(first, end, offsets, grids, lengths_of_cells, positions, goals, lookahead, points):
    """Write `lookahead_points` of the environments `first` to `end` - 1."""
    walks = np.empty(1, _WALKS)
    for start in range(first, end, _COUNT):
        count = min(_COUNT, end - start)
        _walk(start, count, offsets, grids, lengths_of_cells, positions, goals, lookahead, points, walks)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _walk(start, count, offsets, grids, lengths_of_cells, positions, goals, lookahead, points, all_walks):
    """Write `lookahead_points` of up to `_COUNT` environments from `start` on; `all_walks` is memory for the walks."""
    walks = all_walks[0]
    for k in range(count):
        i = start + k
        walks.rows[k], walks.columns[k], walks.cell_side[k] = grids[i, 0], grids[i, 1], grids[i, 4]
        walks.left[k], walks.bottom[k] = grids[i, 2], grids[i, 3]
        walks.goal_x[k], walks.goal_y[k] = goals[i, 0], goals[i, 1]
        walks.x[k], walks.y[k], walks.remaining[k] = positions[i, 0], positions[i, 1], lookahead
        walks.last_x[k], walks.last_y[k] = 0.0, 0.0
    is_moving = lookahead > 0.0
    while is_moving:
        _find_cells(count, walks)
        for k in range(count):
            if walks.remaining[k] > 0.0:
                _load_lengths(k, offsets[start + k], lengths_of_cells, walks)
        _find_directions(count, walks)
        _arrive(count, walks)
        is_moving = _advance(count, walks)
    for k in range(count):
        points[start + k, 0], points[start + k, 1] = walks.x[k], walks.y[k]


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _find_cells(count, walks):
    """Find the cells around the positions of the walks; see `_grid_position`."""
    for k in range(count):
        grid = walks.rows[k], walks.columns[k], walks.left[k], walks.bottom[k], walks.cell_side[k]
        row, column, up, right = _grid_position(*grid, walks.x[k], walks.y[k])
        walks.row[k], walks.column[k], walks.up[k], walks.right[k] = row, column, up, right


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _load_lengths(k, offset, lengths_of_cells, walks):
    """Load the path lengths of the 12 cells around the position of walk `k`; inf outside of the grid."""
    rows, columns = int(walks.rows[k]), int(walks.columns[k])
    first_row, first_column = int(walks.row[k]) - 1, int(walks.column[k]) - 1
    first = offset + first_row * columns + first_column
    if first_row >= 0 and first_row + 3 < rows and first_column >= 0 and first_column + 3 < columns:  # nearly always
        for number in range(12):  # unsigned, so that no index is tested for being negative
            index = (
                np.uint64(first) + np.uint64(_CELL_ROWS[number]) * np.uint64(columns) + np.uint64(_CELL_COLUMNS[number])
            )
            walks.lengths[number, k] = lengths_of_cells[index]
        return
    for number in range(12):
        row, column = first_row + _CELL_ROWS[number], first_column + _CELL_COLUMNS[number]
        is_inside = 0 <= row < rows and 0 <= column < columns
        walks.lengths[number, k] = lengths_of_cells[offset + row * columns + column] if is_inside else np.inf


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _find_directions(count, walks):
    """Find the directions of paths, interpolated linearly between the directions in the four nearest cells.

    The gradient of the interpolated lengths would oscillate in a narrow passage between costly cells.
    """
    for k in range(count):
        up, right, lengths = walks.up[k], walks.right[k], walks.lengths
        x0, y0 = _direction_in(lengths, k, 3, 0, 7, (1.0 - up) * (1.0 - right))
        x1, y1 = _direction_in(lengths, k, 4, 1, 8, (1.0 - up) * right)
        x2, y2 = _direction_in(lengths, k, 7, 3, 10, up * (1.0 - right))
        x3, y3 = _direction_in(lengths, k, 8, 4, 11, up * right)
        path_x, path_y = x0 + x1 + x2 + x3, y0 + y1 + y2 + y3
        walks.path_x[k], walks.path_y[k], walks.norm[k] = path_x, path_y, math.sqrt(path_x * path_x + path_y * path_y)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _direction_in(lengths, k, cell, below, above, weight):
    """Direction of the path in a cell, times `weight`; cells have the numbers of `_CELL_ROWS`.

    This is the gradient towards its neighbours with shorter paths, as in fast marching; 0 in a cell that a march to an
    aim did not reach.
    """
    here, at_left, at_right = lengths[cell, k], lengths[cell - 1, k], lengths[cell + 1, k]
    x = max(here - min(at_left, at_right), 0.0)
    y = max(here - min(lengths[below, k], lengths[above, k]), 0.0)
    norm = math.sqrt(x * x + y * y)
    scale = weight / norm  # because a division takes as long as ten multiplications
    path_x, path_y = (
        scale * (x if at_right < at_left else -x),
        scale * (y if lengths[above, k] < lengths[below, k] else -y),
    )
    has_direction = (norm > 0.0) & (here < np.inf)  # otherwise, the results above may be NaN
    return path_x if has_direction else 0.0, path_y if has_direction else 0.0


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _arrive(count, walks):
    """End the walks that are so near their goal that the rest of the path is straight."""
    num_near = 0
    for k in range(count):  # saves most calls of `hypot`
        num_near += abs(walks.goal_x[k] - walks.x[k]) < _STRAIGHT_RADIUS
    if num_near == 0:
        return
    for k in range(count):
        x, y, remaining = walks.x[k], walks.y[k], walks.remaining[k]
        goal_dx, goal_dy = walks.goal_x[k] - x, walks.goal_y[k] - y
        if remaining > 0.0 and abs(goal_dx) < _STRAIGHT_RADIUS and abs(goal_dy) < _STRAIGHT_RADIUS:
            goal_distance = math.hypot(goal_dx, goal_dy)
            if goal_distance < _STRAIGHT_RADIUS:
                share = min(1.0, remaining / max(goal_distance, 1e-9))
                walks.x[k], walks.y[k], walks.remaining[k] = x + share * goal_dx, y + share * goal_dy, 0.0


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _advance(count, walks):
    """Advance the walks by a step, and return whether any of them continues.

    The method is that of Adams and Bashforth of second order, or Euler's at the first step and at a kink of the path.
    """
    num_moving = 0
    for k in range(count):
        x, y, remaining, norm = walks.x[k], walks.y[k], walks.remaining[k], walks.norm[k]
        step = min(_PATH_STEP, remaining)
        unit_x, unit_y = walks.path_x[k] / norm, walks.path_y[k] / norm
        turn_x, turn_y = unit_x - walks.last_x[k], unit_y - walks.last_y[k]  # since the last step
        share = 0.5 if turn_x * turn_x + turn_y * turn_y < _MAX_TURN * _MAX_TURN else 0.0
        next_x, next_y = x + step * (unit_x + share * turn_x), y + step * (unit_y + share * turn_y)
        walks.last_x[k], walks.last_y[k] = unit_x, unit_y
        is_moving = (remaining > 0.0) & (norm > 1e-6)  # otherwise, no neighbouring cell is nearer to the goal
        walks.x[k], walks.y[k] = next_x if is_moving else x, next_y if is_moving else y
        walks.remaining[k] = remaining - step if is_moving else 0.0
        num_moving += walks.remaining[k] > 0.0
    return num_moving > 0
