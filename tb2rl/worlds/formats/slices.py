"""Solid shapes cut by a horizontal plane: what a laser at that height sees of them, as boxes and posts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.errors import InputError
from tb2rl.worlds.formats.cells import merge_cells
from tb2rl.worlds.world import BoxShape, PostShape, box_shape

SHEET = 0.01  # [m] thickness of a wall that is drawn as a line, and of one along an outline at least
_HALVED = 16  # times, to find how deep a wall fits into an outline
_HOLE = 0.05  # [m] radius of what is filled within an outline
_GAP = 1e-6  # [m] of rounding
_MOST_CORNERS = 2000  # of an outline; a round one of 1 m has 50
_FLAT = 1e-6  # a shape turned by less [rad] stands upright; a corner nearer to the plane [m] lies in it
STRAIGHT = 0.002  # [m] an outline is drawn with as few corners as stay this near to it
_SIDES = 48  # of the prism that stands for a tilted cylinder: off by 0.2 % of its radius
_FILLED = 16  # cells along the longer side of an outline that is filled

Side = Literal["met", "below", "above"]  # whether the plane meets a shape, or else where the shape is


@dataclass
class Slice:
    """What stands in the plane, so far."""

    height: float  # [m] of the plane over the floor
    boxes: list[BoxShape] = field(default_factory=list)
    posts: list[PostShape] = field(default_factory=list)

    def side(self, low: float, high: float) -> Side:
        """Where a shape from `low` to `high` [m] is."""
        return "above" if low >= self.height else "below" if high <= self.height else "met"

    def add_sphere(self, pose: np.ndarray, radius: float) -> Side:
        """Add a sphere. `pose` is (4, 4) here and below; what comes back is where the shape is."""
        x, y, z = pose[:3, 3]
        if (side := self.side(z - radius, z + radius)) == "met":
            self.posts.append((x, y, math.sqrt(radius**2 - (z - self.height) ** 2)))
        return side

    def add_cylinder(self, pose: np.ndarray, radius: float, length: float) -> Side:
        """Add a cylinder along its own z."""
        if upright(pose):
            x, y, z = pose[:3, 3]
            if (side := self.side(z - length / 2, z + length / 2)) == "met":
                self.posts.append((x, y, radius))
            return side
        angles = np.arange(_SIDES) * math.tau / _SIDES
        outline = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return self.add_prism(pose, outline, -length / 2, length / 2)

    def add_prism(self, pose: np.ndarray, outline: np.ndarray, low: float, high: float) -> Side:
        """Add a convex outline (corners, 2) [m], drawn out along its own z from `low` to `high` [m]."""
        ends = [
            np.column_stack([outline, np.full(len(outline), z)]) @ pose[:3, :3].T + pose[:3, 3] for z in (low, high)
        ]
        heights = np.concatenate(ends)[:, 2]
        if (side := self.side(heights.min(), heights.max())) == "met":
            edges = [(end, np.roll(end, -1, axis=0)) for end in ends] + [(ends[0], ends[1])]
            begins, stops = (np.concatenate(points) for points in zip(*edges, strict=True))
            self.add_outline(shapely.MultiPoint(_crossings(begins, stops, self.height)).convex_hull)
        return side

    def add_outline(self, shape: BaseGeometry) -> None:
        """Add polygons: a rectangle as one box, any other by walls within its outline, and boxes that fill it."""
        simple = shapely.simplify(shape, STRAIGHT)
        if shapely.get_num_coordinates(simple) > _MOST_CORNERS:
            raise InputError(f"its outline has more than {_MOST_CORNERS} corners")
        for part in shapely.get_parts(simple):
            if part.area <= 0:
                continue
            rectangle = shapely.oriented_envelope(part)
            if part.area >= rectangle.area * (1 - 1e-6):
                self.boxes.append(_box_along(rectangle.exterior.coords[:3]))
                continue
            walls = _walls_within(part)
            self.boxes += walls
            for rest in shapely.get_parts(part.difference(shapely.union_all([_polygon(wall) for wall in walls]))):
                if rest.area > 0 and shapely.maximum_inscribed_circle(rest, tolerance=0.01).length > _HOLE:
                    self.boxes += _fill(rest)

    def add_sheets(self, lines: Iterable[Sequence[Sequence[float]]]) -> None:
        """Add lines of points as thin walls to the left of them: what is known of a body that is not closed."""
        for line in lines:
            self.boxes += _sheets(line)


def upright(pose: np.ndarray) -> bool:
    """Whether the own z of something at a pose is vertical, up or down."""
    return math.hypot(pose[0, 2], pose[1, 2]) < _FLAT


def _crossings(begins: np.ndarray, ends: np.ndarray, height: float) -> np.ndarray:
    """Where edges between points (edges, 3) meet a horizontal plane, shape (points, 2)."""
    from_plane, to_plane = begins[:, 2] - height, ends[:, 2] - height
    crossing = from_plane * to_plane < 0
    share = (from_plane[crossing] / (from_plane[crossing] - to_plane[crossing]))[:, None]
    points = begins[crossing] + share * (ends[crossing] - begins[crossing])
    within = begins[np.abs(from_plane) < _FLAT]
    return np.concatenate([points, within])[:, :2]


def _box_along(corners: Sequence[Sequence[float]]) -> BoxShape:
    """The box of three corners of a rectangle, one after the other."""
    (x0, y0), (x1, y1), (x2, y2) = corners
    length, width = math.hypot(x1 - x0, y1 - y0), math.hypot(x2 - x1, y2 - y1)
    return (x0 + x2) / 2, (y0 + y2) / 2, length, width, math.atan2(y1 - y0, x1 - x0)


def _walls_within(part: shapely.Polygon) -> list[BoxShape]:
    """A box along each edge of a polygon, as deep as it stays within it, but `SHEET` deep at least."""
    walls: list[BoxShape] = []
    room = part.buffer(_GAP)
    shapely.prepare(room)
    oriented = shapely.orient_polygons(part)  # the inside is to the left of every edge, of holes too
    for ring in (oriented.exterior, *oriented.interiors):
        for edge in pairwise(ring.coords):
            low, high = SHEET, max(part.bounds[2] - part.bounds[0], part.bounds[3] - part.bounds[1])
            for _ in range(_HALVED):
                middle = (low + high) / 2
                low, high = (middle, high) if room.covers(_polygon(_wall(edge, middle))) else (low, middle)
            walls.append(_wall(edge, low))
    return walls


def _wall(edge: tuple[Sequence[float], Sequence[float]], depth: float) -> BoxShape:
    """A box to the left of an edge."""
    (x0, y0), (x1, y1) = edge
    length = math.hypot(x1 - x0, y1 - y0)
    left_x, left_y = (y0 - y1) / length * depth / 2, (x1 - x0) / length * depth / 2
    return (x0 + x1) / 2 + left_x, (y0 + y1) / 2 + left_y, length, depth, math.atan2(y1 - y0, x1 - x0)


def _polygon(box: BoxShape) -> BaseGeometry:
    x, y, length, width, yaw = box
    return box_shape(np.array([x, y, length / 2, width / 2, math.cos(yaw), math.sin(yaw)]))


def _sheets(points: Sequence[Sequence[float]]) -> list[BoxShape]:
    """A thin wall along each piece of a line."""
    pieces = [(begin[:2], end[:2]) for begin, end in pairwise(points) if begin[:2] != end[:2]]
    return [_wall(((x0, y0), (x1, y1)), SHEET) for (x0, y0), (x1, y1) in pieces]


def _fill(part: shapely.Polygon) -> list[BoxShape]:
    """Boxes within a polygon, so that its inside is no floor: the laser never sees them."""
    x0, y0, x1, y1 = part.bounds
    side = max(x1 - x0, y1 - y0) / _FILLED
    columns, rows = max(1, math.ceil((x1 - x0) / side)), max(1, math.ceil((y1 - y0) / side))
    left, bottom = np.meshgrid(x0 + side * np.arange(columns), y0 + side * np.arange(rows))
    cells = shapely.box(left, bottom, left + side, bottom + side)
    shapely.prepare(part)
    return merge_cells(shapely.contains(part, cells), side, (x0, y0, 0.0))
