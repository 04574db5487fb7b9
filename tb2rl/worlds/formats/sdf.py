"""Gazebo's worlds: SDF files (http://sdformat.org/spec), cut at the height of the laser.

What stands in the way are the collision shapes of all models. What is not understood is named in a `WorldWarning`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import Import, Losses, finished
from tb2rl.worlds.formats.markup import name_of, read_xml, text_of
from tb2rl.worlds.formats.model_path import ModelPath, is_remote, model_file
from tb2rl.worlds.formats.poses import STILL, Scope
from tb2rl.worlds.formats.shapes import Shapes
from tb2rl.worlds.formats.state import State
from tb2rl.worlds.world import World

_DEEPEST = 20  # models within models, and files within files
_MOST = 20_000  # models and shapes in a world: files that include each other can ask for any number
_NO_OBSTACLE = {  # what stands in a world or a model and is nothing that a robot could touch
    "atmosphere", "audio", "frame", "gravity", "gripper", "gui", "joint", "light", "link", "magnetic_field", "model",
    "include", "physics", "pose", "scene", "self_collide", "spherical_coordinates", "static", "wind", "plugin", "state",
    "allow_auto_disable", "enable_wind", "name", "uri", "placement_frame",
}  # fmt: skip


def read_sdf(path: Path, said: Import) -> World:
    """The world of an SDF file (.world or .sdf), which may be a single model.

    Raises:
        InputError: If it is no such file, or no world.
    """
    root = read_xml(path)
    if root.tag != "sdf":
        raise InputError(f"{path} is not SDF: it begins with <{root.tag[:40]}>, not <sdf>")
    losses = Losses()
    try:
        reader = _Reader(path, said, losses)
        reader.read(root)
    except InputError as error:
        raise InputError(f"world {path.stem}: {error}") from None
    losses.tell(path.stem)
    found = reader.shapes.found
    return finished(path.stem, found.boxes, found.posts, said, description=f"from {path.name}")


@dataclass
class _Reader:
    """A walk through a world, with all that it includes."""

    path: Path
    said: Import
    losses: Losses
    _files: dict[Path, Element] = field(default_factory=dict)
    _found: dict[tuple[str, Path], Path | None] = field(default_factory=dict)
    _including: list[Path] = field(default_factory=list)
    _seen: int = 0

    def __post_init__(self) -> None:
        self._models = ModelPath(self.path, self.said.model_path)
        self.shapes = Shapes(self.said.laser_height, self._models, self.losses)

    def read(self, root: Element) -> None:
        """Read what an <sdf> holds: its first world, or its models."""
        worlds = root.findall("world")
        for world in worlds[1:]:
            self.losses.add("only the first world of the file is read, not", name_of(world))
        if not worlds and root.find("model") is None:
            raise InputError("it holds neither a <world> nor a <model>")
        top = worlds[0] if worlds else root
        self._name_plugins(top)
        for link in top.findall("link"):
            self.losses.add("a <link> stands in a <model>, and not alone", name_of(link))
        state = State(top.find("state"))
        self._read_scope(Scope(top, STILL, self.losses.add), self.path, state)
        for model in state.inserted:
            self._read_model(model, Scope(top, STILL, self.losses.add), self.path, state.of(model))
        for name in state.missing():
            self.losses.add("the state names models and links that are not there", name)

    def _read_scope(self, scope: Scope, file: Path, state: State) -> None:
        """Read the models that stand in a world or a model."""
        for child in scope.element:
            if child.tag == "model":
                if not state.deletes(name_of(child)):
                    self._read_model(child, scope, file, state.of(child))
            elif child.tag == "include":
                self._read_include(child, scope, file, state)
            elif child.tag not in _NO_OBSTACLE:
                self.losses.add(
                    "not understood", f"{name_of(child)} (<{child.tag}>)" if child.get("name") else name_of(child)
                )

    def _read_model(
        self, model: Element, around: Scope, file: Path, state: State, pose: np.ndarray | None = None
    ) -> None:
        """Read a model.

        Args:
            model: The <model>.
            around: What it stands in.
            file: Where it is written.
            state: What the world's state says about it.
            pose: Where it stands in the world, instead of where it says itself, shape (4, 4).
        """
        self._count()
        if len(self._including) > _DEEPEST or state.depth > _DEEPEST:
            raise InputError(f"models stand within models, or files include files, more than {_DEEPEST} deep")
        if state.pose is not None:
            pose = state.pose
        own = around.place(model) if pose is None else pose
        if state.pose is None:
            own = own @ self._from_placed(model)
        scope = Scope(model, own, self.losses.add)
        self._name_plugins(model)
        for link in model.findall("link"):
            self._name_plugins(link)
            at = state.link(link)
            at = scope.place(link) if at is None else at
            for collision in link.findall("collision"):
                self._count()
                label = f"{name_of(model)}/{name_of(collision)}"
                self.shapes.add(collision, scope.place(collision, at), state.scale, file, label)
        self._read_scope(scope, file, state)

    def _from_placed(self, model: Element) -> np.ndarray:
        """The model itself in the frame of it that its pose is meant for, shape (4, 4)."""
        named = model.get("placement_frame")
        placed = Scope(model, STILL, self.losses.add).frame(named, name_of(model)) if named else None
        return STILL if placed is None else np.linalg.inv(placed)

    def _read_include(self, include: Element, around: Scope, file: Path, state: State) -> None:
        """Read the model that an <include> names; its name and its pose are those of the <include>, if it has any."""
        self._count()
        uri = text_of(include.find("uri"))
        if is_remote(uri):
            self.losses.add("nothing is downloaded, so these are not read", uri)
            return
        sdf = self._find(uri, file.parent)
        if sdf is None:
            missing = "models that are in none of the folders (set GAZEBO_MODEL_PATH to theirs)"
            self.losses.add(missing, uri or name_of(include))
            return
        if sdf in self._including or sdf == self.path.absolute():
            raise InputError(f"{sdf.name} includes itself, by way of {uri}")
        self._name_plugins(include)
        self._including.append(sdf)
        for model in self._models_in(sdf):
            said = {tag: text_of(include.find(tag)) for tag in ("name", "placement_frame")}
            model = _with(model, {key: value for key, value in said.items() if value})
            if not state.deletes(name_of(model)):
                pose = None if include.find("pose") is None else around.place(include)
                self._read_model(model, around, sdf, state.of(model), pose)
        self._including.pop()

    def _find(self, uri: str, folder: Path) -> Path | None:
        """The file of the model that a URI in a file of a folder names; None: it is not there."""
        if (uri, folder) not in self._found:
            place = self._models.find(uri, folder) if uri else None
            sdf = None if place is None else model_file(place)
            self._found[uri, folder] = sdf if sdf is not None and sdf.is_file() else None
        return self._found[uri, folder]

    def _models_in(self, sdf: Path) -> Iterator[Element]:
        if sdf not in self._files:
            self._files[sdf] = read_xml(sdf)
        for child in self._files[sdf]:
            if child.tag == "model":
                yield child
            elif child.tag != "light":
                self.losses.add("not understood", f"{name_of(child)} in {sdf.name}")

    def _name_plugins(self, owner: Element) -> None:
        for plugin in owner.findall("plugin"):
            name = owner.get("name") or text_of(owner.find("name")) or text_of(owner.find("uri"))
            label = f"{plugin.get('name') or plugin.get('filename')} of {name}"
            self.losses.add("plugins are not run, so what they move stands still", label)

    def _count(self) -> None:
        self._seen += 1
        if self._seen > _MOST:
            raise InputError(f"it has more than {_MOST} models and shapes, includes counted each time")


def _with(model: Element, attributes: dict[str, str]) -> Element:
    changed = Element(model.tag, {**model.attrib, **attributes})
    changed.extend(model)
    return changed
