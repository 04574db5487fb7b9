"""The collision shapes of SDF, cut at the height of the laser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import Omissions
from tb2rl.worlds.formats.markup import numbers, sizes, text_of
from tb2rl.worlds.formats.meshes import cut, load_mesh
from tb2rl.worlds.formats.model_path import ModelPath, is_remote
from tb2rl.worlds.formats.slices import LeftOut, OutOfPlane, Slice, upright

_MOST_OBSTACLES = 10_000  # in a world; the outline of a house makes 30


@dataclass(frozen=True)
class Placement:
    """Pose in the world (4, 4) and scale (3,) of a collision, the file that contains it, and its label in messages."""

    pose: np.ndarray
    scale: np.ndarray
    file: Path
    label: str


class Shapes:
    """Cuts shapes at the height of the laser [m] and collects the obstacles in `found`."""

    def __init__(self, height: float, models: ModelPath, omissions: Omissions) -> None:
        self.found = Slice(height)
        self._models, self._omissions = models, omissions
        self._meshes: dict[Path, Any] = {}

    def add(self, collision: Element, placed: Placement) -> None:
        """Add the shape of a <collision>.

        Raises:
            InputError: If its numbers are invalid.
        """
        geometries = collision.findall("geometry")
        if len(geometries) > 1:
            self._omissions.add("only the first <geometry> of a <collision> is read", placed.label)
        for shape in _shapes_in(geometries[0]) if geometries else ():
            try:
                self._add(shape, placed)
            except LeftOut as why:
                self._omissions.add(str(why), f"{placed.label} ({why.detail})" if why.detail else placed.label)
            except InputError as error:
                raise InputError(f"{placed.label}: {error}") from None
            if len(self.found.boxes) + len(self.found.posts) > _MOST_OBSTACLES:
                raise InputError(f"its shapes make more than {_MOST_OBSTACLES} obstacles, the limit")

    def _add(self, shape: Element, placed: Placement) -> None:
        pose, scale = placed.pose, placed.scale
        if shape.tag == "plane":
            normal = shape.find("normal")
            if not upright(pose) or (normal is not None and numbers(normal, 3)[:2] != [0.0, 0.0]):
                raise LeftOut("planes that are not the ground are not understood")
        elif shape.tag == "box":
            self.found.add_box(pose, np.array(sizes(shape, "size", 3)) * scale / 2)
        elif shape.tag == "cylinder":
            (radius,), (length,) = sizes(shape, "radius", 1), sizes(shape, "length", 1)
            self.found.add_cylinder(pose, radius * max(scale[:2]), length * scale[2])
        elif shape.tag == "sphere":
            (radius,) = sizes(shape, "radius", 1)
            self.found.add_sphere(pose, radius * max(scale))
        elif shape.tag == "polyline":
            self._add_polyline(shape, placed)
        elif shape.tag == "mesh":
            self._add_mesh(shape, placed)
        elif shape.tag != "empty":
            raise LeftOut(f"<{shape.tag}> shapes are not understood")

    def _add_polyline(self, shape: Element, placed: Placement) -> None:
        pose, lines = placed.pose, shape.findall("polyline") or [shape]
        (height,) = np.array(sizes(lines[0], "height", 1)) * placed.scale[2]
        outline = _between([_outline(line, placed.scale) for line in lines])
        if upright(pose):
            self.found.check_height(*sorted((pose[2, 3], pose[2, 3] + pose[2, 2] * height)))
            self.found.add_outline(shapely.transform(outline, lambda points: points @ pose[:2, :2].T + pose[:2, 3]))
        else:
            triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
            self.found.add_prisms(pose, [np.array(part.exterior.coords[:3]) for part in triangles], 0.0, height)

    def _add_mesh(self, shape: Element, placed: Placement) -> None:
        uri = text_of(shape.find("uri"))
        if shape.find("submesh") is not None:
            self._omissions.add("of these the whole mesh is taken, not a <submesh> alone", placed.label)
        if is_remote(uri):
            raise LeftOut("nothing is downloaded, so these are not read", uri)
        path = self._models.find(uri, placed.file.parent) if uri else None
        if path is None:
            raise LeftOut("meshes that are not there", uri or "no <uri>")
        own = np.array(sizes(shape, "scale", 3)) if shape.find("scale") is not None else np.ones(3)
        try:
            if path not in self._meshes:
                self._meshes[path] = load_mesh(path)
            cut(self._meshes[path], placed.pose, own * placed.scale, self.found)
        except OutOfPlane:
            raise
        except LeftOut as why:
            raise LeftOut(str(why), path.name) from None


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
    """The area within an odd number of outlines: one within another is a hole, as in Gazebo's own tests."""
    if len(outlines) == 1:
        return outlines[0]
    rings = shapely.multilinestrings([outline.exterior for outline in outlines])
    if not rings.is_simple:
        raise InputError("a <polyline> must not touch or cross another one of the same shape")
    return shapely.build_area(rings)
