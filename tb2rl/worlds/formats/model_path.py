"""Resolves `model://`, `package://`, `file://` and relative URIs in SDF to files on disk.

The folders are those of the setting `model_path`, of Gazebo's own variables, and those beside the world's file. Nothing
is downloaded, and nothing outside of these folders is read, because the world may come from a stranger.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.markup import read_xml, text_of

VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")


class ModelPath:
    """The folders that models are looked up in, in this order.

    Args:
        world: The world's file.
        folders: Folders to look in first.
    """

    def __init__(self, world: Path, folders: Sequence[str] = ()) -> None:
        named = [*folders, *(folder for name in VARIABLES for folder in os.environ.get(name, "").split(os.pathsep))]
        beside = world.absolute().parent
        found = [Path(folder).absolute() for folder in named if folder]
        # TurtleBot3 and most others keep worlds/ and models/ side by side.
        self.folders = [*found, beside, beside / "models", beside.parent / "models"]

    def find(self, uri: str, within: Path) -> Path | None:
        """The file or folder that a URI in a file of folder `within` names; None if there is none.

        Raises:
            InputError: If it climbs out of the folders.
        """
        scheme, _, rest = uri.rpartition("://")
        rest = unquote(rest)
        places = [(folder, folder / rest.lstrip("/")) for folder in self.folders]
        if scheme not in ("model", "package"):
            places.insert(0, (within, within / rest))
        for folder, place in places:
            path = Path(os.path.normpath(place))  # not `resolve`: ROS workspaces are full of symbolic links
            if not any(path.is_relative_to(inside) for inside in (folder, *self.folders)):
                raise InputError(one_line(f"{uri} climbs out of the folders of models; name its folder as model path"))
            if os.path.exists(path):  # noqa: PTH110 (Path.exists raises for a name that is too long)
                return path
        return None


def is_remote(uri: str) -> bool:
    """Whether a URI would have to be downloaded."""
    return uri.partition("://")[0].lower() in ("http", "https")


def model_file(place: Path) -> Path:
    """The SDF file of a model: the file itself, or the one of the highest version in its folder's model.config.

    Raises:
        InputError: If the folder names a file outside of it.
    """
    if not place.is_dir():
        return place
    config = place / "model.config"
    versions = list(read_xml(config).iter("sdf")) if config.is_file() else []
    if not versions:
        return place / "model.sdf"
    file = Path(text_of(max(versions, key=lambda sdf: _version(sdf.get("version", "")))) or "model.sdf")
    if file.is_absolute() or ".." in file.parts:
        raise InputError(one_line(f"{config} names {file}, which is not in its folder"))
    return place / file


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".") if part.isdecimal())
