"""Meshes cut by a plane, with the library trimesh: the extra `meshes`."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from tb2rl.core.errors import install_extra
from tb2rl.worlds.formats.markup import LARGEST_NUMBER, read_limited, read_xml
from tb2rl.worlds.formats.slices import STRAIGHT, LeftOut, Slice

ENDINGS = (".dae", ".obj", ".stl")  # Gazebo's formats; they reference no other files that matter
_GRID = 1e-5  # [m] ends of lines that are nearer than this are one point
_MOST_LINES = 30_000  # in a cut
_MOST_CROSSED, _SAMPLED = 40, 500  # lines that one line crosses on average, estimated from a sample
_OPEN = 0.25  # [m] an open body is filled where no robot of this radius could be inside


def load_mesh(path: Path) -> Any:
    """Load a mesh with trimesh, in metres.

    Raises:
        LeftOut: If it is no such file, or trimesh is missing.
        InputError: If it is too large, or declares entities.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise LeftOut(f"meshes of other kinds than {', '.join(ENDINGS)}")
    try:
        import trimesh

        if ending == ".dae":
            import collada  # noqa: F401 (trimesh reads these with it)
    except ImportError:
        raise LeftOut(f"meshes that take the extra `meshes`: {install_extra('meshes')}") from None
    # Our own parser refuses entities before another one would expand them.
    metres = _metres(read_xml(path)) if ending == ".dae" else 1.0
    content = read_limited(path)
    try:
        mesh: Any = trimesh.load(io.BytesIO(content), file_type=ending[1:], force="mesh", skip_materials=True)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        usable = len(mesh.faces) > 0 and bool(np.isfinite(mesh.vertices).all())
    except Exception as error:  # any error that a broken file causes
        raise LeftOut(f"meshes that cannot be read ({type(error).__name__})") from None
    if not usable:
        raise LeftOut("meshes without faces")
    return mesh.apply_scale(metres)


def cut(mesh: Any, pose: np.ndarray, scale: np.ndarray, into: Slice) -> None:
    """Add a mesh to a slice.

    Args:
        mesh: From `load_mesh`.
        pose: Shape (4, 4).
        scale: Along its own axes, shape (3,).
        into: The slice.
    """
    import trimesh

    placed = mesh.copy()
    placed.apply_transform(pose @ np.diag([*scale, 1.0]))
    into.check_height(*placed.bounds[:, 2])
    lines = trimesh.intersections.mesh_plane(placed, (0.0, 0.0, 1.0), (0.0, 0.0, into.height))
    drawn = _union(shapely.linestrings(lines[:, :, :2]))
    faces = shapely.get_parts(shapely.polygonize([drawn]))
    body = shapely.union_all([face for face in faces if _is_solid(face, drawn, bool(placed.is_watertight))])
    into.add_outline(body)
    rest = shapely.line_merge(drawn.difference(body.buffer(2 * _GRID)))
    into.add_sheets(line.coords for line in shapely.get_parts(shapely.simplify(rest, STRAIGHT)))


def _union(lines: np.ndarray) -> shapely.Geometry:
    """Union of lines, split where they cross.

    Raises:
        LeftOut: If they are too many, or cross each other everywhere: their union would take hours.
    """
    some = np.random.default_rng(0).permutation(lines)[:_SAMPLED]
    crossed = shapely.STRtree(lines).query(some).shape[1] / len(some) if len(lines) <= _MOST_LINES else math.inf
    if crossed > _MOST_CROSSED:
        raise LeftOut("meshes that are too fine, or whose faces cut each other everywhere")
    return shapely.union_all(lines, grid_size=_GRID)


def _is_solid(face: shapely.Polygon, drawn: shapely.Geometry, closed: bool) -> bool:
    """Whether a face between the lines of a cut is inside the body: a ray from there crosses an odd number of lines.

    The inside of an open body, such as a house of thin walls, is only where no robot fits.
    """
    if not closed and shapely.maximum_inscribed_circle(face, tolerance=0.01).length > _OPEN:
        return False
    inside = face.representative_point()
    end = (drawn.bounds[2] + 1.0, inside.y + 0.0123)  # slightly askew, so that the ray meets no corner
    crossed = shapely.LineString([inside, end]).intersection(drawn)
    return len(shapely.get_parts(crossed)) % 2 == 1


def _metres(root: Element) -> float:
    """The unit of a COLLADA file [m]; its up axis is ignored, as in Gazebo."""
    unit = root.find("{*}asset/{*}unit")
    try:
        metres = float("1" if unit is None else unit.get("meter", "1"))
    except ValueError:
        metres = math.nan
    if not 0 < metres <= LARGEST_NUMBER:
        raise LeftOut("meshes whose unit is no length")
    return metres
