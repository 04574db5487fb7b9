"""`cells`: small posts on a grid, in clumps that a cellular automaton grows.

Worlds as in BARN (Perille et al. 2020, "Benchmarking Metric Ground Navigation"), with its posts, fill and smoothing. As
there, paths are cleared between the posts, because a robot would be shut in anywhere with a fill of 0.3.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tb2rl.worlds.generators.enclosure import NARROW, Shapes, Size, solvable
from tb2rl.worlds.world import World

RADIUS, STEP = 0.075, 0.15  # [m] of a post, and from one to the next
FILL = (0.15, 0.30)  # of the grid is filled at first, at difficulty 0 and 1
SMOOTHINGS = (2, 3, 4)
_GROWS, _DIES = 5, 1  # least neighbours of a cell that is filled, most of one that is cleared
_AREA_PER_PATH = 8.0  # [m^2] of the floor for each straight path that is cleared


def cells(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """Posts after 2 to 4 smoothings, except those that others enclose on all sides."""
    return solvable(_draw, rng, difficulty, size)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    columns, rows = (int(length / STEP) for length in size)
    filled = rng.random((rows, columns)) < np.interp(difficulty, (0.0, 1.0), FILL)
    for _ in range(rng.choice(SMOOTHINGS)):
        around = _neighbours(filled)
        filled = (filled & (around > _DIES)) | (around >= _GROWS)
    row, column = np.nonzero(filled & (_neighbours(filled) < 8))
    left, bottom = ((length - (count - 1) * STEP) / 2 for length, count in zip(size, (columns, rows), strict=True))
    posts = np.column_stack([left + STEP * column, bottom + STEP * row, np.full(len(row), RADIUS)])
    bends = rng.uniform(0.0, size, (2 + round(size[0] * size[1] / _AREA_PER_PATH), 2))
    for one, other in pairwise(bends):
        posts = posts[_distances(posts[:, :2], one, other) > RADIUS + NARROW * (2.0 - difficulty) / 2]
    return [], posts.tolist()


def _distances(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances from points (n, 2) to the line segment between two others [m], shape (n,)."""
    segment = other - one
    along = np.clip((points - one) @ segment / (segment @ segment), 0.0, 1.0)
    return np.hypot(*(points - one - along[:, None] * segment).T)


def _neighbours(filled: np.ndarray) -> np.ndarray:
    """Number of filled cells among the eight neighbours of each cell; cells beyond the border are free."""
    around = np.pad(filled.astype(np.int8), 1)
    rows, columns = filled.shape
    shifted = [around[i : i + rows, j : j + columns] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return np.sum(shifted, axis=0)
