"""Horizontal cuts of meshes, by trimesh (the extra `meshes`)."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from tb2rl.core.errors import install_extra, one_line
from tb2rl.worlds.formats.imports import mean_overlaps
from tb2rl.worlds.formats.markup import read_limited, read_xml
from tb2rl.worlds.formats.slices import OUTLINE_TOLERANCE, OmittedShape, Slice

EXTENSIONS = (".dae", ".obj", ".stl")  # formats of Gazebo; files that they reference do not affect the shape
_GRID = 1e-5  # [m] end points of lines are rounded to this grid, so that adjacent lines meet
_MAX_LINES = 30_000  # limit of the number of lines in a cut
_MAX_CROSSINGS = 40  # limit of the mean number of lines that a line crosses
_ROBOT_RADIUS = 0.25  # [m] faces of an open body are solid if they have no room for a robot of this radius


def load_mesh(path: Path) -> Any:
    """Load a mesh with trimesh, in metres.

    Raises:
        OmittedShape: If the file is not a mesh, or trimesh is missing.
        InputError: If the file is too large, or declares entities.
    """
    extension = path.suffix.lower()
    if extension not in EXTENSIONS:
        raise OmittedShape(f"unsupported mesh formats, other than {', '.join(EXTENSIONS)}")
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


def add_mesh(mesh: Any, pose: np.ndarray, scale: np.ndarray, cut: Slice) -> None:
    """Add a mesh from `load_mesh`, with a pose (4, 4) and a scale (3,), to a slice."""
    import trimesh

    placed = mesh.copy()
    placed.apply_transform(pose @ np.diag([*scale, 1.0]))
    cut.check_height(*placed.bounds[:, 2])
    segments = trimesh.intersections.mesh_plane(placed, (0.0, 0.0, 1.0), (0.0, 0.0, cut.height))
    lines = shapely.linestrings(segments[:, :, :2])
    if len(lines) > _MAX_LINES or mean_overlaps(lines) > _MAX_CROSSINGS:  # their union would take hours
        raise OmittedShape("meshes that are too fine, or whose faces cut each other everywhere")
    outline = shapely.union_all(lines, grid_size=_GRID)
    faces = shapely.get_parts(shapely.polygonize([outline]))
    body = shapely.union_all([face for face in faces if _is_solid(face, outline, bool(placed.is_watertight))])
    cut.add_outline(body)
    open_lines = shapely.line_merge(outline.difference(body.buffer(2 * _GRID)))
    cut.add_thin_walls(shapely.get_parts(shapely.simplify(open_lines, OUTLINE_TOLERANCE)))


def _is_solid(face: shapely.Polygon, outline: shapely.Geometry, closed: bool) -> bool:
    """Whether a face of a cut is inside the body, so that a ray from it crosses the outline an odd number of times.

    In an open body, such as a house of thin walls, faces with room for a robot are not solid.
    """
    if not closed and shapely.maximum_inscribed_circle(face, tolerance=0.01).length > _ROBOT_RADIUS:
        return False
    inside = face.representative_point()
    end = (outline.bounds[2] + 1.0, inside.y + 0.0123)  # slightly askew, so that the ray meets no corner
    crossed = shapely.LineString([inside, end]).intersection(outline)
    return len(shapely.get_parts(crossed)) % 2 == 1
