"""Options and results common to all foreign formats."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from pydantic import BeforeValidator
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError, WorldWarning
from tb2rl.core.values import Pose, Positive
from tb2rl.worlds.world import Bounds, BoxShape, PostShape, World

_FLOOR = 5.0  # [m] of floor on each side of a world that has neither bounds nor walls around
_AROUND = 1.0  # [m] of floor around a start and a goal beyond the obstacles
_GAP = 0.15  # [m] from walls: gaps narrower than twice this are too narrow for a robot, and enclose a room
_ROOM = 0.6  # [m] to all walls: what a task asks of a start by default
_ROUND = 8  # segments of a quarter circle: a post of 0.2 m is off by 2 mm
_MOST_OVERLAPS, _SAMPLED = 1_000_000, 100  # pairs of obstacles, estimated from a sample; a union of more takes too long
_NAMES = 100  # at most in a warning


def _with_heading(value: Any) -> Any:
    return (*value, 0.0) if isinstance(value, list | tuple) and len(value) == 2 else value


Goal = Annotated[Pose | None, BeforeValidator(_with_heading)]


@dataclass(frozen=True)
class ImportOptions:
    """Settings beside the file of a world.

    Attributes:
        start: x [m], y [m], yaw [rad]; None: that of the file, else the point farthest from all walls.
        goal: x [m], y [m], and yaw [rad] or nothing; None: that of the file, if it has one.
        bounds: The rectangle that counts as the world; None: around the obstacles, the start and the goal.
        unknown: Meaning of a map's unknown cells.
        laser_height: Height at which the shapes of an SDF world are cut [m].
        model_path: Folders of models of an SDF world, before those of the environment's variables.
    """

    start: Pose | None = None
    goal: Goal = None
    bounds: Bounds | None = None
    unknown: Literal["obstacle", "free"] = "obstacle"
    laser_height: Positive = 0.25  # half the height of our own walls
    model_path: tuple[str, ...] = ()


class Omissions:
    """Parts of a file that a reader leaves out, grouped by reason."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, int]] = {}

    def add(self, reason: str, name: str) -> None:
        """Note a part that is left out."""
        names = self._names.setdefault(reason, {})
        names[name] = names.get(name, 0) + 1

    def warn(self, world: str) -> None:
        """Issue one `WorldWarning` per reason, with the names of the parts."""
        for reason, counts in self._names.items():
            names = [f"{name} ({count} times)" if count > 1 else name for name, count in counts.items()]
            more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
            warnings.warn(f"world {world}: {reason}: {', '.join(names[:_NAMES])}{more}", WorldWarning, stacklevel=2)


def complete_world(
    name: str,
    boxes: Sequence[BoxShape],
    posts: Sequence[PostShape],
    options: ImportOptions,
    *,
    bounds: Bounds | None = None,
    description: str = "",
) -> World:
    """Make a world from the shapes of a file; choose a start, with a warning, if there is none.

    Args:
        name: Name of the world.
        boxes: x, y, length, width [m] and yaw [rad] of each.
        posts: x, y and radius [m] of each.
        options: The options, and the file's own start and goal.
        bounds: The file's own bounds; None: around the obstacles, and a start and a goal beyond them.
        description: One line for people.

    Raises:
        InputError: If that is no world, or has no start and too many overlapping obstacles to find one.
    """
    fixed, empty = options.bounds or bounds, not (boxes or posts)
    floor = fixed or ((-_FLOOR, -_FLOOR, _FLOOR, _FLOOR) if empty else None)
    known = World.from_shapes(name, boxes, posts, start=(0.0, 0.0, 0.0), bounds=floor)
    bounds = fixed or _around(known.bounds, [pose for pose in (options.start, options.goal) if pose is not None])
    start = options.start or _farthest_from_walls(known)
    if start is None and fixed is None:  # only a wall or a post: there is floor around it
        x0, y0, x1, y1 = bounds
        bounds = x0 - _FLOOR, y0 - _FLOOR, x1 + _FLOOR, y1 + _FLOOR
        start = _farthest_from_walls(replace(known, bounds=bounds))
    if start is None:
        raise InputError(f"world {name}: obstacles are everywhere, there is no floor to start on")
    if options.start is None:
        shown = f"[{start[0]:g}, {start[1]:g}, 0]"
        text = f"world {name}: no start is given, so it is {shown}, the point farthest from all walls"
        warnings.warn(text, WorldWarning, stacklevel=2)
    goal = options.goal
    return World.from_shapes(name, boxes, posts, start=start, goal=goal, bounds=bounds, description=description)


def _around(bounds: Bounds, poses: Iterable[Pose]) -> Bounds:
    """Extend bounds by some floor around the poses outside of them."""
    x0, y0, x1, y1 = bounds
    for x, y, _ in poses:
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            x0, y0, x1, y1 = min(x0, x - _AROUND), min(y0, y - _AROUND), max(x1, x + _AROUND), max(y1, y + _AROUND)
    return x0, y0, x1, y1


def _farthest_from_walls(world: World) -> Pose | None:
    """The point of the floor farthest from all walls, in an enclosed room if one has space; None without floor."""
    outside = shapely.box(*world.bounds).buffer(_AROUND, join_style="mitre")
    rooms = shapely.get_parts(outside.difference(_union(world.outlines(_GAP, _ROUND), world.name)))
    enclosed = ~shapely.intersects(rooms, outside.exterior)
    rooms, room = shapely.get_parts(shapely.intersection(rooms, shapely.box(*world.bounds)), return_index=True)
    rooms, enclosed = rooms[shapely.area(rooms) > 0], enclosed[room][shapely.area(rooms) > 0]
    if len(rooms) == 0:
        return None
    circles = shapely.maximum_inscribed_circle(rooms, tolerance=0.01)  # lines from their centres to the walls
    radii = shapely.length(circles)
    indoors = enclosed & (radii > _ROOM - _GAP)
    x, y = circles[np.where(indoors if indoors.any() else True, radii, -1.0).argmax()].coords[0]
    return round(x, 3) + 0.0, round(y, 3) + 0.0, 0.0  # + 0.0: no -0


def _union(outlines: np.ndarray, name: str) -> BaseGeometry:
    """Union of polygons.

    Raises:
        InputError: If so many of them overlap that it would take minutes.
    """
    some = np.random.default_rng(0).permutation(outlines)[:_SAMPLED]
    overlaps = shapely.STRtree(outlines).query(some).shape[1] * len(outlines)
    if overlaps > _MOST_OVERLAPS * len(some):
        raise InputError(f"world {name}: its obstacles overlap too often to find a start; give one")
    return shapely.disjoint_subset_union_all(outlines)
