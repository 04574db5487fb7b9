"""Pictures of worlds and robots from above."""

import math
from collections.abc import Sequence

import numpy as np
import shapely
from PIL import Image, ImageDraw, ImageOps

from tb2rl.rendering.canvas import Canvas, Point, Points
from tb2rl.rendering.colours import BEAM, BODY, DYNAMIC_OBSTACLE, FREE, GOAL, LABEL, NOSE, PATH, ROUTE, STRIP, WHEEL
from tb2rl.robots import Laser, Robot
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.world import box_polygons

GOAL_RADIUS = 0.2  # [m] radius of the ring that marks a goal
_NOSE = ((150 / 178, 0.0), (50 / 178, 60 / 178), (50 / 178, -60 / 178))  # triangle in the robot's frame [robot radii]
_TILE_SIDE, _TITLE_HEIGHT = 320, 18  # [px] side of a picture and height of its title in a grid


class WorldPicture:
    """Draws a robot in one world. The static parts are drawn only once.

    Args:
        goal: x, y [m]; None or NaN without a goal.
    """

    def __init__(self, world: World, robot: Robot, laser: Laser, goal: Point | None = None) -> None:
        self._robot, self._laser, self._background = robot, laser, Canvas(world)
        draw_goal(self._background, goal)

    def draw(
        self, pose: np.ndarray, ranges: np.ndarray, path: Points, dynamic_obstacles: np.ndarray | None = None
    ) -> np.ndarray:
        """Draw the robot, its laser beams, its path and the dynamic obstacles.

        Args:
            pose: x [m], y [m], yaw [rad], shape (3,).
            ranges: Ranges of the laser's beams [m], shape (beams,).
            path: Poses (3,) or points (2,) since the reset.
            dynamic_obstacles: `RobotState.dynamic_obstacles` of one environment, shape (obstacles, 6).

        Returns:
            Shape (height, width, 3), uint8.
        """
        canvas = self._background.copy()
        x, y, yaw = pose
        for angle, distance in zip(self._laser.angles + yaw, ranges, strict=True):
            length = min(distance, self._laser.max_range)
            canvas.line([(x, y), (x + length * math.cos(angle), y + length * math.sin(angle))], BEAM, 0.015)
        canvas.line(path, PATH, 0.04)
        for outline in () if dynamic_obstacles is None else dynamic_obstacles.tolist():
            _draw_dynamic_obstacle(canvas, outline)
        draw_robot(canvas, self._robot, x, y, yaw)
        return canvas.array()


def draw_goal(canvas: Canvas, goal: Point | None) -> None:
    """Draw a ring around a goal x, y [m], unless the goal is None or NaN."""
    if goal is not None and np.isfinite(goal).all():
        canvas.disc(goal[0], goal[1], GOAL_RADIUS, None, outline=GOAL)


def draw_routes(canvas: Canvas, groups: Sequence[DynamicObstacles]) -> None:
    """Draw the routes of dynamic obstacles."""
    for group in groups:
        canvas.line(group.route, ROUTE, 0.04)


def draw_robot(canvas: Canvas, robot: Robot, x: float, y: float, yaw: float) -> None:
    cos, sin = math.cos(yaw), math.sin(yaw)

    def to_world(forward: float, left: float) -> tuple[float, float]:
        return x + forward * cos - left * sin, y + forward * sin + left * cos

    canvas.disc(x, y, robot.radius, BODY)
    for left in (robot.wheel_separation / 2, -robot.wheel_separation / 2):
        canvas.line([to_world(-robot.wheel_radius, left), to_world(robot.wheel_radius, left)], WHEEL, 0.03)
    canvas.polygon([to_world(forward * robot.radius, left * robot.radius) for forward, left in _NOSE], NOSE)


def _draw_dynamic_obstacle(canvas: Canvas, outline: Sequence[float]) -> None:
    x, y, cos, sin, length, width = outline
    if width > 0.0:
        (box,) = box_polygons(np.array([[x, y, length, width, cos, sin]]))
        canvas.polygon(box.exterior.coords, DYNAMIC_OBSTACLE)
    elif length > 0.0:  # the length of a disc is its radius
        canvas.disc(x, y, length, DYNAMIC_OBSTACLE)


def draw_plan(world: World, robot: Robot) -> np.ndarray:
    """Draw a world, the robot at the start, and the space that its centre can reach; shape (height, width, 3), uint8.

    Raises:
        InputError: If the start is too close to an obstacle for the robot.
    """
    canvas = Canvas(world)
    # The free space is drawn in triangles, because it has holes, which `polygon` cannot draw.
    for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(world.free_space(robot.radius))):
        canvas.polygon(triangle.exterior.coords, FREE)
    draw_routes(canvas, world.dynamic_obstacles)
    draw_goal(canvas, None if world.goal is None else world.goal[:2])
    draw_robot(canvas, robot, *world.start)
    return canvas.array()


def make_grid(
    pictures: Sequence[np.ndarray], titles: Sequence[str], columns: int | None = None, side: int = _TILE_SIDE
) -> np.ndarray:
    """Arrange pictures (height, width, 3) in a grid, each in a square of a given `side` [px] above its title.

    A single picture is returned unchanged.
    """
    if len(pictures) == 1:
        return pictures[0]
    columns = columns or math.ceil(math.sqrt(len(pictures)))
    grid = Image.new("RGB", (columns * side, math.ceil(len(pictures) / columns) * (side + _TITLE_HEIGHT)), STRIP)
    draw = ImageDraw.Draw(grid)
    for i, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        left, top = i % columns * side, i // columns * (side + _TITLE_HEIGHT)
        grid.paste(ImageOps.pad(Image.fromarray(picture), (side - 8, side - 8), color=STRIP), (left + 4, top + 4))
        draw.text((left + side // 2, top + side), title, LABEL, anchor="mt")
    return np.array(grid)
