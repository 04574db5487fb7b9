"""Drawings are in metres: x to the right, y up."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.rendering.canvas import SIDE, Canvas
from tb2rl.rendering.colours import FLOOR, WALL
from tb2rl.worlds import World


def test_walls_are_at_their_positions(square, look_at):
    picture = Canvas(square).array()
    assert (picture.shape, picture.dtype) == ((SIDE, SIDE, 3), np.uint8)
    look = look_at(square, picture)
    for x, y in [(1.0, 0.5), (0.55, 0.3), (1.45, 0.7), (-1.0, -1.0), (-1.25, -1.0), (-1.0, -0.75)]:
        assert look.is_at(WALL, x, y), (x, y)
    for x, y in [(0.45, 0.5), (1.0, 0.8), (1.0, -0.5), (-1.0, 1.0), (-1.25, -0.75), (0.0, 0.0), (-2.2, 2.2)]:
        assert look.is_at(FLOOR, x, y), (x, y)
    x0, y0 = look.points(WALL).min(axis=0)
    assert (x0, y0) == pytest.approx((-1.3, -1.3), abs=0.02)


@pytest.mark.parametrize(("width", "height"), [(4.0, 1.0), (3.3, 2.7), (0.9, 100.0)])
def test_sides_are_even_and_the_longer_side_is_fixed(width, height):
    world = World.from_shapes("any", start=(0, 0, 0), bounds=(0.0, 0.0, width, height))
    rows, columns, _ = Canvas(world).array().shape
    assert (rows % 2, columns % 2) == (0, 0)
    assert max(rows, columns) == SIDE
    assert rows / columns == pytest.approx((height + 0.6) / (width + 0.6), rel=0.1)
