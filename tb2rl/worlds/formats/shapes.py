"""The collision shapes of SDF, as what a laser at a height sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import Losses
from tb2rl.worlds.formats.markup import numbers, sizes, text_of
from tb2rl.worlds.formats.meshes import MeshError, cut, load_mesh
from tb2rl.worlds.formats.model_path import ModelPath, is_remote
from tb2rl.worlds.formats.slices import Side, Slice, upright

_MOST_POLYLINES = 100  # of one shape
_MOST_OBSTACLES = 10_000  # that shapes are cut to; an outline of a house makes 30


class Shapes:
    """Cuts shapes at a height, one after the other; what is there so far is in `found`.

    Args:
        height: Of the laser [m].
        models: Where meshes are looked for.
        losses: Where what is left out is noted.
    """

    def __init__(self, height: float, models: ModelPath, losses: Losses) -> None:
        self.found = Slice(height)
        self._models, self._losses = models, losses
        self._meshes: dict[Path, Any] = {}

    def add(self, collision: Element, pose: np.ndarray, scale: Sequence[float], file: Path, label: str) -> None:
        """Add the shape of a <collision>.

        Args:
            collision: What holds the <geometry>.
            pose: In the world, shape (4, 4).
            scale: Along its own axes.
            file: Where it is written.
            label: What it is called in warnings and errors.

        Raises:
            InputError: If its numbers are not those of a shape.
        """
        geometries = collision.findall("geometry")
        if len(geometries) > 1:
            self._losses.add("only the first <geometry> of a <collision> is read", label)
        for shape in _shapes_in(geometries[0]) if geometries else ():
            add = getattr(self, f"_add_{shape.tag}", None)
            try:
                side = "met" if add is None else add(shape, pose, np.array(scale), file, label)
            except InputError as error:
                raise InputError(f"{label}: {error}") from None
            if len(self.found.boxes) + len(self.found.posts) > _MOST_OBSTACLES:
                raise InputError(f"its shapes make more than {_MOST_OBSTACLES} obstacles, the limit")
            if add is None:
                self._losses.add(f"<{shape.tag}> shapes are not understood", label)
            elif side != "met":
                self._losses.add(f"left out, for they are {side} the laser (at {self.found.height:g} m)", label)

    def _add_empty(self, *_: Any) -> Side:
        return "met"

    def _add_plane(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        normal = shape.find("normal")
        if not upright(pose) or (normal is not None and numbers(normal, 3)[:2] != [0.0, 0.0]):
            self._losses.add("planes that are not the ground are not understood", label)
        return "met"

    def _add_box(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        return self.found.add_box(pose, np.array(sizes(shape, "size", 3)) * scale / 2)

    def _add_cylinder(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        (radius,), (length,) = sizes(shape, "radius", 1), sizes(shape, "length", 1)
        return self.found.add_cylinder(pose, radius * max(scale[:2]), length * scale[2])

    def _add_sphere(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        (radius,) = sizes(shape, "radius", 1)
        return self.found.add_sphere(pose, radius * max(scale))

    def _add_polyline(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        lines = shape.findall("polyline") or [shape]
        if len(lines) > _MOST_POLYLINES:
            raise InputError(f"it has more than {_MOST_POLYLINES} <polyline>")
        (height,) = np.array(sizes(lines[0], "height", 1)) * scale[2]
        outline = _between([_outline(line, scale) for line in lines])
        if upright(pose):
            if (side := self.found.side(*sorted((pose[2, 3], pose[2, 3] + pose[2, 2] * height)))) == "met":
                self.found.add_outline(shapely.transform(outline, lambda points: points @ pose[:2, :2].T + pose[:2, 3]))
            return side
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
        return self.found.add_prisms(pose, [np.array(part.exterior.coords[:3]) for part in triangles], 0.0, height)

    def _add_mesh(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> Side:
        uri = text_of(shape.find("uri"))
        if shape.find("submesh") is not None:
            self._losses.add("of these the whole mesh is taken, not a <submesh> alone", label)
        path = None if is_remote(uri) or not uri else self._models.find(uri, file.parent)
        if path is None:
            why = "nothing is downloaded, so these are not read" if is_remote(uri) else "meshes that are not there"
            self._losses.add(why, f"{label} ({uri})")
            return "met"
        own = np.array(sizes(shape, "scale", 3)) if shape.find("scale") is not None else np.ones(3)
        try:
            if path not in self._meshes:
                self._meshes[path] = load_mesh(path)
            return cut(self._meshes[path], pose, own * scale, self.found)
        except MeshError as why:
            self._losses.add(str(why), f"{label} ({path.name})")
            return "met"


def _shapes_in(geometry: Element) -> list[Element]:
    """The shapes of a <geometry>; several <polyline> are one shape together."""
    lines = geometry.findall("polyline")
    if len(lines) < 2:
        return list(geometry)
    together = Element("polyline")
    together.extend(lines)
    return [together, *(shape for shape in geometry if shape.tag != "polyline")]


def _outline(polyline: Element, scale: np.ndarray) -> shapely.Polygon:
    corners = [np.array(numbers(point, 2)) * scale[:2] for point in polyline.findall("point")]
    outline = shapely.Polygon(corners) if len(corners) > 2 else shapely.Polygon()
    if not outline.is_valid or outline.area == 0:
        raise InputError("a <polyline> must have at least three <point>, and a line around them that crosses nothing")
    return outline


def _between(outlines: Sequence[shapely.Polygon]) -> BaseGeometry:
    """What is within an odd number of outlines: one within another is a hole in it, as Gazebo's own tests have it."""
    if len(outlines) == 1:
        return outlines[0]
    rings = shapely.multilinestrings([outline.exterior for outline in outlines])
    if not rings.is_simple:
        raise InputError("a <polyline> must not touch or cross another one of the same shape")
    return shapely.build_area(rings)
