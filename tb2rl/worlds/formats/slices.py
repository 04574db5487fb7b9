"""Cross-sections of solid shapes and meshes in the horizontal plane of the laser, as boxes and posts."""

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import install_extra, one_line
from tb2rl.worlds.formats.imports import mean_overlaps
from tb2rl.worlds.formats.markup import read_limited, read_xml
from tb2rl.worlds.occupancy_grid import merge_cells
from tb2rl.worlds.world import BoxShape, PostShape

_OUTLINE_TOLERANCE = 0.002  # [m] for the simplification of outlines
_MIN_THICKNESS = 0.01  # [m] minimum thickness of a wall; also the thickness of an open surface
_THICKNESS_BISECTIONS = 16  # steps in the search for the thickest wall inside an outline
_MIN_CORE = 0.05  # [m] radius of the smallest core of a solid, between its walls, that is filled
_CORE_CELLS = 16  # grid cells along the longer side of a filled core
_EPSILON = 1e-6  # [m] tolerance for rounding errors
_MAX_TILT = 1e-6  # [rad] maximum tilt of an upright shape
_PLANE_TOLERANCE = 1e-6  # [m] corners within this distance of the plane count as in the plane
_CYLINDER_SIDES = 48  # sides of the prism that replaces a tilted cylinder; the error is 0.2 % of the radius
_MESH_EXTENSIONS = (".dae", ".obj", ".stl")  # of Gazebo's meshes; referenced files, such as textures, hold no shapes
_MESH_GRID = 1e-5  # [m] end points of lines are rounded to this grid, so that adjacent lines meet
_MAX_LINES = 30_000  # limit of the number of lines in a cut
_MAX_OVERLAPS = 40  # limit of the mean number of lines whose bounding boxes overlap that of a line
_ROBOT_RADIUS = 0.25  # [m] in a cut of an open body, a region with room for a robot of this radius is not solid


class OmittedShape(Exception):  # noqa: N818 (not an error, because the rest of the world is read)
    """A shape is omitted from the world; the text describes all shapes with the same reason."""


