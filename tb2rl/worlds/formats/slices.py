"""Solid shapes cut by a horizontal plane at the height of the laser, as boxes and posts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.cells import merge_cells
from tb2rl.worlds.world import BoxShape, PostShape

SHEET = 0.01  # [m] thickness of a wall known as a line only, and least thickness of one along an outline
STRAIGHT = 0.002  # [m] tolerance to which outlines are simplified
_HALVED = 16  # bisections of the thickness of a wall within an outline
_HOLE = 0.05  # [m] radius of holes that are filled within an outline
_GAP = 1e-6  # [m] of rounding
_MOST_CORNERS = 2000  # of an outline; a round one of 1 m has 50
_FLAT = 1e-6  # a shape tilted by less [rad] is upright; a corner nearer to the plane [m] is in it
_SIDES = 48  # of the prism that approximates a tilted cylinder: off by 0.2 % of its radius
_FILLED = 16  # cells along the longer side of a hole that is filled


class LeftOut(Exception):  # noqa: N818 (no error: the rest of the world is read)
    """A shape that makes no obstacle: the reason, and a detail that names it."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(reason)
        self.detail = detail


class OutOfPlane(LeftOut):
    """A shape above or below the plane."""


@dataclass
class Slice:
    """The obstacles in the plane; poses are matrices (4, 4).

    All `add_` methods of solids raise `OutOfPlane` if the plane does not meet the shape.
    """

    height: float  # [m] of the plane above the floor
    boxes: list[BoxShape] = field(default_factory=list)
    posts: list[PostShape] = field(default_factory=list)

    def check_height(self, low: float, high: float) -> None:
        """Raise `OutOfPlane` unless the plane meets a shape from `low` to `high` [m]."""
        if not low < self.height < high:
            side = "above" if low >= self.height else "below"
            raise OutOfPlane(f"left out, for they are {side} the laser (at {self.height:g} m)")

    def add_sphere(self, pose: np.ndarray, radius: float) -> None:
        """Add a sphere."""
        x, y, z = pose[:3, 3]
        self.check_height(z - radius, z + radius)
        self.posts.append((x, y, math.sqrt(radius**2 - (z - self.height) ** 2)))

    def add_cylinder(self, pose: np.ndarray, radius: float, length: float) -> None:
        """Add a cylinder along its own z."""
        if not upright(pose):
            angles = np.arange(_SIDES) * math.tau / _SIDES
            outline = radius * np.column_stack([np.cos(angles), np.sin(angles)])
            self.add_prisms(pose, [outline], -length / 2, length / 2)
            return
        x, y, z = pose[:3, 3]
        self.check_height(z - length / 2, z + length / 2)
        self.posts.append((x, y, radius))

    def add_box(self, pose: np.ndarray, half: np.ndarray) -> None:
        """Add a box with these half sides [m]."""
        x, y, z = half.tolist()
        if not upright(pose):
            self.add_prisms(pose, [np.array([[-x, -y], [x, -y], [x, y], [-x, y]])], -z, z)
            return
        self.check_height(pose[2, 3] - z, pose[2, 3] + z)
        self.boxes.append((pose[0, 3], pose[1, 3], 2 * x, 2 * y, math.atan2(pose[1, 0], pose[0, 0])))

    def add_prisms(self, pose: np.ndarray, outlines: Sequence[np.ndarray], low: float, high: float) -> None:
        """Add touching prisms with convex outlines (corners, 2) [m], from `low` to `high` [m] along their own z."""
        edges = []
        for outline in outlines:
            bottom, top = (
                np.column_stack([outline, np.full(len(outline), z)]) @ pose[:3, :3].T + pose[:3, 3] for z in (low, high)
            )
            begins = np.concatenate([bottom, top, bottom])
            edges.append((begins, np.concatenate([np.roll(bottom, -1, axis=0), np.roll(top, -1, axis=0), top])))
        heights = np.concatenate([begins[:, 2] for begins, _ in edges])
        self.check_height(heights.min(), heights.max())
        hulls = [shapely.MultiPoint(_crossings(*ends, self.height)).convex_hull for ends in edges]
        self.add_outline(hulls[0] if len(hulls) == 1 else shapely.union_all(hulls, grid_size=_GAP))

    def add_outline(self, shape: BaseGeometry) -> None:
        """Add polygons: a rectangle as one box, any other as walls within its outline, and boxes that fill it."""
        simple = shapely.simplify(shape, STRAIGHT)
        if shapely.get_num_coordinates(simple) > _MOST_CORNERS:
            raise InputError(f"its outline has more than {_MOST_CORNERS} corners")
        for part in shapely.get_parts(simple):
            if part.area > 0:
                x, y = part.exterior.coords[0]
                moved = shapely.transform(part, lambda points, corner=(x, y): np.round(points - corner, 9))
                self.boxes += [(x + box[0], y + box[1], *box[2:]) for box in _boxes(moved.wkb)]

    def add_sheets(self, lines: Iterable[Sequence[Sequence[float]]]) -> None:
        """Add lines of points as thin walls to the left of them: the surface of a body that is not closed."""
        for line in lines:
            points = np.array(line)[:, :2]
            begins, ends = points[:-1], points[1:]
            longer = (begins != ends).any(axis=1)
            begins, ends = begins[longer], ends[longer]
            self.boxes += _walls(begins, ends, np.full(len(begins), SHEET))


