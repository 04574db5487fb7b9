"""`cells`: small posts on a grid, in clumps from a cellular automaton.

Posts, fill and smoothing are those of BARN (Perille et al. 2020, "Benchmarking Metric Ground Navigation"). As in BARN,
paths between the posts are cleared, because otherwise a fill of 0.3 would enclose a robot anywhere.
"""

from itertools import pairwise

import numpy as np

from tb2rl.worlds.generators.generated import MIN_PASSAGE, Shapes, Size, family

RADIUS, STEP = 0.075, 0.15  # [m] radius of posts, and distance between their centres
FILL = (0.15, 0.30)  # initial share of filled cells at difficulty 0 and 1
SMOOTHINGS = (2, 3, 4)  # possible numbers of smoothings
_BIRTH, _DEATH = 5, 1  # a cell is filled with at least 5 filled neighbours, and cleared with at most 1
_AREA_PER_PATH = 8.0  # [m^2] floor area per straight path that is cleared


@family
def cells(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """Posts after 2 to 4 smoothings, except posts with eight neighbours."""
    columns, rows = (int(length / STEP) for length in size)
    filled = rng.random((rows, columns)) < np.interp(difficulty, (0.0, 1.0), FILL)
    for _ in range(rng.choice(SMOOTHINGS)):
        neighbours = _neighbours(filled)
        filled = (filled & (neighbours > _DEATH)) | (neighbours >= _BIRTH)
    row, column = np.nonzero(filled & (_neighbours(filled) < 8))
    left, bottom = ((length - (count - 1) * STEP) / 2 for length, count in zip(size, (columns, rows), strict=True))
    posts = np.column_stack([left + STEP * column, bottom + STEP * row, np.full(len(row), RADIUS)])
    path_points = rng.uniform(0.0, size, (2 + round(size[0] * size[1] / _AREA_PER_PATH), 2))
    for begin, end in pairwise(path_points):
        segment, offsets = end - begin, posts[:, :2] - begin
        along = np.clip(offsets @ segment / (segment @ segment), 0.0, 1.0)
        distances = np.hypot(*(offsets - along[:, None] * segment).T)
        posts = posts[distances > RADIUS + MIN_PASSAGE * (2.0 - difficulty) / 2]
    return [], posts.tolist()


def _neighbours(filled: np.ndarray) -> np.ndarray:
    """Number of filled cells among the eight neighbours of each cell; cells outside the grid are free."""
    padded = np.pad(filled.astype(np.int8), 1)
    columns = padded[:-2] + padded[1:-1] + padded[2:]  # sums of three cells above each other
    return columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:] - filled
