"""Gazebo's worlds: SDF files (http://sdformat.org/spec), cut at the height of the laser.

The obstacles are the collision shapes of all models. Parts that are not understood are named in a `WorldWarning`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import ImportOptions, Omissions, complete_world
from tb2rl.worlds.formats.markup import name_of, read_xml, text_of
from tb2rl.worlds.formats.model_path import ModelPath, is_remote, model_file
from tb2rl.worlds.formats.poses import IDENTITY, Scope
from tb2rl.worlds.formats.shapes import Placement, Shapes
from tb2rl.worlds.formats.state import State
from tb2rl.worlds.world import World

_DEEPEST = 20  # models within models, and files within files
_MOST = 20_000  # models and shapes in a world: files that include each other can make any number
_NO_OBSTACLE = {  # elements of a world or a model without collision shapes
    "atmosphere", "audio", "frame", "gravity", "gripper", "gui", "joint", "light", "link", "magnetic_field", "model",
    "include", "physics", "pose", "scene", "self_collide", "spherical_coordinates", "static", "wind", "plugin", "state",
    "allow_auto_disable", "enable_wind", "name", "uri", "placement_frame",
}  # fmt: skip


def read_sdf(path: Path, options: ImportOptions) -> World:
    """Read the world of an SDF file (.world or .sdf), which may be a single model.

    Raises:
        InputError: If it is no such file, or no world.
    """
    root = read_xml(path)
    if root.tag != "sdf":
        raise InputError(f"{path} is not SDF: it begins with <{root.tag[:40]}>, not <sdf>")
    reader = _Reader(path, options)
    try:
        reader.read(root)
    except InputError as error:
        raise InputError(f"world {path.stem}: {error}") from None
    reader.omissions.warn(path.stem)
    found = reader.shapes.found
    return complete_world(path.stem, found.boxes, found.posts, options, description=f"from {path.name}")


@dataclass
class _Reader:
    """A walk through a world, with all that it includes."""

    path: Path
    options: ImportOptions
    omissions: Omissions = field(default_factory=Omissions)
    _including: list[Path] = field(default_factory=list)
    _seen: int = 0

    def __post_init__(self) -> None:
        self._models = ModelPath(self.path, self.options.model_path)
        self.shapes = Shapes(self.options.laser_height, self._models, self.omissions)
        self._root, self._find = cache(read_xml), cache(self._find_model)

    def read(self, root: Element) -> None:
        """Read the first world of an <sdf>, or its models."""
        worlds = root.findall("world")
        for world in worlds[1:]:
            self.omissions.add("only the first world of the file is read, not", name_of(world))
        if not worlds and root.find("model") is None:
            raise InputError("it holds neither a <world> nor a <model>")
        top = worlds[0] if worlds else root
        self._note_plugins(top)
        for link in top.findall("link"):
            self.omissions.add("a <link> stands in a <model>, and not alone", name_of(link))
        state = State(top.find("state"))
        scope = Scope(top, IDENTITY, self.omissions.add)
        self._read_scope(scope, self.path, state)
        for model in state.inserted:
            self._read_model(model, scope, self.path, state.of(model))
        for name in state.missing():
            self.omissions.add("the state names models and links that are not there", name)

    def _read_scope(self, scope: Scope, file: Path, state: State) -> None:
        """Read the models in a world or a model."""
        for child in scope.element:
            if child.tag == "model":
                if not state.deletes(name_of(child)):
                    self._read_model(child, scope, file, state.of(child))
            elif child.tag == "include":
                self._read_include(child, scope, file, state)
            elif child.tag not in _NO_OBSTACLE:
                name = f"{name_of(child)} (<{child.tag}>)" if child.get("name") else name_of(child)
                self.omissions.add("not understood", name)

    def _read_model(
        self, model: Element, around: Scope, file: Path, state: State, pose: np.ndarray | None = None
    ) -> None:
        """Read a model.

        Args:
            model: The <model>.
            around: The scope that contains it.
            file: The file that contains it.
            state: Its saved state.
            pose: Pose in the world, instead of the model's own one, shape (4, 4).
        """
        self._count()
        if len(self._including) > _DEEPEST or state.depth > _DEEPEST:
            raise InputError(f"models stand within models, or files include files, more than {_DEEPEST} deep")
        own = state.pose
        if own is None:
            own = (around.place(model) if pose is None else pose) @ self._from_placement_frame(model)
        scope = Scope(model, own, self.omissions.add)
        self._note_plugins(model)
        for link in model.findall("link"):
            self._note_plugins(link)
            at = state.link(link)
            at = scope.place(link) if at is None else at
            for collision in link.findall("collision"):
                self._count()
                label = f"{name_of(model)}/{name_of(collision)}"
                placed = Placement(scope.place(collision, at), np.array(state.scale), file, label)
                self.shapes.add(collision, placed)
        self._read_scope(scope, file, state)

    def _from_placement_frame(self, model: Element) -> np.ndarray:
        """Pose of the model relative to its placement frame, shape (4, 4)."""
        named = model.get("placement_frame")
        placed = Scope(model, IDENTITY, self.omissions.add).frame(named, name_of(model)) if named else None
        return IDENTITY if placed is None else np.linalg.inv(placed)

    def _read_include(self, include: Element, around: Scope, file: Path, state: State) -> None:
        """Read the model that an <include> names; name and pose of the <include> take precedence."""
        self._count()
        uri = text_of(include.find("uri"))
        if is_remote(uri):
            self.omissions.add("nothing is downloaded, so these are not read", uri)
            return
        sdf = self._find(uri, file.parent)
        if sdf is None:
            missing = "models that are in none of the folders (set GAZEBO_MODEL_PATH to theirs)"
            self.omissions.add(missing, uri or name_of(include))
            return
        if sdf in self._including or sdf == self.path.absolute():
            raise InputError(f"{sdf.name} includes itself, by way of {uri}")
        self._note_plugins(include)
        self._including.append(sdf)
        given = {tag: text_of(include.find(tag)) for tag in ("name", "placement_frame")}
        for original in self._models_in(sdf):
            model = Element("model", {**original.attrib, **{key: value for key, value in given.items() if value}})
            model.extend(original)
            if not state.deletes(name_of(model)):
                pose = None if include.find("pose") is None else around.place(include)
                self._read_model(model, around, sdf, state.of(model), pose)
        self._including.pop()

    def _find_model(self, uri: str, folder: Path) -> Path | None:
        """The file of the model that a URI in a file of a folder names; None if there is none."""
        place = self._models.find(uri, folder) if uri else None
        sdf = None if place is None else model_file(place)
        return sdf if sdf is not None and sdf.is_file() else None

    def _models_in(self, sdf: Path) -> Iterator[Element]:
        for child in self._root(sdf):
            if child.tag == "model":
                yield child
            elif child.tag != "light":
                self.omissions.add("not understood", f"{name_of(child)} in {sdf.name}")

    def _note_plugins(self, owner: Element) -> None:
        for plugin in owner.findall("plugin"):
            name = owner.get("name") or text_of(owner.find("name")) or text_of(owner.find("uri"))
            label = f"{plugin.get('name') or plugin.get('filename')} of {name}"
            self.omissions.add("plugins are not run, so what they move stands still", label)

    def _count(self) -> None:
        self._seen += 1
        if self._seen > _MOST:
            raise InputError(f"it has more than {_MOST} models and shapes, includes counted each time")
