"""Plans of worlds: walls, where a robot can get to, its start and the goal; and many of them on one sheet."""

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

_TILE = 320  # [px] side of a plan on a sheet of many
_TITLE = 18  # [px] height of a plan's name


def draw_plan(world: World, robot: Robot) -> np.ndarray:
    """A world from above, with the robot at the start, all that its middle can get to, and the paths of movers.

    Returns:
        Shape (height, width, 3), uint8.

    Raises:
        InputError: If there is no room for the robot at the start.
    """
    canvas = Canvas(world)
    # Triangles, because what can be reached has holes.
    for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(world.free_space(robot.radius))):
        canvas.polygon(triangle.exterior.coords, FREE)
    draw_routes(canvas, world.dynamic_obstacles)
    draw_goal(canvas, None if world.goal is None else world.goal[:2])
    draw_robot(canvas, robot, *world.start)
    return canvas.array()


def sheet(plans: Sequence[np.ndarray], titles: Sequence[str], columns: int | None = None) -> np.ndarray:
    """Pictures side by side, each with its title; one alone keeps its size, and has none.

    Args:
        plans: Each of shape (height, width, 3), uint8.
        titles: What stands below each.
        columns: How many in a row; None: about as many as rows.

    Returns:
        Shape (height, width, 3), uint8.
    """
    if len(plans) == 1:
        return plans[0]
    columns = columns or math.ceil(math.sqrt(len(plans)))
    size = columns * _TILE, math.ceil(len(plans) / columns) * (_TILE + _TITLE)
    picture = Image.new("RGB", size, STRIP)
    pen = ImageDraw.Draw(picture)
    for number, (plan, title) in enumerate(zip(plans, titles, strict=True)):
        left, top = number % columns * _TILE, number // columns * (_TILE + _TITLE)
        tile = Image.fromarray(plan)
        tile.thumbnail((_TILE - 8, _TILE - 8))
        picture.paste(tile, (left + (_TILE - tile.width) // 2, top + (_TILE - tile.height) // 2))
        pen.text((left + _TILE // 2, top + _TILE), title, LABEL, anchor="mt")
    return np.array(picture)
