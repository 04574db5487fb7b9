"""A drawing in metres: lines, polygons and discs over the walls of a world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np
from PIL import Image, ImageDraw

from tb2rl.rendering.colours import FLOOR, WALL
from tb2rl.worlds.world import World, box_polygons

SIDE = 640  # [px] of the longer side
_SUPERSAMPLING = 2  # against jagged lines
_MARGIN = 0.3  # [m] around the world

Points = Iterable[Sequence[float] | np.ndarray]


class Canvas:
    """A drawing of a world's walls: x to the right, y up, all lengths in metres."""

    def __init__(self, world: World) -> None:
        x0, y0, x1, y1 = world.bounds
        self._left, self._top = x0 - _MARGIN, y1 + _MARGIN
        width, height = x1 - x0 + 2 * _MARGIN, y1 - y0 + 2 * _MARGIN
        self._scale = SIDE * _SUPERSAMPLING / max(width, height)  # [px/m]
        # Video encoders need even sides.
        columns, rows = (2 * max(1, round(side * self._scale / _SUPERSAMPLING / 2)) for side in (width, height))
        self._image = Image.new("RGB", (columns * _SUPERSAMPLING, rows * _SUPERSAMPLING), FLOOR)
        self._draw = ImageDraw.Draw(self._image)
        for box in box_polygons(world.boxes):
            self.polygon(box.exterior.coords, WALL)
        for x, y, radius in world.posts:
            self.disc(x, y, radius, WALL)

    def copy(self) -> Canvas:
        """A copy that can be drawn on without changing the original."""
        duplicate = copy(self)
        duplicate._image = self._image.copy()
        duplicate._draw = ImageDraw.Draw(duplicate._image)
        return duplicate

    def line(self, points: Points, colour: str, width: float) -> None:
        self._draw.line(self._pixels(points), fill=colour, width=max(1, round(width * self._scale)), joint="curve")

    def polygon(self, points: Points, colour: str) -> None:
        self._draw.polygon(self._pixels(points), fill=colour)

    def disc(self, x: float, y: float, radius: float, colour: str | None, outline: str | None = None) -> None:
        """Draw a disc; without `colour` only its outline."""
        (left, top), (right, bottom) = self._pixels([(x - radius, y + radius), (x + radius, y - radius)])
        self._draw.ellipse((left, top, right, bottom), fill=colour, outline=outline, width=2 * _SUPERSAMPLING)

    def array(self) -> np.ndarray:
        """A writable copy of the picture, shape (height, width, 3), uint8."""
        return np.array(self._image.reduce(_SUPERSAMPLING))

    def _pixels(self, points: Points) -> list[tuple[float, float]]:
        return [((p[0] - self._left) * self._scale, (self._top - p[1]) * self._scale) for p in points]
