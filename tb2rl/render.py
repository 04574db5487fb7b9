"""Pictures seen from above, drawn without a window: the robot with its beams and path, the paths of many episodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import lru_cache

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from tb2rl.maze import Maze, box_shape
from tb2rl.robot import BASE_RADIUS, WHEEL_RADIUS, WHEEL_SEPARATION, Laser
from tb2rl.simulation import Reading
from tb2rl.tasks import Task

SIDE = 640  # [px] of the longer side
_SMOOTH = 2  # drawn larger and shrunk, against jagged lines
_MARGIN = 0.3  # [m] around the maze
FLOOR, WALL, PATH, BEAM = "#f4f1ea", "#a85c45", "#2f6fb0", "#f0a63c"
BODY, WHEEL, NOSE, GOAL, CRASH, START = "#2b2d31", "#77797d", "#6cc04a", "#6cc04a", "#d62728", "#2ca02c"
STRIP, LABEL = "#ffffff", "#77797d"  # of a caption
_COLOURS = (FLOOR, WALL, PATH, BEAM, BODY, WHEEL, NOSE, CRASH, STRIP)
_STRIP_HEIGHT = 48  # [px]
_LABEL_SIZE, _VALUE_SIZE = 13, 19  # [px]


class Canvas:
    """A picture in metres: x to the right, y up."""

    def __init__(self, maze: Maze) -> None:
        x0, y0, x1, y1 = maze.bounds
        self._left, self._top = x0 - _MARGIN, y1 + _MARGIN
        width, height = x1 - x0 + 2 * _MARGIN, y1 - y0 + 2 * _MARGIN
        self._scale = SIDE * _SMOOTH / max(width, height)  # [px/m]
        self._size = _even(width * self._scale / _SMOOTH), _even(height * self._scale / _SMOOTH)
        self._image = Image.new("RGB", (self._size[0] * _SMOOTH, self._size[1] * _SMOOTH), FLOOR)
        self._draw = ImageDraw.Draw(self._image)
        for row in maze.boxes:
            self.polygon(box_shape(row).exterior.coords, WALL)
        for x, y, radius in maze.posts:
            self.disc(x, y, radius, WALL)

    def copy(self) -> Canvas:
        """The same picture, to draw more on than on the original."""
        twin = copy(self)
        twin._image = self._image.copy()
        twin._draw = ImageDraw.Draw(twin._image)
        return twin

    def line(self, points: Iterable[Sequence[float] | np.ndarray], colour: str, width: float) -> None:
        """A line through points [m], `width` [m] wide."""
        self._draw.line(self._pixels(points), fill=colour, width=max(1, round(width * self._scale)), joint="curve")

    def polygon(self, points: Iterable[Sequence[float] | np.ndarray], colour: str) -> None:
        """A filled polygon [m]."""
        self._draw.polygon(self._pixels(points), fill=colour)

    def disc(self, x: float, y: float, radius: float, colour: str | None, outline: str | None = None) -> None:
        """A disc [m]; without `colour` only its outline."""
        (left, top), (right, bottom) = self._pixels([(x - radius, y + radius), (x + radius, y - radius)])
        self._draw.ellipse((left, top, right, bottom), fill=colour, outline=outline, width=2 * _SMOOTH)

    def array(self) -> np.ndarray:
        """The finished picture, shape (height, width, 3), uint8."""
        return np.asarray(self._image.reduce(_SMOOTH))

    def _pixels(self, points: Iterable[Sequence[float] | np.ndarray]) -> list[tuple[float, float]]:
        return [((p[0] - self._left) * self._scale, (self._top - p[1]) * self._scale) for p in points]


class Scene:
    """One world, to draw many pictures of: its walls and its goal are drawn only once."""

    def __init__(self, maze: Maze, task: Task, laser: Laser) -> None:
        self._angles, self._max_range = laser.angles, laser.max_range
        self._empty = Canvas(maze)
        _draw_goal(self._empty, task)

    def draw(self, pose: np.ndarray, ranges: np.ndarray, path: Sequence[np.ndarray]) -> np.ndarray:
        """The robot at `pose` (3,) with its beams (beams,) and its path since the reset; see `Canvas.array`."""
        canvas = self._empty.copy()
        x, y, yaw = pose
        for angle, distance in zip(self._angles + yaw, ranges, strict=True):
            reach = min(distance, self._max_range)
            canvas.line([(x, y), (x + reach * math.cos(angle), y + reach * math.sin(angle))], BEAM, 0.015)
        if len(path) > 1:
            canvas.line(path, PATH, 0.04)
        _draw_robot(canvas, x, y, yaw)
        return canvas.array()


def draw_scene(maze: Maze, task: Task, laser: Laser, reading: Reading, path: Sequence[np.ndarray]) -> np.ndarray:
    """One robot with its beams, its path since the reset, and the goal if there is one; see `Canvas.array`."""
    return Scene(maze, task, laser).draw(reading.pose[0], reading.ranges[0], path)


def draw_caption(width: int, values: Mapping[str, str], loud: str | None = None) -> np.ndarray:
    """A strip of text for below a picture: each value under its name, `loud` names one to draw in red.

    Returns:
        Shape (48, width, 3), uint8.
    """
    image = Image.new("RGB", (width, _STRIP_HEIGHT), STRIP)
    draw = ImageDraw.Draw(image)
    column = width / max(1, len(values))
    for number, (name, value) in enumerate(values.items()):
        middle = (number + 0.5) * column
        draw.text((middle, 13), name, LABEL, _font(name, _LABEL_SIZE, column), anchor="mm")
        draw.text((middle, 33), value, CRASH if name == loud else BODY, _font(value, _VALUE_SIZE, column), anchor="mm")
    return np.asarray(image)


def with_caption(picture: np.ndarray, caption: np.ndarray) -> np.ndarray:
    """The picture with the caption below; what is narrower stands in the middle."""
    width = max(picture.shape[1], caption.shape[1])
    rows = zip((picture, caption), (FLOOR, STRIP), strict=True)
    return np.vstack([_widened(part, width, colour) for part, colour in rows])


def draw_paths(maze: Maze, task: Task, paths: Iterable[np.ndarray], crashed: Iterable[bool]) -> np.ndarray:
    """The paths (steps, 2 or 3) of episodes, a dot at each start and a red one at each crash; see `Canvas.array`."""
    canvas = Canvas(maze)
    _draw_goal(canvas, task)
    paths, crashed = list(paths), list(crashed)
    for path in paths:
        if len(path) > 1:
            canvas.line(path, PATH, 0.02)
    for path, crash in zip(paths, crashed, strict=True):
        canvas.disc(path[0][0], path[0][1], 0.08, START)
        if crash:
            canvas.disc(path[-1][0], path[-1][1], 0.12, CRASH)
    return canvas.array()


def _even(pixels: float) -> int:
    """The nearest even number: what video encoders want of a side."""
    return 2 * max(1, round(pixels / 2))


def with_colours(picture: np.ndarray) -> np.ndarray:
    """The picture beside a sample of each colour that drawings have: what a palette for them is made from."""
    samples = [np.full((len(picture), 8, 3), ImageColor.getrgb(colour), dtype=np.uint8) for colour in _COLOURS]
    return np.hstack([picture, *samples])


@lru_cache(maxsize=256)
def _font(text: str, size: int, width: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font in which a text of that size [px] stays within a width [px]."""
    font = ImageFont.load_default(size)
    length = font.getlength(text) + 6
    return font if length <= width else ImageFont.load_default(size * width / length)