@dataclass
class Slice:
    """Collects the obstacles in a horizontal plane; a solid that misses the plane raises `OmittedShape`.

    Poses are homogeneous transforms, shape (4, 4).
    """

    height: float  # [m] height of the plane above the floor
    boxes: list[BoxShape] = field(default_factory=list)
    posts: list[PostShape] = field(default_factory=list)

    def check_height(self, low: float, high: float) -> None:
        """Raise `OmittedShape` unless the plane is between `low` and `high` [m]."""
        if not low < self.height < high:
            side = "above" if low >= self.height else "below"
            raise OmittedShape(f"omitted, because they are {side} the laser (at {self.height:g} m)")

    def add_sphere(self, pose: np.ndarray, radius: float) -> None:
        x, y, z = pose[:3, 3]
        self.check_height(z - radius, z + radius)
        self.posts.append((x, y, math.sqrt(radius**2 - (z - self.height) ** 2)))

    def add_cylinder(self, pose: np.ndarray, radius: float, length: float) -> None:
        """Add a cylinder whose axis is the z axis of the pose."""
        if not is_upright(pose):
            angles = np.arange(_CYLINDER_SIDES) * math.tau / _CYLINDER_SIDES
            self.add_prisms(pose, [radius * np.column_stack([np.cos(angles), np.sin(angles)])], -length / 2, length / 2)
            return
        x, y, z = pose[:3, 3]
        self.check_height(z - length / 2, z + length / 2)
        self.posts.append((x, y, radius))

    def add_box(self, pose: np.ndarray, half_extents: np.ndarray) -> None:
        """Add a box with half extents [m], shape (3,)."""
        x, y, z = half_extents.tolist()
        if not is_upright(pose):
            self.add_prisms(pose, [np.array([[-x, -y], [x, -y], [x, y], [-x, y]])], -z, z)
            return
        self.check_height(pose[2, 3] - z, pose[2, 3] + z)
        self.boxes.append((pose[0, 3], pose[1, 3], 2 * x, 2 * y, math.atan2(pose[1, 0], pose[0, 0])))

    def add_prisms(self, pose: np.ndarray, outlines: Sequence[np.ndarray], low: float, high: float) -> None:
        """Add the union of touching prisms.

        Args:
            pose: The common pose of the prisms.
            outlines: A convex outline [m] of each prism, shape (corners, 2).
            low, high: Ends of the prisms on the z axis of the pose [m].
        """
        sections, heights = [], []
        for outline in outlines:
            bottom, top = (
                np.column_stack([outline, np.full(len(outline), z)]) @ pose[:3, :3].T + pose[:3, 3] for z in (low, high)
            )
            starts = np.concatenate([bottom, top, bottom])
            ends = np.concatenate([np.roll(bottom, -1, axis=0), np.roll(top, -1, axis=0), top])
            heights += starts[:, 2].tolist()
            sections.append(shapely.MultiPoint(_intersect(starts, ends, self.height)).convex_hull)
        self.check_height(min(heights), max(heights))
        self.add_polygons(sections[0] if len(sections) == 1 else shapely.union_all(sections, grid_size=_EPSILON))

    def add_polygons(self, shape: BaseGeometry) -> None:
        """Add polygons: a rectangle as one box, others as walls along the edges, with boxes in the core."""
        for part in shapely.get_parts(shapely.simplify(shape, _OUTLINE_TOLERANCE)):
            if part.area > 0:
                x, y = part.exterior.coords[0]
                # Coordinates are relative to a corner, so that copies of a polygon have the same key in the cache.
                relative = shapely.transform(part, lambda points, corner=(x, y): np.round(points - corner, 9))
                self.boxes += [(x + box[0], y + box[1], *box[2:]) for box in _divide_into_boxes(relative.wkb)]

    def add_mesh(self, mesh: Any, pose: np.ndarray, scale: np.ndarray) -> None:
        """Add a mesh from `load_mesh`, with a scale (3,); open surfaces that the plane cuts become thin walls."""
        import trimesh

        placed = mesh.copy()
        placed.apply_transform(pose @ np.diag([*scale, 1.0]))
        self.check_height(*placed.bounds[:, 2])
        segments = trimesh.intersections.mesh_plane(placed, (0.0, 0.0, 1.0), (0.0, 0.0, self.height))
        lines = shapely.linestrings(segments[:, :, :2])
        if len(lines) > _MAX_LINES or mean_overlaps(lines) > _MAX_OVERLAPS:  # their union would take hours
            raise OmittedShape("meshes that are too fine, or whose faces cut each other everywhere")
        cut_lines = shapely.union_all(lines, grid_size=_MESH_GRID)
        regions = shapely.get_parts(shapely.polygonize([cut_lines]))
        body = shapely.union_all([part for part in regions if _is_solid(part, cut_lines, bool(placed.is_watertight))])
        self.add_polygons(body)
        open_lines = shapely.line_merge(cut_lines.difference(body.buffer(2 * _MESH_GRID)))
        for line in shapely.get_parts(shapely.simplify(open_lines, _OUTLINE_TOLERANCE)):
            points = np.array(line.coords)
            has_length = np.diff(points, axis=0).any(axis=1)
            starts, ends = points[:-1][has_length], points[1:][has_length]
            self.boxes += _walls(starts, ends, np.full(len(starts), _MIN_THICKNESS))


def load_mesh(path: Path) -> Any:
    """Load a mesh with trimesh, in metres.

    Raises:
        OmittedShape: If the file cannot be read as a mesh, or trimesh is missing.
        InputError: If a .dae file is too large, is not XML, or declares a document type.
    """
    extension = path.suffix.lower()
    if extension not in _MESH_EXTENSIONS:
        raise OmittedShape(f"unsupported mesh formats, other than {', '.join(_MESH_EXTENSIONS)}")
    try:
        import collada  # noqa: F401 (trimesh needs it for .dae)
        import trimesh
    except ImportError:
        raise OmittedShape(f"meshes need the extra `meshes`: {install_extra('meshes')}") from None
    # `read_xml` raises an error for entities, which the parser of trimesh would expand.
    unit = read_xml(path).find("{*}asset/{*}unit") if extension == ".dae" else None
    try:
        file = io.BytesIO(read_limited(path))
        mesh: Any = trimesh.load(file, file_type=extension[1:], force="mesh", skip_materials=True)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.apply_scale(1.0 if unit is None else float(unit.get("meter", "1")))  # the up axis is ignored, as in Gazebo
        if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
            raise ValueError("it has no faces, or infinite numbers")
    except Exception as error:  # any error that a broken file causes
        raise OmittedShape(one_line(f"unreadable meshes ({error})", 200)) from None
    return mesh


def is_upright(pose: np.ndarray) -> bool:
    """Whether the z axis of a pose is vertical, up or down."""
    return math.hypot(pose[0, 2], pose[1, 2]) < _MAX_TILT


def _intersect(starts: np.ndarray, ends: np.ndarray, height: float) -> np.ndarray:
    """Intersection points (n, 2) of a horizontal plane with edges, from `starts` to `ends`, shape (edges, 3)."""
    start_offset, end_offset = starts[:, 2] - height, ends[:, 2] - height
    crosses = start_offset * end_offset < 0
    fraction = (start_offset[crosses] / (start_offset[crosses] - end_offset[crosses]))[:, None]
    crossings = starts[crosses] + fraction * (ends[crosses] - starts[crosses])
    on_plane = starts[np.abs(start_offset) < _PLANE_TOLERANCE]
    return np.concatenate([crossings, on_plane])[:, :2]


