"""Path lengths from the cells of a grid to a goal, by fast marching.

Sethian 1996, "A fast marching level set method for monotonically advancing fronts". Unlike a graph search over
neighbouring cells, fast marching does not prefer the axes of the grid.
"""

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import flood

_UNREACHABLE_COST = 3.0  # cost of cells without a path to the goal, which robots enter by rounding errors only
_BEYOND_AIM = 1.0  # [m] how far a march to an aim goes beyond it, so that all neighbours of a path have lengths
_BUCKETS_PER_CELL = 16  # of the queue; so few cells are visited twice, and few buckets are empty
_UNQUEUED, _LAST = 0, 1  # in place of the next cell in a bucket; these two cells are blocked, so they are never queued


@njit(cache=True, nogil=True)
def march(costs, row, column, cell_side):
    """Path length from all cells to the cell `row`, `column` [m], shape (rows, columns), float32.

    An unreachable cell gets the length of the nearest reachable cell, plus a cost for the distance, even if a
    cell farther away has a shorter path, because that cell may be behind a thin wall.

    Args:
        costs: See `tb2rl.worlds.goal_paths.path_costs`, shape (rows, columns).
        row, column: Cell of the goal.
        cell_side: Side of a cell [m].
    """
    steps, lengths, columns = _framed_steps(costs, cell_side), _framed_lengths(costs), costs.shape[1] + 2
    bucket_count, largest_step = 1, costs.max() * _BUCKETS_PER_CELL
    while bucket_count < largest_step + 2:
        bucket_count *= 2
    buckets = np.full(bucket_count, _LAST, dtype=np.uint32)
    next_cells = np.full(steps.size, _UNQUEUED, dtype=np.uint32)
    goal = _framed_cell(row, column, columns)
    _march_in_buckets(steps, lengths, buckets, next_cells, goal, columns, _BUCKETS_PER_CELL / cell_side)
    unframed = lengths.reshape((-1, columns))[2:-2, 1:-1]
    flood(unframed, np.ones(costs.shape, dtype=np.bool_), _UNREACHABLE_COST * cell_side)
    return unframed.astype(np.float32)


@njit(cache=True, nogil=True)
def _march_in_buckets(steps, lengths, buckets, next_cells, goal, columns, buckets_per_metre):
    """Write the lengths of all paths, with the queue of Dial 1969, "Algorithm 360", whose buckets are used in turn.

    The order of the cells in a bucket does not matter, because a cell is queued again if its path gets shorter.

    Args:
        steps, lengths: See `_framed_steps` and `_framed_lengths`.
        buckets: First cell of each bucket, or `_LAST`; their number is a power of 2.
        next_cells: The next cell in the same bucket, `_LAST` or `_UNQUEUED`, for each cell.
        goal, columns: Cell and number of columns, in the frame.
        buckets_per_metre: Of path length.
    """
    # All indices are unsigned, because numba tests whether signed ones are negative.
    one, width, last_bucket, bucket = np.uint64(1), np.uint64(columns), np.uint64(buckets.size - 1), np.uint64(0)
    lengths[goal], next_cells[goal], buckets[0], queued = 0.0, _LAST, goal, 1
    while queued:
        cell = np.uint64(buckets[bucket & last_bucket])
        if cell == _LAST:
            bucket += one
            continue
        buckets[bucket & last_bucket], next_cells[cell] = next_cells[cell], _UNQUEUED
        queued -= 1
        for neighbour in (cell + one, cell + width, cell - one, cell - width):
            length = _path_length(steps, lengths, neighbour, one, width)
            if length < lengths[neighbour]:
                lengths[neighbour] = length
                if next_cells[neighbour] == _UNQUEUED:
                    i = max(np.uint64(length * buckets_per_metre), bucket) & last_bucket
                    next_cells[neighbour], buckets[i] = buckets[i], neighbour
                    queued += 1


