"""A world to draw, and colours to look for in pictures of it."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.worlds import World

SQUARE = World.from_shapes(
    "square", boxes=[(1.0, 0.5, 1.0, 0.5, 0.0)], posts=[(-1.0, -1.0, 0.3)], start=(0, 0, 0), bounds=(-2, -2, 2, 2)
)
MARGIN = 0.3  # [m] around the world


class _Look:
    """A picture, indexed by the coordinates of its world."""

    def __init__(self, world: World, picture: np.ndarray) -> None:
        self.picture = picture.astype(int)
        self.left, self.top = world.bounds[0] - MARGIN, world.bounds[3] + MARGIN
        self.scale = picture.shape[1] / (world.bounds[2] + MARGIN - self.left)  # [px/m]

    def at(self, x: float, y: float) -> np.ndarray:
        """The colour at a point [m], shape (3,)."""
        return self.picture[int((self.top - y) * self.scale), int((x - self.left) * self.scale)]

    def is_at(self, colour: str, x: float, y: float) -> bool:
        """Whether a point has the colour, up to the smoothing of edges."""
        return bool(np.abs(self.at(x, y) - ImageColor.getrgb(colour)).max() < 12)

    def points(self, colour: str) -> np.ndarray:
        """x, y of all pixels that have the colour [m], shape (pixels, 2)."""
        rows, columns = np.nonzero(np.abs(self.picture - ImageColor.getrgb(colour)).max(axis=2) < 12)
        return np.column_stack([(columns + 0.5) / self.scale + self.left, self.top - (rows + 0.5) / self.scale])


@pytest.fixture
def square() -> World:
    """A square world with a box at the upper right and a post at the lower left."""
    return SQUARE


@pytest.fixture
def look_at():
    """A function that makes a `_Look` of a world and a picture."""
    return _Look
