"""World files in YAML: walls, boxes and posts in metres, or a drawing."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from annotated_types import MinLen

from tb2rl.core import InputError, write_text
from tb2rl.core.values import Point, Pose, Positive, build
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.occupancy_grid import stack_runs
from tb2rl.worlds.world import Bounds, BoxShape, World


@dataclass(frozen=True)
class Wall:
    """A wall along a polyline; each segment is half a thickness longer at both ends, so that corners are filled."""

    path: Annotated[tuple[Point, ...], MinLen(2)]
    thickness: Positive = 0.2  # [m]
    closed: bool = False  # joins the last point to the first


@dataclass(frozen=True)
class Box:
    """A box, rotated about its centre."""

    centre: Point
    size: tuple[Positive, Positive]  # [m] length and width
    yaw: float = 0.0  # [rad] direction of the length


@dataclass(frozen=True)
class Post:
    """A round post."""

    centre: Point
    radius: Positive  # [m]


@dataclass(frozen=True)
class Description:
    """Keys of a world's YAML file."""

    description: str = ""
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    posts: tuple[Post, ...] = ()
    drawing: str = ""  # lines of characters: `#` is wall, `S` start, `G` goal; `.` or a space is free floor
    cell: Positive = 2.0  # [m] side of the square of a character; the default leaves room to turn in a corridor
    start: Pose | None = None
    goal: Pose | None = None
    bounds: Bounds | None = None  # None: the bounding box of the obstacles
    dynamic_obstacles: Any = None  # see `tb2rl.worlds.dynamic_obstacles`


def write_description(world: World, path: Path) -> None:
    """Write a world as a YAML file that `parse_world` reads.

    Raises:
        OSError: If the file cannot be written.
    """
    content = {
        "description": world.description,
        "boxes": [
            {"centre": [x, y], "size": [2 * half_length, 2 * half_width], "yaw": math.atan2(sin, cos)}
            for x, y, half_length, half_width, cos, sin in world.boxes.tolist()
        ],
        "posts": [{"centre": [x, y], "radius": radius} for x, y, radius in world.posts.tolist()],
        "start": [float(value) for value in world.start],
        "goal": world.goal and [float(value) for value in world.goal],
        "bounds": [float(value) for value in world.bounds],
        "dynamic_obstacles": [group.settings() for group in world.dynamic_obstacles],
    }
    present = {key: value for key, value in content.items() if value}
    write_text(path, yaml.safe_dump(present, sort_keys=False, default_flow_style=None, width=120))


def parse_world(content: Any, name: str, options: ImportOptions | None = None) -> World:
    """Make a world from the content of a YAML file, see `Description`; `options` take precedence.

    Raises:
        InputError: If the content is invalid.
    """
    options, label = options or ImportOptions(), f"world {name}"
    parsed = build(Description, content, label)
    drawn_walls, drawn_poses = _parse_drawing(parsed.drawing, parsed.cell, label)
    start = options.start or parsed.start or drawn_poses.get("S")
    if start is None:
        raise InputError(f"{label} has no start; add `start: [x, y, yaw]`, or an S to the drawing")
    boxes = ((*box.centre, *box.size, box.yaw) for box in parsed.boxes)
    return World.from_shapes(
        name,
        [*_wall_boxes(parsed.walls), *boxes, *drawn_walls],
        [(*post.centre, post.radius) for post in parsed.posts],
        start=start,
        goal=options.goal or parsed.goal or drawn_poses.get("G"),
        bounds=options.bounds or parsed.bounds,
        description=parsed.description,
        dynamic_obstacles=parsed.dynamic_obstacles,
    )


def _wall_boxes(walls: Sequence[Wall]) -> Iterator[BoxShape]:
    for wall in walls:
        points = [*wall.path, wall.path[0]] if wall.closed else wall.path
        for start, end in pairwise(points):
            yield wall_box(start, end, wall.thickness)


def wall_box(start: Point, end: Point, thickness: float) -> BoxShape:
    """The box of a wall between two points [m], half a thickness longer at both ends."""
    (x0, y0), (x1, y1) = start, end
    return (x0 + x1) / 2, (y0 + y1) / 2, math.dist(start, end) + thickness, thickness, math.atan2(y1 - y0, x1 - x0)


def _parse_drawing(text: str, cell: float, label: str) -> tuple[list[BoxShape], dict[str, Pose]]:
    """Walls of a drawing, with adjacent walls merged, and the poses of its marks S and G.

    The lower left corner is the origin. `cell` is the side of the square of a character [m].
    """
    lines = text.rstrip(" \n").split("\n")
    wall_runs: list[tuple[int, int, int]] = []  # row, first column and end column
    poses: dict[str, Pose] = {}
    for number, line in enumerate(lines, start=1):
        row = len(lines) - number
        for match in re.finditer("#+|[^. ]", line):
            begin, end = match.span()
            mark = match[0][0]
            if mark == "#":
                wall_runs.append((row, begin, end))
            elif mark in "SG" and mark not in poses:
                poses[mark] = (begin + 0.5) * cell, (row + 0.5) * cell, 0.0
            else:
                known = "# (wall), one S (start), one G (goal), and . or a blank (free floor)"
                place = f"line {number}, column {begin + 1}"
                raise InputError(f"{label}: the drawing has {mark!r} in {place}; it takes {known}")
    boxes: list[BoxShape] = []
    for left, right, bottom, top in stack_runs(*np.array(wall_runs, dtype=int).reshape(-1, 3).T).tolist():
        centre = (left + right) / 2 * cell, (bottom + top) / 2 * cell
        boxes.append((*centre, (right - left) * cell, (top - bottom) * cell, 0.0))
    return boxes, poses