@lru_cache(maxsize=1000)  # worlds often contain copies of an object
def _divide_into_boxes(polygon: bytes) -> list[BoxShape]:
    """Divide a polygon into boxes; the polygon is WKB, which is a hashable key of the cache."""
    part = shapely.from_wkb(polygon)
    rectangle = shapely.oriented_envelope(part)
    if part.area >= rectangle.area * (1 - 1e-6):
        (x0, y0), (x1, y1), (x2, y2) = rectangle.exterior.coords[:3]
        length, width = math.hypot(x1 - x0, y1 - y0), math.hypot(x2 - x1, y2 - y1)
        return [((x0 + x2) / 2, (y0 + y2) / 2, length, width, math.atan2(y1 - y0, x1 - x0))]
    oriented = shapely.orient_polygons(part)  # puts the inside to the left of all edges
    rings = [np.array(ring.coords) for ring in (oriented.exterior, *oriented.interiors)]
    starts, ends = np.concatenate([ring[:-1] for ring in rings]), np.concatenate([ring[1:] for ring in rings])
    thickness = _max_thickness(part, starts, ends)
    boxes = list(_walls(starts, ends, thickness))
    walls = shapely.union_all(_wall_polygons(starts, ends, thickness))
    for core in shapely.get_parts(part.difference(walls)):
        if core.area > 0 and shapely.maximum_inscribed_circle(core, tolerance=0.01).length > _MIN_CORE:
            boxes += _fill(core)
    return boxes


def _max_thickness(part: shapely.Polygon, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Maximum thickness of a wall along each edge inside a polygon [m], at least `_MIN_THICKNESS`; shape (edges,)."""
    enlarged = part.buffer(_EPSILON)
    shapely.prepare(enlarged)
    low, high = np.full(len(starts), _MIN_THICKNESS), np.full(len(starts), np.ptp(starts, axis=0).max())
    for _ in range(_THICKNESS_BISECTIONS):
        middle = (low + high) / 2
        fits = shapely.covers(enlarged, _wall_polygons(starts, ends, middle))
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return low


def _wall_polygons(starts: np.ndarray, ends: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Polygons (edges,) of walls on the left side of edges, from `starts` to `ends`, shape (edges, 2)."""
    along = ends - starts
    left = along[:, ::-1] * (-1.0, 1.0) * (thickness / np.hypot(*along.T))[:, None]
    return shapely.polygons(np.stack([starts, ends, ends + left, starts + left], axis=1))


def _walls(starts: np.ndarray, ends: np.ndarray, thickness: np.ndarray) -> Iterator[BoxShape]:
    """The walls of `_wall_polygons` as boxes."""
    for (x0, y0), (x1, y1), width in zip(starts.tolist(), ends.tolist(), thickness.tolist(), strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        left_x, left_y = (y0 - y1) / length * width / 2, (x1 - x0) / length * width / 2
        yield (x0 + x1) / 2 + left_x, (y0 + y1) / 2 + left_y, length, width, math.atan2(y1 - y0, x1 - x0)


def _fill(part: shapely.Polygon) -> list[BoxShape]:
    """Fill a polygon with boxes, so that its inside is not floor; walls hide the boxes from the laser."""
    x0, y0, x1, y1 = part.bounds
    side = max(x1 - x0, y1 - y0) / _CORE_CELLS
    columns, rows = max(1, math.ceil((x1 - x0) / side)), max(1, math.ceil((y1 - y0) / side))
    left, bottom = x0 + side * np.arange(columns), y0 + side * np.arange(rows)[:, None]
    cells = shapely.box(left, bottom, left + side, bottom + side)
    shapely.prepare(part)
    return merge_cells(shapely.contains(part, cells), side, (x0, y0, 0.0))


def _is_solid(region: shapely.Polygon, cut_lines: shapely.Geometry, closed: bool) -> bool:
    """Whether a region of a cut is inside the body, so that a ray from it crosses the lines an odd number of times.

    In an open body, such as a house of thin walls, regions with room for a robot are not solid.
    """
    if not closed and shapely.maximum_inscribed_circle(region, tolerance=0.01).length > _ROBOT_RADIUS:
        return False
    inside = region.representative_point()
    end = (cut_lines.bounds[2] + 1.0, inside.y + 0.0123)  # slightly askew, so that the ray meets no corner
    return len(shapely.get_parts(shapely.LineString([inside, end]).intersection(cut_lines))) % 2 == 1