def _widened(picture: np.ndarray, width: int, colour: str) -> np.ndarray:
    height, present, _ = picture.shape
    if present == width:
        return picture
    wide = np.full((height, width, 3), ImageColor.getrgb(colour), dtype=np.uint8)
    left = (width - present) // 2
    wide[:, left : left + present] = picture
    return wide


def _draw_goal(canvas: Canvas, task: Task) -> None:
    goal = getattr(task, "goal", None)
    if goal is not None:
        canvas.disc(goal[0], goal[1], max(getattr(task, "goal_tolerance", 0.0), 0.1), None, outline=GOAL)


def _draw_robot(canvas: Canvas, x: float, y: float, yaw: float) -> None:
    cos, sin = math.cos(yaw), math.sin(yaw)

    def at(forward: float, left: float) -> tuple[float, float]:
        return x + forward * cos - left * sin, y + forward * sin + left * cos

    canvas.disc(x, y, BASE_RADIUS, BODY)
    for side in (WHEEL_SEPARATION / 2, -WHEEL_SEPARATION / 2):
        canvas.line([at(-WHEEL_RADIUS, side), at(WHEEL_RADIUS, side)], WHEEL, 0.03)
    canvas.polygon([at(0.15, 0.0), at(0.05, 0.06), at(0.05, -0.06)], NOSE)
