"""Pictures of worlds and robots from above."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from PIL import Image, ImageDraw, ImageFont, ImageOps

from tb2rl.rendering import colours
from tb2rl.robots import Laser, Robot
from tb2rl.worlds import DynamicObstacles, World
from tb2rl.worlds.world import box_polygons

SIDE = 640  # [px] longer side of a drawing
_SUPERSAMPLING = 2  # drawn pixels along each side of a final pixel, for smooth lines
_MARGIN = 0.3  # [m] margin around the world
GOAL_RADIUS = 0.2  # [m] radius of the ring that marks a goal
_NOSE = ((150 / 178, 0.0), (50 / 178, 60 / 178), (50 / 178, -60 / 178))  # triangle in the robot's frame [robot radii]
_TILE_SIDE, _TITLE_HEIGHT = 320, 22  # [px] side of a picture and height of its title in a grid
HEADER_HEIGHT, _MIN_HEADER_WIDTH = 50, 560  # [px] a title and a legend above a picture
_SCALE_BARS = 1, 2, 5, 10, 20, 50, 100, 200, 500  # [m]
_MIN_SCALE_BAR = 25  # [px]

Point = Sequence[float] | np.ndarray  # x, y [m], and optional numbers that are ignored
Points = Iterable[Point]


class Canvas:
    """A drawing of a world's walls, with x to the right, y up, and lengths in metres."""

    def __init__(self, world: World) -> None:
        x0, y0, x1, y1 = world.bounds
        self._left, self._top = x0 - _MARGIN, y1 + _MARGIN
        sides = np.array([x1 - x0, y1 - y0]) + 2 * _MARGIN
        self._scale = _SUPERSAMPLING * _scale(world)  # [px/m]
        # Even width and height, because video encoders need them.
        size = 2 * np.maximum(1, np.round(sides * self._scale / _SUPERSAMPLING / 2)).astype(int)
        self._image = Image.new("RGB", tuple((size * _SUPERSAMPLING).tolist()), colours.FLOOR)
        self._draw = ImageDraw.Draw(self._image)
        for outline in world.outlines():
            self.polygon(outline.exterior.coords, colours.WALL)

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
            canvas.line([(x, y), (x + length * math.cos(angle), y + length * math.sin(angle))], colours.BEAM, 0.015)
        canvas.line(path, colours.PATH, 0.04)
        for row in () if dynamic_obstacles is None else dynamic_obstacles.tolist():
            _draw_dynamic_obstacle(canvas, row)
        draw_robot(canvas, self._robot, x, y, yaw)
        return canvas.array()


def draw_goal(canvas: Canvas, goal: Point | None) -> None:
    """Draw a ring around a goal x, y [m], unless the goal is None or NaN."""
    if goal is not None and np.isfinite(goal).all():
        canvas.disc(goal[0], goal[1], GOAL_RADIUS, None, outline=colours.GOAL)


def draw_routes(canvas: Canvas, groups: Sequence[DynamicObstacles]) -> None:
    """Draw the routes of dynamic obstacles."""
    for group in groups:
        canvas.line(group.route, colours.ROUTE, 0.04)


def draw_robot(canvas: Canvas, robot: Robot, x: float, y: float, yaw: float) -> None:
    cos, sin = math.cos(yaw), math.sin(yaw)

    def to_world(forward: float, left: float) -> tuple[float, float]:
        return x + forward * cos - left * sin, y + forward * sin + left * cos

    canvas.disc(x, y, robot.radius, colours.BODY)
    for left in (robot.wheel_separation / 2, -robot.wheel_separation / 2):
        canvas.line([to_world(-robot.wheel_radius, left), to_world(robot.wheel_radius, left)], colours.WHEEL, 0.03)
    canvas.polygon([to_world(forward * robot.radius, left * robot.radius) for forward, left in _NOSE], colours.NOSE)


def _draw_dynamic_obstacle(canvas: Canvas, row: Sequence[float]) -> None:
    x, y, cos, sin, half_length, half_width = row
    if half_width > 0.0:
        (box,) = box_polygons(np.array([[x, y, half_length, half_width, cos, sin]]))
        canvas.polygon(box.exterior.coords, colours.DYNAMIC_OBSTACLE)
    elif half_length > 0.0:  # the radius of a disc; 0 in an empty row
        canvas.disc(x, y, half_length, colours.DYNAMIC_OBSTACLE)


@dataclass(frozen=True)
class Mark:
    """An entry of a legend."""

    label: str
    colour: str
    shape: str = "line"  # "line", "ring", "disc", "area" or "bar"
    width: int = 14  # [px]


