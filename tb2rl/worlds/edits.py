"""Changed copies of a world: walls and posts that a user adds or removes."""

import math
from dataclasses import replace

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.values import Point
from tb2rl.worlds.world import WALL_HEIGHT, BoxShape, PostShape, World

_WALL_WIDTH, _POST_RADIUS = 0.1, 0.12  # [m]
_HEIGHTS = np.linspace(WALL_HEIGHT, 0.0, 11)  # [m] at which a ray is tested for an obstacle


def add_wall(world: World, start: Point, end: Point) -> World:
    """A copy with a wall between two points [m]."""
    length = math.dist(start, end) + _WALL_WIDTH
    middle, yaw = np.mean([start, end], axis=0).tolist(), math.atan2(end[1] - start[1], end[0] - start[0])
    return _with_shapes(world, [*_boxes(world), (*middle, length, _WALL_WIDTH, yaw)], _posts(world))


def add_post(world: World, point: Point) -> World:
    """A copy with a post at a point [m]."""
    return _with_shapes(world, _boxes(world), [*_posts(world), (*point, _POST_RADIUS)])


def remove_obstacle(world: World, origin: np.ndarray, direction: np.ndarray) -> World:
    """A copy without the walls and posts where a ray hits one first; raises an `InputError` if it hits none."""
    boxes, posts = _boxes(world), _posts(world)
    for height in _HEIGHTS:
        if point := hit_floor(origin, direction, height):
            left_boxes = [box for box in boxes if _box_distance(box, point) > 0.0]
            left_posts = [post for post in posts if _post_distance(post, point) > 0.0]
            if len(left_boxes) + len(left_posts) < len(boxes) + len(posts):
                return _with_shapes(world, left_boxes, left_posts)
    raise InputError("there is no wall or post; click on one")


def hit_floor(origin: np.ndarray, direction: np.ndarray, height: float = 0.0) -> Point | None:
    """The point x, y [m] where a ray comes down to a height [m]; None if it does not."""
    (x, y, z), (dx, dy, dz) = map(float, origin), map(float, direction)
    if not dz < 0.0 or not z > height:
        return None
    way = (height - z) / dz
    return round(x + way * dx, 3), round(y + way * dy, 3)


def _with_shapes(world: World, boxes: list[BoxShape], posts: list[PostShape]) -> World:
    changed = World.from_shapes(world.name, boxes, posts, start=world.start, goal=world.goal, bounds=world.bounds)
    return replace(changed, description=world.description, dynamic_obstacles=world.dynamic_obstacles)


def _boxes(world: World) -> list[BoxShape]:
    x, y, half_length, half_width, cos, sin = world.boxes.T
    return list(
        zip(*(column.tolist() for column in (x, y, 2 * half_length, 2 * half_width, np.arctan2(sin, cos))), strict=True)
    )


def _posts(world: World) -> list[PostShape]:
    return [tuple(row) for row in world.posts.tolist()]


def _box_distance(box: BoxShape, point: Point) -> float:
    x, y, length, width, yaw = box
    dx, dy = point[0] - x, point[1] - y
    along, across = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
    return max(abs(along) - length / 2, abs(across) - width / 2)


def _post_distance(post: PostShape, point: Point) -> float:
    return math.dist(post[:2], point) - post[2]
