"""Mazes: boxes and posts, the free space between them, and start and goal poses.

A maze is a YAML file (`configs/mazes` holds the built-in ones) or a text drawing, `#` for a wall, `S` for the start
and `G` for the goal. Every obstacle ends up as an oriented box or a round post: laser, physics and pictures read those.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from annotated_types import MinLen
from shapely.geometry.base import BaseGeometry

from tb2rl.errors import InputError
from tb2rl.laser import clearance_one
from tb2rl.robot import BASE_RADIUS
from tb2rl.settings import Point, Pose, Positive, build, find_file, read_text, read_yaml, room

FOLDER = room("configs") / "mazes"
WALL_HEIGHT = 0.5  # [m] higher than the laser, low enough to look over in a picture


@dataclass(frozen=True)
class Wall:
    """A wall along a path of points; corners are filled."""

    path: Annotated[tuple[Point, ...], MinLen(2)]
    thickness: Positive = 0.2  # [m]
    closed: bool = False  # joins the last point to the first


@dataclass(frozen=True)
class Box:
    """A solid box, turned by `yaw` [rad] about its centre."""

    centre: Point
    size: tuple[Positive, Positive]  # [m] along and across
    yaw: float = 0.0


@dataclass(frozen=True)
class Post:
    """A round post."""

    centre: Point
    radius: Positive  # [m]


@dataclass(frozen=True)
class MazeFile:
    """What a maze's YAML file may say."""

    description: str = ""
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    posts: tuple[Post, ...] = ()
    drawing: str = ""  # `#` wall, `S` start, `G` goal, anything else free
    cell: Positive = 2.0  # [m] side of a character of the drawing: a corridor with room to turn
    start: Pose | None = None
    goal: Pose | None = None
    bounds: tuple[float, float, float, float] | None = None  # x from, y from, x to, y to; None: around the obstacles


@dataclass(frozen=True, eq=False)
class Maze:
    """Obstacles, and where a robot may be among them.

    Attributes:
        boxes: Rows of x, y, half length, half width [m], cos(yaw), sin(yaw), shape (boxes, 6).
        posts: Rows of x, y, radius [m], shape (posts, 3).
        start: The fixed start pose (x, y, yaw).
        goal: The goal pose, or None.
        bounds: The rectangle that counts as the maze: x from, y from, x to, y to [m].
    """

    name: str
    boxes: np.ndarray
    posts: np.ndarray
    start: Pose
    goal: Pose | None
    bounds: tuple[float, float, float, float]
    description: str = ""
    _free: dict[float, BaseGeometry] = field(default_factory=dict, repr=False, compare=False)

    @cached_property
    def obstacles(self) -> BaseGeometry:
        """All obstacles as one shape."""
        return shapely.union_all([*map(box_shape, self.boxes), *map(post_shape, self.posts)])

    def free_space(self, clearance: float) -> BaseGeometry:
        """Where a robot from the start can get its centre to, `clearance` [m] from every obstacle and the bounds.

        Raises:
            InputError: If the start itself has no such clearance.
        """
        if clearance not in self._free:
            x, y = self.start[:2]
            if not shapely.box(*self.bounds).covers(shapely.Point(x, y)):
                raise InputError(f"maze {self.name}: the start ({x:g}, {y:g}) is outside its bounds")
            inside = shapely.box(*self.bounds).buffer(-clearance)
            open_space = inside.difference(self.obstacles.buffer(clearance, quad_segs=32))
            start = shapely.Point(self.start[:2])
            rooms = [room for room in shapely.get_parts(open_space) if room.intersects(start)]
            if not rooms:
                raise InputError(
                    f"maze {self.name}: the start ({x:g}, {y:g}) is inside a wall or nearer than {clearance:g} m to "
                    "one, so there is no free space around it; move it or lower task.start_clearance"
                )
            self._free[clearance] = rooms[0]
        return self._free[clearance]

    def clearance(self, x: float, y: float) -> float:
        """Distance from a point to the nearest obstacle [m]; 0 inside one."""
        return clearance_one(x, y, self.boxes, self.posts)

    def random_poses(self, rng: np.random.Generator, count: int, clearance: float) -> np.ndarray:
        """Poses spread evenly over the free space, headings over the circle, shape (count, 3)."""
        return self.poses_from(rng.random((count, 4)), clearance)

    def poses_from(self, draws: np.ndarray, clearance: float) -> np.ndarray:
        """The poses that four random numbers in [0, 1) each mean, (count, 4) to (count, 3); see `random_poses`.

        Points come from the triangles of the free space: no rejection, whatever the maze.
        """
        corners, shares = self._triangles(clearance)
        triangle = corners[np.searchsorted(shares, draws[:, 0], side="right").clip(max=len(shares) - 1)]
        root = np.sqrt(draws[:, 1:2])  # Osada et al. 2002, "Shape distributions", section 4.2
        points = (1 - root) * triangle[:, 0] + root * (
            (1 - draws[:, 2:3]) * triangle[:, 1] + draws[:, 2:3] * triangle[:, 2]
        )
        return np.column_stack([points, math.tau * draws[:, 3] - math.pi])

    @lru_cache(maxsize=8)  # noqa: B019 (mazes are few and live as long as the process)
    def _triangles(self, clearance: float) -> tuple[np.ndarray, np.ndarray]:
        parts = shapely.get_parts(shapely.constrained_delaunay_triangles(self.free_space(clearance)))
        corners = np.array([part.exterior.coords[:3] for part in parts])
        return corners, np.cumsum(shapely.area(parts)) / shapely.area(parts).sum()