def upright(pose: np.ndarray) -> bool:
    """Whether the own z axis at a pose is vertical, up or down."""
    return math.hypot(pose[0, 2], pose[1, 2]) < _FLAT


def _crossings(begins: np.ndarray, ends: np.ndarray, height: float) -> np.ndarray:
    """Intersections of edges between points (edges, 3) with a horizontal plane, shape (points, 2)."""
    from_plane, to_plane = begins[:, 2] - height, ends[:, 2] - height
    crossing = from_plane * to_plane < 0
    share = (from_plane[crossing] / (from_plane[crossing] - to_plane[crossing]))[:, None]
    points = begins[crossing] + share * (ends[crossing] - begins[crossing])
    within = begins[np.abs(from_plane) < _FLAT]
    return np.concatenate([points, within])[:, :2]


@lru_cache(maxsize=1000)  # many worlds have copies of one thing
def _boxes(polygon: bytes) -> list[BoxShape]:
    """Boxes for a polygon in WKB."""
    part = shapely.from_wkb(polygon)
    rectangle = shapely.oriented_envelope(part)
    if part.area >= rectangle.area * (1 - 1e-6):
        (x0, y0), (x1, y1), (x2, y2) = rectangle.exterior.coords[:3]
        length, width = math.hypot(x1 - x0, y1 - y0), math.hypot(x2 - x1, y2 - y1)
        return [((x0 + x2) / 2, (y0 + y2) / 2, length, width, math.atan2(y1 - y0, x1 - x0))]
    oriented = shapely.orient_polygons(part)  # with the inside to the left of each edge, of holes too
    rings = [np.array(ring.coords) for ring in (oriented.exterior, *oriented.interiors)]
    begins, ends = np.concatenate([ring[:-1] for ring in rings]), np.concatenate([ring[1:] for ring in rings])
    depths = _depths(part, begins, ends)
    boxes = list(_walls(begins, ends, depths))
    walls = shapely.union_all(_strips(begins, ends, depths))
    for rest in shapely.get_parts(part.difference(walls)):
        if rest.area > 0 and shapely.maximum_inscribed_circle(rest, tolerance=0.01).length > _HOLE:
            boxes += _fill(rest)
    return boxes


def _depths(part: shapely.Polygon, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Thickness of the thickest wall along each edge that fits into a polygon [m], at least `SHEET`; shape (edges,)."""
    room = part.buffer(_GAP)
    shapely.prepare(room)
    low, high = np.full(len(begins), SHEET), np.full(len(begins), np.ptp(begins, axis=0).max())
    for _ in range(_HALVED):
        middle = (low + high) / 2
        fits = shapely.covers(room, _strips(begins, ends, middle))
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return low


def _strips(begins: np.ndarray, ends: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Rectangles to the left of the edges between points (edges, 2), shape (edges,)."""
    along = ends - begins
    left = along[:, ::-1] * (-1.0, 1.0) * (depths / np.hypot(*along.T))[:, None]
    return shapely.polygons(np.stack([begins, ends, ends + left, begins + left], axis=1))


def _walls(begins: np.ndarray, ends: np.ndarray, depths: np.ndarray) -> Iterator[BoxShape]:
    """The same rectangles as boxes."""
    for (x0, y0), (x1, y1), depth in zip(begins.tolist(), ends.tolist(), depths.tolist(), strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        left_x, left_y = (y0 - y1) / length * depth / 2, (x1 - x0) / length * depth / 2
        yield (x0 + x1) / 2 + left_x, (y0 + y1) / 2 + left_y, length, depth, math.atan2(y1 - y0, x1 - x0)


def _fill(part: shapely.Polygon) -> list[BoxShape]:
    """Boxes within a polygon, so that its inside is no floor; the laser never sees them."""
    x0, y0, x1, y1 = part.bounds
    side = max(x1 - x0, y1 - y0) / _FILLED
    columns, rows = max(1, math.ceil((x1 - x0) / side)), max(1, math.ceil((y1 - y0) / side))
    left, bottom = x0 + side * np.arange(columns), y0 + side * np.arange(rows)[:, None]
    cells = shapely.box(left, bottom, left + side, bottom + side)
    shapely.prepare(part)
    return merge_cells(shapely.contains(part, cells), side, (x0, y0, 0.0))
