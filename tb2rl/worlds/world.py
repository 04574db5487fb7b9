"""A world: obstacles, the free space between them, and start and goal poses.

Every obstacle is an oriented box or a round post: laser, physics and pictures all read the same two tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import Point, Pose
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles, find_dynamic_obstacles
from tb2rl.worlds.geometry import clearance_at, place_in_triangles
from tb2rl.worlds.index import WorldIndex, index_of

WALL_HEIGHT = 0.5  # [m] higher than the laser, low enough to look over in a picture
_ROUNDING = 1e-9  # [m]

BoxShape = tuple[float, float, float, float, float]  # x, y, length, width [m], yaw [rad]
PostShape = tuple[float, float, float]  # x, y, radius [m]
Bounds = tuple[float, float, float, float]  # x from, y from, x to, y to [m]
Triangles = tuple[np.ndarray, np.ndarray]  # corners [m], shape (triangles, 3, 2); cumulative share of the area


@dataclass(frozen=True, eq=False)
class World:
    """Obstacles, start and goal; made by `from_shapes`.

    Attributes:
        boxes: Rows of x, y, half length, half width [m], cos(yaw), sin(yaw), shape (boxes, 6).
        posts: Rows of x, y, radius [m], shape (posts, 3).
        start: The fixed start pose x [m], y [m], yaw [rad].
        goal: The goal pose, or None.
        bounds: The rectangle that counts as the world.
        description: One line for people.
    """

    name: str
    boxes: np.ndarray
    posts: np.ndarray
    start: Pose
    goal: Pose | None
    bounds: Bounds
    description: str = ""
    dynamic_obstacles: tuple[DynamicObstacles, ...] = ()
    _free_spaces: dict[float, BaseGeometry] = field(default_factory=dict, init=False, repr=False)
    _triangles: dict[float, Triangles] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def from_shapes(
        cls,
        name: str,
        boxes: Iterable[BoxShape] = (),
        posts: Iterable[PostShape] = (),
        *,
        start: Pose,
        goal: Pose | None = None,
        bounds: Bounds | None = None,
        description: str = "",
        dynamic_obstacles: Any = None,
    ) -> World:
        """Make a world from its shapes.

        Args:
            name: Name of the world.
            boxes: x, y of the centre, length, width [m] and yaw [rad] of each box.
            posts: x, y and radius [m] of each post.
            start: The fixed start pose x [m], y [m], yaw [rad].
            goal: The goal pose, if there is one.
            bounds: The rectangle that counts as the world; None: the rectangle around the obstacles.
            description: One line for people.
            dynamic_obstacles: `DynamicObstacles`, or a setting that `find_dynamic_obstacles` takes.

        Raises:
            InputError: If there are neither obstacles nor bounds, a value is invalid, or the goal is outside the bounds
                or in an obstacle.
        """
        box_rows = _box_rows(_shapes(boxes, "box", ("x", "y", "length", "width", "yaw"), name))
        post_rows = np.array(_shapes(posts, "post", ("x", "y", "radius"), name)).reshape(-1, 3)
        _numbers(start, ("x", "y", "yaw"), f"world {name}: the start")
        bounds = _extent(box_rows, post_rows, name) if bounds is None else bounds
        _numbers(bounds, ("x from", "y from", "x to", "y to"), f"world {name}: bounds")
        if not (bounds[0] < bounds[2] and bounds[1] < bounds[3]):
            raise InputError(f"world {name}: bounds must be x from, y from, x to, y to, got {list(bounds)}")
        groups = find_dynamic_obstacles(dynamic_obstacles, f"world {name}: dynamic_obstacles")
        world = cls(name, box_rows, post_rows, start, goal, bounds, description, groups)
        if goal is not None:
            x, y, _ = _numbers(goal, ("x", "y", "yaw"), f"world {name}: the goal")
            if not world.contains((x, y)) or world.clearance(x, y) == 0.0:
                where = "inside an obstacle" if world.contains((x, y)) else "outside its bounds"
                raise InputError(f"world {name}: the goal ({x:g}, {y:g}) is {where}")
        return world

    def with_places(self, start: Pose | None, goal: Pose | None, bounds: Bounds | None = None) -> World:
        """The same obstacles with another start, goal or bounds; None keeps the present one.

        Raises:
            InputError: If they are invalid, as for `from_shapes`.
        """
        if start is goal is bounds is None:
            return self
        return World.from_shapes(
            self.name,
            self.box_shapes,
            self.posts.tolist(),
            start=start or self.start,
            goal=goal or self.goal,
            bounds=bounds or self.bounds,
            description=self.description,
            dynamic_obstacles=self.dynamic_obstacles,
        )

    @property
    def box_shapes(self) -> list[BoxShape]:
        """The boxes as `from_shapes` takes them."""
        rows = self.boxes.tolist()
        return [(x, y, 2 * along, 2 * across, math.atan2(sin, cos)) for x, y, along, across, cos, sin in rows]

    @cached_property
    def index(self) -> WorldIndex:
        """Spatial index of the obstacles, for laser and clearance."""
        return index_of(self.boxes, self.posts)

    @property
    def obstacles(self) -> BaseGeometry:
        """Union of all obstacles."""
        return shapely.union_all(self.outlines())

    def outlines(self, beyond: float = 0.0, segments: int = 32) -> np.ndarray:
        """Polygons of the obstacles, shape (boxes + posts,).

        Args:
            beyond: Enlargement on all sides [m]; corners stay sharp.
            segments: Number of segments of a quarter circle.
        """
        larger = np.array([0.0, 0.0, beyond, beyond, 0.0, 0.0])
        return np.concatenate([box_polygons(self.boxes + larger), post_polygons(self.posts + larger[:3], segments)])

    def free_space(self, clearance: float) -> BaseGeometry:
        """Where a robot's centre can get to from the start, `clearance` [m] from every obstacle and the bounds.

        Raises:
            InputError: If the start itself has no such clearance.
        """
        if clearance not in self._free_spaces:
            start, bounds = shapely.Point(self.start[:2]), shapely.box(*self.bounds)
            space = bounds.buffer(-clearance).difference(self.obstacles.buffer(clearance, quad_segs=32))
            reachable = [part for part in shapely.get_parts(space) if part.intersects(start)]
            if not (bounds.covers(start) and reachable):
                raise self._start_error(clearance)
            self._free_spaces[clearance] = reachable[0]
        return self._free_spaces[clearance]

    def check_start(self, clearance: float) -> None:
        """Raise the error of `free_space` if the start has no such clearance [m], in a thousandth of its time."""
        (x, y, _), (x0, y0, x1, y1) = self.start, self.bounds
        if min(x - x0, x1 - x, y - y0, y1 - y, self.clearance(x, y)) < clearance - _ROUNDING:
            raise self._start_error(clearance)

    def _start_error(self, clearance: float) -> InputError:
        x, y, _ = self.start
        if not self.contains((x, y)):
            return InputError(f"world {self.name}: the start ({x:g}, {y:g}) is outside its bounds")
        return InputError(
            f"world {self.name}: the start ({x:g}, {y:g}) is inside a wall or nearer than {clearance:g} m to one, "
            f"so there is no free space around it; move it, or lower task.start_clearance if it is {clearance:g}"
        )

    def clearance(self, x: float, y: float) -> float:
        """Distance from a point to the nearest obstacle [m]; 0 inside one."""
        return clearance_at(x, y, self.index, 0)

    def contains(self, point: Point) -> bool:
        """Whether a point [m] is within the bounds."""
        x0, y0, x1, y1 = self.bounds
        return x0 <= point[0] <= x1 and y0 <= point[1] <= y1

    def random_poses(self, rng: np.random.Generator, count: int, clearance: float) -> np.ndarray:
        """Random poses, see `poses_from`, shape (count, 3)."""
        return self.poses_from(rng.random((count, 4)), clearance)

    def poses_from(self, draws: np.ndarray, clearance: float) -> np.ndarray:
        """Turn four random numbers in [0, 1) each into a pose, (count, 4) to (count, 3).

        The poses are spread evenly over a triangulation of the free space and all headings.
        """
        poses = np.empty((len(draws), 3))
        place_in_triangles(draws, *self._free_triangles(clearance), poses)
        return poses

    def _free_triangles(self, clearance: float) -> Triangles:
        if clearance not in self._triangles:
            parts = shapely.get_parts(shapely.constrained_delaunay_triangles(self.free_space(clearance)))
            corners = np.array([part.exterior.coords[:3] for part in parts])
            self._triangles[clearance] = corners, np.cumsum(shapely.area(parts)) / shapely.area(parts).sum()
        return self._triangles[clearance]


def box_polygons(rows: np.ndarray) -> np.ndarray:
    """Polygons of rows of `World.boxes`, shape (n,)."""
    x, y, half_length, half_width, cos, sin = rows.T
    along, across = half_length * np.array([cos, sin]), half_width * np.array([-sin, cos])
    corners = np.array([along + across, across - along, -along - across, along - across])
    return shapely.polygons(np.moveaxis(corners + np.array([x, y]), 2, 0))


def post_polygons(rows: np.ndarray, segments: int = 32) -> np.ndarray:
    """Polygons of rows of `World.posts`, off by less than 1 mm per metre of radius with 32 segments; shape (n,)."""
    return shapely.buffer(shapely.points(rows[:, :2]), rows[:, 2], quad_segs=segments)


def _shapes(shapes: Iterable[Iterable[float]], kind: str, names: Sequence[str], world: str) -> list[list[float]]:
    """Shapes as lists of numbers, with sizes above 0."""
    checked = []
    for number, shape in enumerate(shapes):
        where = f"world {world}: {kind} {number} (the first is 0)"
        checked.append(_numbers(shape, names, where))
        for name, value in zip(names, checked[-1], strict=True):
            if name in ("length", "width", "radius") and not value > 0:
                raise InputError(f"{where} must have a {name} above 0, got {value:g}")
    return checked


def _numbers(values: Any, names: Sequence[str], where: str) -> list[float]:
    try:
        numbers = np.array(values, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (len(names),) or not np.isfinite(numbers).all():
        raise InputError(one_line(f"{where} must be {len(names)} numbers, {', '.join(names)}; got {values!r}"))
    return numbers.tolist()


def _box_rows(boxes: Iterable[Sequence[float]]) -> np.ndarray:
    """Rows of `World.boxes`, turned by 45 degrees at most, and sorted by orientation.

    A box turned by a quarter is the same box with its sides swapped. So the walls of a rectangular maze share one
    orientation, and the laser needs the beam directions in it only once.
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


def _extent(boxes: np.ndarray, posts: np.ndarray, name: str) -> Bounds:
    shapes = [*box_polygons(boxes), *post_polygons(posts)]
    if not shapes:
        raise InputError(f"world {name}: without obstacles it needs `bounds: [x from, y from, x to, y to]`")
    x0, y0, x1, y1 = shapely.total_bounds(shapes).tolist()
    return x0, y0, x1, y1