def box_shape(row: np.ndarray) -> BaseGeometry:
    """The polygon of one row of `Maze.boxes`."""
    x, y, half_length, half_width, cos, sin = row
    along, across = half_length * np.array([cos, sin]), half_width * np.array([-sin, cos])
    corners = [along + across, across - along, -along - across, along - across]
    return shapely.Polygon([corner + (x, y) for corner in corners])


def post_shape(row: np.ndarray) -> BaseGeometry:
    """A polygon around one row of `Maze.posts`, off by less than 1 mm per metre of radius."""
    return shapely.Point(row[:2]).buffer(row[2], quad_segs=32)


def maze_names() -> list[str]:
    """The built-in mazes."""
    return sorted(file.stem for file in FOLDER.glob("*.yaml"))


def load_maze(name: str) -> Maze:
    """The maze of a built-in name, or of the path of a YAML file or a text drawing (`.txt`).

    Raises:
        InputError: If there is none, its file does not fit `MazeFile`, or a robot has no room at its start.
    """
    path = find_file(name, FOLDER, "maze", suffixes=(".yaml", ".yml", ".txt"))
    return _load(path.resolve(), path.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _load(path: Path, _modified: int) -> Maze:
    if path.suffix == ".txt":
        return maze_from({"drawing": read_text(path)}, path.stem)
    return maze_from(read_yaml(path), path.stem)


def maze_from(content: Any, name: str) -> Maze:
    """A maze from the content of its file, see `MazeFile`."""
    file = build(MazeFile, content, f"maze {name}")
    if file.bounds and not (file.bounds[0] < file.bounds[2] and file.bounds[1] < file.bounds[3]):
        raise InputError(f"maze {name}: bounds must be x from, y from, x to, y to, got {list(file.bounds)}")
    cells, start, goal = _read_drawing(file.drawing, file.cell)
    boxes = [*_wall_boxes(file.walls), *((*box.centre, *box.size, box.yaw) for box in file.boxes), *cells]
    start, goal = file.start or start, file.goal or goal
    if start is None:
        raise InputError(f"maze {name}: it has no start; add `start: [x, y, yaw]`, or an S to the drawing")
    rows = _box_rows(boxes)
    posts = np.array([(*post.centre, post.radius) for post in file.posts], dtype=float).reshape(-1, 3)
    maze = Maze(name, rows, posts, start, goal, file.bounds or _extent(rows, posts, name), file.description)
    maze.free_space(BASE_RADIUS)
    return maze


def _box_rows(boxes: Sequence[tuple[float, ...]]) -> np.ndarray:
    """`Maze.boxes` from x, y, length, width, yaw: turned by 45 degrees at most, those of one orientation together.

    A box turned by a quarter is the same box with its sides swapped: so the walls of a square maze share one
    orientation, and the laser needs the beams' directions in it only once.
    """
    rows = []
    for x, y, length, width, yaw in boxes:
        quarters = round(yaw / (math.pi / 2))
        yaw -= quarters * math.pi / 2
        yaw = yaw if abs(yaw) > 1e-12 else 0.0
        along, across = (width, length) if quarters % 2 else (length, width)
        rows.append((yaw, x, y, along / 2, across / 2))
    table = np.array(sorted(rows), dtype=float).reshape(-1, 5)
    return np.column_stack([table[:, 1:], np.cos(table[:, 0]), np.sin(table[:, 0])])


def _wall_boxes(walls: Sequence[Wall]) -> list[tuple[float, ...]]:
    boxes: list[tuple[float, ...]] = []
    for wall in walls:
        points = [*wall.path, wall.path[0]] if wall.closed else wall.path
        for (x0, y0), (x1, y1) in pairwise(points):
            length = math.hypot(x1 - x0, y1 - y0) + wall.thickness
            boxes.append(((x0 + x1) / 2, (y0 + y1) / 2, length, wall.thickness, math.atan2(y1 - y0, x1 - x0)))
    return boxes


def _read_drawing(drawing: str, cell: float) -> tuple[list[tuple[float, ...]], Pose | None, Pose | None]:
    """Boxes, start and goal of a drawing; its lower left corner is the origin. Runs of `#` become one box."""
    lines = drawing.rstrip().splitlines()[::-1]
    marks: dict[str, Pose] = {}
    runs: dict[tuple[int, int], list[int]] = {}  # (first, last column) -> rows, to stack equal runs into one box
    for row, line in enumerate(lines):
        for column, mark in enumerate(line):
            if mark in "SG":
                marks[mark] = ((column + 0.5) * cell, (row + 0.5) * cell, 0.0)
        for first, last in _runs(line):
            runs.setdefault((first, last), []).append(row)
    boxes: list[tuple[float, ...]] = []
    for (first, last), rows in runs.items():
        for bottom, top in _stretches(rows):
            size = ((last - first + 1) * cell, (top - bottom + 1) * cell)
            boxes.append(((first + last + 1) / 2 * cell, (bottom + top + 1) / 2 * cell, *size, 0.0))
    return boxes, marks.get("S"), marks.get("G")


def _runs(line: str) -> list[tuple[int, int]]:
    return _stretches([column for column, mark in enumerate(line) if mark == "#"])


def _stretches(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each stretch of consecutive ascending integers."""
    stretches: list[tuple[int, int]] = []
    for number in numbers:
        if stretches and number == stretches[-1][1] + 1:
            stretches[-1] = (stretches[-1][0], number)
        else:
            stretches.append((number, number))
    return stretches


def _extent(boxes: np.ndarray, posts: np.ndarray, name: str) -> tuple[float, float, float, float]:
    shapes = [*map(box_shape, boxes), *map(post_shape, posts)]
    if not shapes:
        raise InputError(f"maze {name}: without obstacles it needs `bounds: [x from, y from, x to, y to]`")
    x0, y0, x1, y1 = shapely.union_all(shapes).bounds
    return x0, y0, x1, y1
