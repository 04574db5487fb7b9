"""A picture in metres, drawn without a window: lines, polygons and discs over the walls of a world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np
from PIL import Image, ImageDraw

from tb2rl.rendering.colours import FLOOR, WALL
from tb2rl.worlds.world import World, box_polygons

SIDE = 640  # [px] of the longer side
_SMOOTH = 2  # drawn larger and shrunk, against jagged lines
_MARGIN = 0.3  # [m] around the world

Points = Iterable[Sequence[float] | np.ndarray]


class Canvas:
    """A picture of a world's walls to draw on: x to the right, y up, all lengths in metres."""

    def __init__(self, world: World) -> None:
        x0, y0, x1, y1 = world.bounds
        self._left, self._top = x0 - _MARGIN, y1 + _MARGIN
        width, height = x1 - x0 + 2 * _MARGIN, y1 - y0 + 2 * _MARGIN
        self._scale = SIDE * _SMOOTH / max(width, height)  # [px/m]
        self._size = _even(width * self._scale / _SMOOTH), _even(height * self._scale / _SMOOTH)
        self._image = Image.new("RGB", (self._size[0] * _SMOOTH, self._size[1] * _SMOOTH), FLOOR)
        self._draw = ImageDraw.Draw(self._image)
        for box in box_polygons(world.boxes):
            self.polygon(box.exterior.coords, WALL)
        for x, y, radius in world.posts:
            self.disc(x, y, radius, WALL)

    def copy(self) -> Canvas:
        """The same picture, to draw more on than on the original."""
        twin = copy(self)
        twin._image = self._image.copy()
        twin._draw = ImageDraw.Draw(twin._image)
        return twin

    def line(self, points: Points, colour: str, width: float) -> None:
        """A line through points, `width` wide."""
        self._draw.line(self._pixels(points), fill=colour, width=max(1, round(width * self._scale)), joint="curve")

    def polygon(self, points: Points, colour: str) -> None:
        """A filled polygon."""
        self._draw.polygon(self._pixels(points), fill=colour)

    def disc(self, x: float, y: float, radius: float, colour: str | None, outline: str | None = None) -> None:
        """A disc; without `colour` only its outline."""
        (left, top), (right, bottom) = self._pixels([(x - radius, y + radius), (x + radius, y - radius)])
        self._draw.ellipse((left, top, right, bottom), fill=colour, outline=outline, width=2 * _SMOOTH)

    def array(self) -> np.ndarray:
        """The finished picture, shape (height, width, 3), uint8, to be drawn on by whoever wants to."""
        return np.array(self._image.reduce(_SMOOTH))

    def _pixels(self, points: Points) -> list[tuple[float, float]]:
        return [((p[0] - self._left) * self._scale, (self._top - p[1]) * self._scale) for p in points]


def _even(pixels: float) -> int:
    """The nearest even number: what video encoders want of a side."""
    return 2 * max(1, round(pixels / 2))
