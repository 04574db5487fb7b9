"""Plans of worlds: walls, reachable space, start, goal and routes of dynamic obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from PIL import Image, ImageDraw

from tb2rl.rendering.above import draw_goal, draw_robot, draw_routes
from tb2rl.rendering.canvas import Canvas
from tb2rl.rendering.colours import FREE, LABEL, STRIP
from tb2rl.robots import Robot
from tb2rl.worlds import World

_TILE = 320  # [px] side of a picture in a grid
_TITLE = 18  # [px] height of its title


def draw_plan(world: World, robot: Robot) -> np.ndarray:
    """Draw a world from above, with the robot at the start and all that its centre can reach.

    Returns:
        Shape (height, width, 3), uint8.

    Raises:
        InputError: If the robot does not fit at the start.
    """
    canvas = Canvas(world)
    # Triangles, because the reachable space has holes.
    for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(world.free_space(robot.radius))):
        canvas.polygon(triangle.exterior.coords, FREE)
    draw_routes(canvas, world.dynamic_obstacles)
    draw_goal(canvas, None if world.goal is None else world.goal[:2])
    draw_robot(canvas, robot, *world.start)
    return canvas.array()


def make_grid(pictures: Sequence[np.ndarray], titles: Sequence[str], columns: int | None = None) -> np.ndarray:
    """Arrange pictures (height, width, 3) in a grid, each above its title; a single picture is returned unchanged."""
    if len(pictures) == 1:
        return pictures[0]
    columns = columns or math.ceil(math.sqrt(len(pictures)))
    size = columns * _TILE, math.ceil(len(pictures) / columns) * (_TILE + _TITLE)
    grid = Image.new("RGB", size, STRIP)
    draw = ImageDraw.Draw(grid)
    for i, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        left, top = i % columns * _TILE, i // columns * (_TILE + _TITLE)
        tile = Image.fromarray(picture)
        tile.thumbnail((_TILE - 8, _TILE - 8))
        grid.paste(tile, (left + (_TILE - tile.width) // 2, top + (_TILE - tile.height) // 2))
        draw.text((left + _TILE // 2, top + _TILE), title, LABEL, anchor="mt")
    return np.array(grid)
