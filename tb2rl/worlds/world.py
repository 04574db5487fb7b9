"""Worlds: obstacles, free space, start and goal.

Obstacles are oriented boxes and round posts, in two tables that laser, physics and renderers share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import Point, Pose
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles, parse_dynamic_obstacles
from tb2rl.worlds.geometry import clearance_at, sample_in_triangles
from tb2rl.worlds.spatial_index import SpatialIndex, build_index

WALL_HEIGHT = 0.5  # [m] higher than the laser, but low enough for views from above
_BOX_NAMES, _POST_NAMES, _POSE_NAMES = ("x", "y", "length", "width", "yaw"), ("x", "y", "radius"), ("x", "y", "yaw")
_SIZES = ("length", "width", "radius")  # names of numbers that must be above 0

BoxShape = tuple[float, float, float, float, float]  # x, y, length, width [m], yaw [rad]
PostShape = tuple[float, float, float]  # x, y, radius [m]
Bounds = tuple[float, float, float, float]  # min x, min y, max x, max y [m]


@dataclass(frozen=True, eq=False)
class World:
    """Obstacles, start and goal of a world.

    The constructor checks goal and bounds, `check_start` the room at the start, and `from_shapes` the shapes.

    Attributes:
        boxes: Rows of x, y, half length, half width [m], cos(yaw), sin(yaw), shape (boxes, 6).
        posts: Rows of x, y, radius [m] of circles, shape (posts, 3).
        start: Start pose x [m], y [m], yaw [rad]; start poses that a task draws are reachable from it.
        goal: Goal pose; None: the world has no goal.
        bounds: Rectangle of the world.
        description: One line for the user.
    """

    name: str
    boxes: np.ndarray
    posts: np.ndarray
    start: Pose
    goal: Pose | None
    bounds: Bounds
    description: str = ""
    dynamic_obstacles: tuple[DynamicObstacles, ...] = ()
    # Caches by clearance: the free space, and its triangles as arguments of `sample_in_triangles`.
    _free_spaces: dict[float, BaseGeometry] = field(default_factory=dict, init=False, repr=False)
    _triangles: dict[float, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, init=False, repr=False)

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
            boxes: x, y of the centre, length, width [m] and yaw [rad] of each box.
            posts: x, y and radius [m] of each post.
            start, goal: See `World`.
            bounds: Rectangle of the world; None: the bounding box of the obstacles.
            description: One line for the user.
            dynamic_obstacles: A list of groups, see `parse_dynamic_obstacles`.

        Raises:
            InputError: If there are neither obstacles nor bounds, a value is invalid, or the goal is outside the bounds
                or in an obstacle.
        """
        owner = f"world {name}"
        box_rows, post_rows = _box_rows(_shape_table(boxes, "box", owner)), _shape_table(posts, "post", owner)
        if bounds is None:
            if not (len(box_rows) or len(post_rows)):
                raise InputError(f"{owner}: without obstacles it needs `bounds: [x from, y from, x to, y to]`")
            bounds = tuple(shapely.total_bounds([*box_polygons(box_rows), *post_polygons(post_rows)]).tolist())
        groups = parse_dynamic_obstacles(dynamic_obstacles, f"{owner}: dynamic_obstacles")
        return cls(name, box_rows, post_rows, start, goal, bounds, description, groups)

    def __post_init__(self) -> None:
        owner = f"world {self.name}"
        _parse_numbers(self.start, _POSE_NAMES, f"{owner}: the start")
        x0, y0, x1, y1 = _parse_numbers(self.bounds, ("x from", "y from", "x to", "y to"), f"{owner}: bounds")
        if not (x0 < x1 and y0 < y1):
            raise InputError(f"{owner}: bounds must be x from < x to, y from < y to, got {[x0, y0, x1, y1]}")
        if self.goal is not None:
            x, y, _ = _parse_numbers(self.goal, _POSE_NAMES, f"{owner}: the goal")
            if not self.contains((x, y)):
                raise InputError(f"{owner}: the goal ({x:g}, {y:g}) is outside the bounds")
            if self.clearance(x, y) == 0.0:
                raise InputError(f"{owner}: the goal ({x:g}, {y:g}) is inside an obstacle")

    def with_changes(self, start: Pose | None, goal: Pose | None, bounds: Bounds | None = None) -> World:
        """Copy the world with another start, goal or bounds; None keeps the present value.

        Raises:
            InputError: If a value is invalid, as for `from_shapes`.
        """
        return replace(self, start=start or self.start, goal=goal or self.goal, bounds=bounds or self.bounds)

    @cached_property
    def spatial_index(self) -> SpatialIndex:
        """Spatial index of the obstacles, for laser and clearance."""
        return build_index(self.boxes, self.posts)

    @property
    def obstacles(self) -> BaseGeometry:
        """Union of all obstacles."""
        return shapely.union_all(self.outlines())

    def outlines(self, margin: float = 0.0, segments: int = 32) -> np.ndarray:
        """Polygons of the obstacles, shape (boxes + posts,).

        Args:
            margin: Enlargement on all sides [m]; corners of boxes stay sharp.
            segments: Number of segments of a quarter circle.
        """
        margins = np.array([0.0, 0.0, margin, margin, 0.0, 0.0])  # the first three also fit posts: x, y, radius
        return np.concatenate([box_polygons(self.boxes + margins), post_polygons(self.posts + margins[:3], segments)])

    def free_space(self, clearance: float) -> BaseGeometry:
        """Region that is reachable from the start with a clearance [m] from all obstacles and the bounds.

        Raises:
            InputError: If the start has less clearance.
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
        """Raise the `InputError` of `free_space` if the start has less clearance [m]; 1000 times faster than that."""
        (x, y, _), (x0, y0, x1, y1) = self.start, self.bounds
        if min(x - x0, x1 - x, y - y0, y1 - y, self.clearance(x, y)) < clearance - 1e-9:  # rounding errors
            raise self._start_error(clearance)

    def _start_error(self, clearance: float) -> InputError:
        x, y, _ = self.start
        if not self.contains((x, y)):
            return InputError(f"world {self.name}: the start ({x:g}, {y:g}) is outside the bounds")
        return InputError(
            f"world {self.name}: the start ({x:g}, {y:g}) is inside a wall or nearer than {clearance:g} m to a wall or "
            f"bound, so there is no free space; move the start, or lower task.start_clearance if that is {clearance:g}"
        )

    def clearance(self, x: float, y: float) -> float:
        """Distance from a point to the nearest obstacle [m]; 0 inside an obstacle."""
        return clearance_at(x, y, self.spatial_index, 0)  # 0: the only world of its index

    def contains(self, point: Point) -> bool:
        """Whether a point [m] is within the bounds."""
        x0, y0, x1, y1 = self.bounds
        return x0 <= point[0] <= x1 and y0 <= point[1] <= y1

    def sample_poses(self, random_numbers: np.ndarray, clearance: float) -> np.ndarray:
        """Sample poses uniformly in the free space.

        Args:
            random_numbers: Uniform in [0, 1), such as `rng.random((count, 4))`, shape (count, 4).
            clearance: Minimum distance to obstacles and bounds [m].

        Returns:
            x [m], y [m], yaw [rad], shape (count, 3).
        """
        if clearance not in self._triangles:
            parts = shapely.get_parts(shapely.constrained_delaunay_triangles(self.free_space(clearance)))
            corners = np.array([part.exterior.coords[:3] for part in parts])
            self._triangles[clearance] = corners, np.cumsum(shapely.area(parts)) / shapely.area(parts).sum()
        poses = np.empty((len(random_numbers), 3))
        sample_in_triangles(random_numbers, *self._triangles[clearance], poses)
        return poses


def box_polygons(rows: np.ndarray) -> np.ndarray:
    """Polygons of rows of `World.boxes`, shape (n,)."""
    x, y, half_length, half_width, cos, sin = rows.T
    along, across = half_length * np.array([cos, sin]), half_width * np.array([-sin, cos])
    corners = np.array([along + across, across - along, -along - across, along - across])
    return shapely.polygons(np.moveaxis(corners + np.array([x, y]), 2, 0))


def post_polygons(rows: np.ndarray, segments: int = 32) -> np.ndarray:
    """Polygons of rows of `World.posts`, shape (n,); with 32 segments, the error is below 0.1 % of the radius."""
    return shapely.buffer(shapely.points(rows[:, :2]), rows[:, 2], quad_segs=segments)


def _shape_table(shapes: Iterable[Iterable[float]], shape_name: str, owner: str) -> np.ndarray:
    """Table of boxes or posts, with a row for each shape."""
    columns, shapes = _BOX_NAMES if shape_name == "box" else _POST_NAMES, list(shapes)
    with suppress(TypeError, ValueError):  # all at once, because generated worlds have thousands of shapes
        table = np.array(shapes, dtype=float)
        sizes = [name in _SIZES for name in columns]
        if table.shape == (len(shapes), len(columns)) and np.isfinite(table).all() and (table[:, sizes] > 0).all():
            return table
    label = f"{owner}: {shape_name}"
    rows = [_parse_numbers(shape, columns, f"{label} {i} (the first is 0)") for i, shape in enumerate(shapes)]
    return np.array(rows).reshape(-1, len(columns))


def _parse_numbers(values: Any, names: Sequence[str], label: str) -> list[float]:
    """Parse finite numbers with these names, above 0 for sizes; `label` names the values in messages."""
    try:
        numbers = np.array(values, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (len(names),) or not np.isfinite(numbers).all():
        raise InputError(one_line(f"{label} must be {len(names)} numbers, {', '.join(names)}; got {values!r}"))
    for name, number in zip(names, numbers, strict=True):
        if name in _SIZES and number <= 0:
            raise InputError(f"{label} must have a {name} above 0, got {number:g}")
    return numbers.tolist()


def _box_rows(boxes: np.ndarray) -> np.ndarray:
    """Convert rows of `BoxShape` to rows of `World.boxes`, with yaws within 45 degrees and sorted by yaw.

    A box with a yaw of 90 degrees becomes a box of yaw 0 with swapped sides. So all walls of a rectangular maze share
    one yaw, and the laser transforms its beam directions only once.
    """
    quarters = np.round(boxes[:, 4] / (math.pi / 2))
    yaw = boxes[:, 4] - quarters * math.pi / 2
    yaw[np.abs(yaw) <= 1e-12] = 0.0
    half_sides = np.where(quarters[:, None] % 2 == 1, boxes[:, [3, 2]], boxes[:, [2, 3]]) / 2
    rows = np.column_stack([yaw, boxes[:, :2], half_sides])
    rows = rows[np.lexsort(rows.T[::-1])]
    return np.column_stack([rows[:, 1:], np.cos(rows[:, 0]), np.sin(rows[:, 0])])
