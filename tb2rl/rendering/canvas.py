"""A canvas for drawings of a world from above, in metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np
from PIL import Image, ImageDraw

from tb2rl.rendering.colours import FLOOR, WALL
from tb2rl.worlds import World

SIDE = 640  # [px] longer side of a drawing
_SUPERSAMPLING = 2  # drawn pixels for each side of a pixel, for smooth lines
_MARGIN = 0.3  # [m] margin around the world

Point = Sequence[float] | np.ndarray  # x, y [m], and optional numbers that are ignored
Points = Iterable[Point]


class Canvas:
    """A drawing of a world's walls, with x to the right, y up, and lengths in metres."""

    def __init__(self, world: World) -> None:
        x0, y0, x1, y1 = world.bounds
        self._left, self._top = x0 - _MARGIN, y1 + _MARGIN
        sides = np.array([x1 - x0, y1 - y0]) + 2 * _MARGIN
        self._scale = SIDE * _SUPERSAMPLING / sides.max()  # [px/m]
        # Even width and height, because video encoders need them.
        size = 2 * np.maximum(1, np.round(sides * self._scale / _SUPERSAMPLING / 2)).astype(int)
        self._image = Image.new("RGB", tuple((size * _SUPERSAMPLING).tolist()), FLOOR)
        self._draw = ImageDraw.Draw(self._image)
        for outline in world.outlines():
            self.polygon(outline.exterior.coords, WALL)

    def copy(self) -> Canvas:
        """A copy; drawing on it does not change the original."""
        duplicate = copy(self)
        duplicate._image = self._image.copy()
        duplicate._draw = ImageDraw.Draw(duplicate._image)
        return duplicate

    def line(self, points: Points, colour: str, width: float) -> None:
        """Draw a line, unless there are no points."""
        if pixels := self._pixels(points):
            self._draw.line(pixels, fill=colour, width=max(1, round(width * self._scale)), joint="curve")

    def polygon(self, points: Points, colour: str) -> None:
        self._draw.polygon(self._pixels(points), fill=colour)

    def disc(self, x: float, y: float, radius: float, colour: str | None, outline: str | None = None) -> None:
        """Draw a disc, or only its outline if `colour` is None."""
        corners = self._pixels([(x - radius, y + radius), (x + radius, y - radius)])
        self._draw.ellipse(corners, fill=colour, outline=outline, width=2 * _SUPERSAMPLING)

    def array(self) -> np.ndarray:
        """The drawing as a new array, shape (height, width, 3), uint8."""
        return np.array(self._image.reduce(_SUPERSAMPLING))

    def _pixels(self, points: Points) -> list[tuple[float, float]]:
        return [((p[0] - self._left) * self._scale, (self._top - p[1]) * self._scale) for p in points]
