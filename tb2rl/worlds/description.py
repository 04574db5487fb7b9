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
from tb2rl.worlds.formats.imports import ImportOptions
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
    """Keys of a world's YAML file."""

    description: str = ""
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    posts: tuple[Post, ...] = ()
    drawing: str = ""  # `#` wall, `S` start, `G` goal, `.` or a blank free
    cell: Positive = 2.0  # [m] side of a character of the drawing: a corridor with room to turn
    start: Pose | None = None
    goal: Pose | None = None
    bounds: Bounds | None = None  # None: around the obstacles
    dynamic_obstacles: Any = None  # see `tb2rl.worlds.dynamic_obstacles`


def write_description(world: World, path: Path) -> None:
    """Write a world as a YAML file that `world_from` reads.

    Raises:
        OSError: If it cannot be written.
    """
    content = {
        "description": world.description,
        "boxes": [{"centre": box[:2], "size": box[2:4], "yaw": box[4]} for box in map(list, world.box_shapes)],
        "posts": [{"centre": [x, y], "radius": radius} for x, y, radius in world.posts.tolist()],
        "start": [float(value) for value in world.start],
        "goal": world.goal and [float(value) for value in world.goal],
        "bounds": [float(value) for value in world.bounds],
        "dynamic_obstacles": [group.settings() for group in world.dynamic_obstacles],
    }
    kept = {key: value for key, value in content.items() if value}
    write_text(path, yaml.safe_dump(kept, sort_keys=False, default_flow_style=None, width=120))


def world_from(content: Any, name: str, options: ImportOptions | None = None) -> World:
    """Make a world from the content of a YAML file, see `Description`; `options` take precedence over it.

    Raises:
        InputError: If it is invalid.
    """
    options = options or ImportOptions()
    described = build(Description, content, f"world {name}")
    try:
        drawn = read_drawing(described.drawing, described.cell)
    except InputError as error:
        raise InputError(f"world {name}: {error}") from None
    start = options.start or described.start or drawn.start
    if start is None:
        raise InputError(f"world {name}: it has no start; add `start: [x, y, yaw]`, or an S to the drawing")
    boxes = ((*box.centre, *box.size, box.yaw) for box in described.boxes)
    return World.from_shapes(
        name,
        [*_wall_boxes(described.walls), *boxes, *drawn.boxes],
        [(*post.centre, post.radius) for post in described.posts],
        start=start,
        goal=options.goal or described.goal or drawn.goal,
        bounds=options.bounds or described.bounds,
        description=described.description,
        dynamic_obstacles=described.dynamic_obstacles,
    )


def _wall_boxes(walls: Sequence[Wall]) -> Iterator[BoxShape]:
    for wall in walls:
        points = [*wall.path, wall.path[0]] if wall.closed else wall.path
        for (x0, y0), (x1, y1) in pairwise(points):
            length = math.hypot(x1 - x0, y1 - y0) + wall.thickness
            yield (x0 + x1) / 2, (y0 + y1) / 2, length, wall.thickness, math.atan2(y1 - y0, x1 - x0)