def _scale(world: World) -> float:
    """Pixels per metre in the picture of a world."""
    x0, y0, x1, y1 = world.bounds
    return float(SIDE / (max(x1 - x0, y1 - y0) + 2 * _MARGIN))


def scale_bar(world: World) -> Mark:
    """A bar of 1 m, or of more in the picture of a large world."""
    scale = _scale(world)
    metres = next((length for length in _SCALE_BARS if length * scale >= _MIN_SCALE_BAR), _SCALE_BARS[-1])
    return Mark(f"{metres} m", colours.BODY, "bar", round(metres * scale))


def add_header(picture: np.ndarray, title: str, legend: Sequence[Mark]) -> np.ndarray:
    """Add a title and a legend above a picture (height, width, 3), uint8, and centre a narrow picture below them."""
    missing = max(0, _MIN_HEADER_WIDTH - picture.shape[1])
    sides = Image.fromarray(picture), (missing // 2, 0, missing - missing // 2, 0)
    picture = np.array(ImageOps.expand(*sides, fill=colours.FLOOR)) if missing else picture
    return np.vstack([_draw_header(picture.shape[1], title, tuple(legend)), picture])


@lru_cache(maxsize=16)
def _draw_header(width: int, title: str, legend: tuple[Mark, ...]) -> np.ndarray:
    image = Image.new("RGB", (width, HEADER_HEIGHT), colours.STRIP)
    draw, x, y = ImageDraw.Draw(image), 12, 36
    draw.text((x, 15), title, colours.BODY, fitted_font(title, 16, width - x), anchor="lm")
    for mark in legend:
        end = x + mark.width
        if mark.shape in ("ring", "disc"):
            fill = mark.colour if mark.shape == "disc" else None
            draw.ellipse((x, y - 7, end, y + 7), fill, outline=mark.colour, width=2)
        elif mark.shape == "area":
            draw.rectangle((x, y - 5, end, y + 5), mark.colour)
        else:
            draw.line((x, y, end, y), mark.colour, 3)
            for tick in (x, end) if mark.shape == "bar" else ():
                draw.line((tick, y - 4, tick, y + 5), mark.colour, 2)
        draw.text((end + 6, y), mark.label, colours.LABEL, fitted_font(mark.label, 13), anchor="lm")
        x = round(end + 6 + fitted_font(mark.label, 13).getlength(mark.label) + 18)
    return np.array(image)


@lru_cache(maxsize=256)
def fitted_font(text: str, size: int, max_width: float = math.inf) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font of a size [px], or a smaller one if the text would exceed `max_width` [px]."""
    width = ImageFont.load_default(size).getlength(text) + 12
    return ImageFont.load_default(min(size, size * max_width / width))


def floor_plan_legend(worlds: Sequence[World], robot: Robot) -> list[Mark]:
    """The legend of one or several pictures of `draw_floor_plan`; only a single one has a scale."""
    marks = [
        Mark(f"{robot.name} at the start", colours.BODY, "disc"),
        Mark("reachable by its centre", colours.FREE, "area"),
        Mark("wall", colours.WALL, "area"),
    ]
    if any(world.goal is not None for world in worlds):
        marks.append(Mark("goal", colours.GOAL, "ring"))
    if any(world.dynamic_obstacles for world in worlds):
        marks.append(Mark("route", colours.ROUTE))
    return [*marks, scale_bar(worlds[0])] if len(worlds) == 1 else marks


def draw_floor_plan(world: World, robot: Robot) -> np.ndarray:
    """Draw a world, the robot at the start, and the space that its centre can reach; shape (height, width, 3), uint8.

    Raises:
        InputError: If the start is too close to an obstacle for the robot.
    """
    canvas = Canvas(world)
    # The free space is drawn in triangles, because it has holes, which `polygon` cannot draw.
    for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(world.free_space(robot.radius))):
        canvas.polygon(triangle.exterior.coords, colours.FREE)
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
    rows = math.ceil(len(pictures) / columns)
    grid = Image.new("RGB", (columns * side, rows * (side + _TITLE_HEIGHT)), colours.STRIP)
    draw = ImageDraw.Draw(grid)
    for i, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        left, top = i % columns * side, i // columns * (side + _TITLE_HEIGHT)
        tile = ImageOps.pad(Image.fromarray(picture), (side - 8, side - 8), color=colours.STRIP)
        grid.paste(tile, (left + 4, top + 4))
        draw.text((left + side // 2, top + side + 1), title, colours.BODY, fitted_font(title, 14, side), anchor="mt")
    return np.array(grid)
