"""Worlds as YAML files: walls, boxes and posts in metres, or a drawing; `configs/worlds` holds the built-in ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import yaml
from annotated_types import MinLen

from tb2rl.core.errors import InputError
from tb2rl.core.files import write_text
from tb2rl.core.values import Point, Pose, Positive, build
from tb2rl.worlds.drawing import read_drawing
from tb2rl.worlds.dynamic_obstacles import said_of
from tb2rl.worlds.formats.imports import Import
from tb2rl.worlds.world import Bounds, BoxShape, World


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
class Description:
    """What a world's YAML file may say."""

    description: str = ""
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    posts: tuple[Post, ...] = ()
    drawing: str = ""  # `#` wall, `S` start, `G` goal, `.` or a blank free
    cell: Positive = 2.0  # [m] side of a character of the drawing: a corridor with room to turn
    start: Pose | None = None
    goal: Pose | None = None
    bounds: Bounds | None = None  # None: around the obstacles
    dynamic_obstacles: Any = None  # what moves: see `tb2rl.worlds.dynamic_obstacles`


def write_description(world: World, path: Path) -> None:
    """Write a world as a YAML file that `world_from` reads: the same boxes and posts, and what moves.

    Raises:
        OSError: If it cannot be written.
    """
    boxes = [
        {"centre": [x, y], "size": [2 * half_length, 2 * half_width], "yaw": math.atan2(sin, cos)}
        for x, y, half_length, half_width, cos, sin in world.boxes.tolist()
    ]
    said = {
        "description": world.description,
        "boxes": boxes,
        "posts": [{"centre": [x, y], "radius": radius} for x, y, radius in world.posts.tolist()],
        "start": [float(value) for value in world.start],
        "goal": world.goal and [float(value) for value in world.goal],
        "bounds": [float(value) for value in world.bounds],
        "dynamic_obstacles": [said_of(group) for group in world.dynamic_obstacles],
    }
    kept = {key: value for key, value in said.items() if value}
    write_text(path, yaml.safe_dump(kept, sort_keys=False, default_flow_style=None, width=120))


def world_from(content: Any, name: str, beside: Import | None = None) -> World:
    """The world that the content of a YAML file describes, see `Description`.

    Args:
        content: What is in the file.
        name: What the world is called.
        beside: What is said beside the file: it comes before what the file says.

    Raises:
        InputError: If it does not fit.
    """
    beside = beside or Import()
    said = build(Description, content, f"world {name}")
    try:
        drawn = read_drawing(said.drawing, said.cell)
    except InputError as error:
        raise InputError(f"world {name}: {error}") from None
    start, goal = beside.start or said.start or drawn.start, beside.goal or said.goal or drawn.goal
    if start is None:
        raise InputError(f"world {name}: it has no start; add `start: [x, y, yaw]`, or an S to the drawing")
    boxes = [*_wall_boxes(said.walls), *((*box.centre, *box.size, box.yaw) for box in said.boxes), *drawn.boxes]
    posts = [(*post.centre, post.radius) for post in said.posts]
    return World.from_shapes(
        name,
        boxes,
        posts,
        start=start,
        goal=goal,
        bounds=beside.bounds or said.bounds,
        description=said.description,
        dynamic_obstacles=said.dynamic_obstacles,
    )


def _wall_boxes(walls: Sequence[Wall]) -> Iterator[BoxShape]:
    for wall in walls:
        points = [*wall.path, wall.path[0]] if wall.closed else wall.path
        for (x0, y0), (x1, y1) in pairwise(points):
            length = math.hypot(x1 - x0, y1 - y0) + wall.thickness
            yield (x0 + x1) / 2, (y0 + y1) / 2, length, wall.thickness, math.atan2(y1 - y0, x1 - x0)
