"""Changed copies of a world: walls and posts that a user adds or removes."""

from dataclasses import replace

import numpy as np
import shapely

from tb2rl.core.errors import InputError
from tb2rl.core.values import Point
from tb2rl.worlds.description import wall_box
from tb2rl.worlds.world import WALL_HEIGHT, World

_WALL_WIDTH, _POST_RADIUS = 0.1, 0.12  # [m]
_HEIGHTS = np.linspace(WALL_HEIGHT, 0.0, 11)  # [m] at which a ray is tested for an obstacle


def add_wall(world: World, start: Point, end: Point) -> World:
    """A copy with a wall between two points [m]."""
    shape = wall_box(start, end, _WALL_WIDTH)
    wall = World.from_shapes(world.name, [shape], start=world.start, bounds=world.bounds)
    boxes = np.vstack([world.boxes, wall.boxes])
    yaws = np.arctan2(boxes[:, 5], boxes[:, 4])
    return replace(world, boxes=boxes[np.argsort(yaws, kind="stable")])  # sorted like those of `World.from_shapes`


def add_post(world: World, point: Point) -> World:
    """A copy with a post at a point [m]."""
    return replace(world, posts=np.vstack([world.posts, (*point, _POST_RADIUS)]))


def remove_obstacle(world: World, origin: np.ndarray, direction: np.ndarray) -> World:
    """A copy without the walls and posts where a ray hits one first; raises an `InputError` if it hits none."""
    outlines, num_boxes = world.outlines(), len(world.boxes)
    for height in _HEIGHTS:
        point = hit_floor(origin, direction, height)
        if point and (is_hit := shapely.contains_xy(outlines, *point)).any():
            return replace(world, boxes=world.boxes[~is_hit[:num_boxes]], posts=world.posts[~is_hit[num_boxes:]])
    raise InputError("there is no wall or post; click on one")


def hit_floor(origin: np.ndarray, direction: np.ndarray, height: float = 0.0) -> Point | None:
    """The point x, y [m] where a ray comes down to a height [m]; None if it does not."""
    (x, y, z), (dx, dy, dz) = map(float, origin), map(float, direction)
    if not dz < 0.0 or not z > height:
        return None
    way = (height - z) / dz
    return round(x + way * dx, 3), round(y + way * dy, 3)
