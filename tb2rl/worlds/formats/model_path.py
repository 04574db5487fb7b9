"""Where SDF finds its models and meshes: `model://`, `package://`, `file://` and relative names as files on disk.

The folders are those of the setting `model_path`, of Gazebo's own variables, and those beside the world's file. Nothing
is downloaded, and nothing outside of these folders is read: a stranger's world names files, too.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.markup import read_xml, text_of

VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")
_FOLDERS_OF_MODELS = ("model", "package")  # the schemes that are looked up in the folders


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
        """The file or folder that a URI names; None if there is none.

        Args:
            uri: Such as "model://table/meshes/table.dae", or "meshes/table.dae".
            within: The folder of the file that names it.

        Raises:
            InputError: If it climbs out of the folders.
        """
        scheme, _, rest = uri.rpartition("://")
        rest = unquote(rest)
        if scheme in _FOLDERS_OF_MODELS:
            places = [(folder, folder / rest.lstrip("/")) for folder in self.folders]
        else:
            places = [(within, within / rest), *((folder, folder / rest.lstrip("/")) for folder in self.folders)]
        for folder, place in places:
            path = Path(os.path.normpath(place))  # not `resolve`: workspaces of ROS are full of symbolic links
            if not any(path.is_relative_to(inside) for inside in (folder, *self.folders)):
                raise InputError(one_line(f"{uri} climbs out of the folders of models; name its folder as model path"))
            if _exists(path):
                return path
        return None

    def __str__(self) -> str:
        return os.pathsep.join(map(str, self.folders))


def is_remote(uri: str) -> bool:
    """Whether a URI names what would have to be downloaded."""
    return uri.partition("://")[0].lower() in ("http", "https")


def model_file(place: Path) -> Path:
    """The SDF file of a model: the file itself, or the one of the highest version that its folder's model.config names.

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


def _exists(path: Path) -> bool:
    return os.path.exists(path)  # noqa: PTH110 (Path.exists raises for a name that is too long)