@njit(cache=True, nogil=True)
def march_to(costs, row, column, cell_side, aim):
    """Path length from the cells to the cell `row`, `column` [m], until the march has passed the cell `aim`.

    The march prefers cells in the direction of the aim, as A* does.

    Args:
        costs, row, column, cell_side: See `march`.
        aim: Row and column of a cell.

    Returns:
        Shape (rows, columns), float32; inf in cells that the march did not reach.
    """
    steps, lengths, columns = _framed_steps(costs, cell_side), _framed_lengths(costs), costs.shape[1] + 2
    goal, aim_cell = _framed_cell(row, column, columns), _framed_cell(aim[0], aim[1], columns)
    limit = np.inf
    steps[goal] = lengths[goal] = 0.0
    keys, cells = np.empty(4 * lengths.size), np.empty(4 * lengths.size, dtype=np.int64)  # a heap, by length to the aim
    size = _push(keys, cells, 0, 0.0, goal)
    while size:
        key, cell = keys[0], cells[0]
        size = _pop(keys, cells, size)
        if key > limit:
            break
        if steps[cell] == np.inf:
            continue  # a shorter path has been found since
        steps[cell] = np.inf  # a cell keeps its first length, because the march would be longer otherwise
        if cell == aim_cell:
            limit = key + _BEYOND_AIM
        for neighbour in (cell + 1, cell + columns, cell - 1, cell - columns):
            length = _path_length(steps, lengths, neighbour, 1, columns)
            if length < lengths[neighbour]:
                lengths[neighbour] = length
                to_aim = math.hypot(neighbour // columns - 2 - aim[0], neighbour % columns - 1 - aim[1])
                size = _push(keys, cells, size, length + cell_side * to_aim, neighbour)
    return lengths.reshape((-1, columns))[2:-2, 1:-1].astype(np.float32)


@njit(cache=True, nogil=True)
def _framed_steps(costs, cell_side):
    """Length of a path over each cell [m], inf in blocked cells and in the frame around them; flat.

    The frame has two rows below, two above, and a column at each side, because marches read the four neighbours of the
    cells of the inner frame, too.
    """
    rows, columns = costs.shape
    steps = np.full((rows + 4, columns + 2), np.inf)
    for i in range(rows):
        for j in range(columns):
            if costs[i, j] > 0.0:
                steps[i + 2, j + 1] = cell_side * costs[i, j]
    return steps.ravel()


@njit(cache=True, nogil=True)
def _framed_lengths(costs):
    """Path lengths before the march, which are inf; see `_framed_steps`."""
    return np.full((costs.shape[0] + 4) * (costs.shape[1] + 2), np.inf)


@njit(cache=True, nogil=True)
def _framed_cell(row, column, columns):
    """Index of a cell in `_framed_steps`, of which each row has so many columns."""
    return (row + 2) * columns + column + 1


@njit(cache=True, nogil=True)
def _path_length(steps, lengths, cell, one, width):
    """Path length from a cell [m], by the lengths from its four neighbours, of which at least one is finite.

    There is no branch for blocked cells, which get inf, because it would take longer than the square root.

    Args:
        steps, lengths, cell, width: Of a grid with a frame, see `_framed_steps`.
        one: The number 1, of the same type as `cell`.
    """
    step = steps[cell]
    in_row = min(lengths[cell - one], lengths[cell + one])
    in_column = min(lengths[cell - width], lengths[cell + width])
    difference = in_row - in_column
    diagonal = 0.5 * (in_row + in_column + math.sqrt(max(2.0 * step * step - difference * difference, 0.0)))
    return diagonal if abs(difference) < step else min(in_row, in_column) + step


@njit(cache=True, nogil=True)
def _push(keys, cells, size, key, cell):
    """Push a cell on a binary heap of `size` entries and return the new size; faster than `heapq` in numba."""
    position = size
    while position > 0 and keys[(position - 1) // 2] > key:
        keys[position], cells[position] = keys[(position - 1) // 2], cells[(position - 1) // 2]
        position = (position - 1) // 2
    keys[position], cells[position] = key, cell
    return size + 1


@njit(cache=True, nogil=True)
def _pop(keys, cells, size):
    """Remove the cell with the least key from the heap and return the new size."""
    size -= 1
    key, cell, position, child = keys[size], cells[size], 0, 1
    while child < size:
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[position], cells[position] = keys[child], cells[child]
        position, child = child, 2 * child + 1
    keys[position], cells[position] = key, cell
    return size
