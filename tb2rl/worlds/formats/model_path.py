"""Resolves `model://`, `package://`, `file://` and relative URIs in SDF to local files.

Models are searched in the folders of the setting `model_path`, of the environment variables of Gazebo, and near the
world file. Nothing is downloaded or read from other folders, because world files are untrusted.
"""

import os
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.markup import element_text, read_xml

VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")


class ModelPath:
    """Search path of models.

    Args:
        world: The world file.
        folders: Folders to search first.
    """

    def __init__(self, world: Path, folders: tuple[str, ...] = ()) -> None:
        paths = [*folders, *(folder for name in VARIABLES for folder in os.environ.get(name, "").split(os.pathsep))]
        world_folder = world.absolute().parent
        listed_folders = [Path(folder).absolute() for folder in paths if folder]
        # In TurtleBot3 and most other packages, worlds/ and models/ are in the same folder.
        self._folders = [*listed_folders, world_folder, world_folder / "models", world_folder.parent / "models"]

    def find(self, uri: str, within: Path) -> Path | None:
        """Find the file or folder of a URI, None if there is none; the folder `within` contains the SDF file.

        Raises:
            InputError: If the URI leaves the search path.
        """
        scheme, _, quoted = uri.rpartition("://")
        location = unquote(quoted)
        candidates = [folder / location.lstrip("/") for folder in self._folders]
        if scheme not in ("model", "package"):
            candidates.insert(0, within / location)
        paths = [self._checked(candidate, within) for candidate in candidates if uri]
        return next((path for path in paths if os.path.exists(path)), None)  # noqa: PTH110 (as in `read_limited`)

    def find_model(self, uri: str, within: Path) -> Path | None:
        """Find the SDF file of a model. In a folder, this is the file with the highest version in model.config.

        Raises:
            InputError: If the URI or model.config leave the search path.
        """
        found = self.find(uri, within)
        if found is None or not found.is_dir():
            return found
        config = found / "model.config"
        versions = list(read_xml(config).iter("sdf")) if config.is_file() else []
        name = element_text(max(versions, key=_version)) if versions else ""
        model = self._checked(found / (name or "model.sdf"), found)
        return model if model.is_file() else None

    def _checked(self, path: Path, within: Path) -> Path:
        """Normalise a path; raise an `InputError` if the result is outside of `within` and of the search path."""
        path = Path(os.path.normpath(path))  # not `resolve`, because ROS workspaces are full of symbolic links
        if not any(path.is_relative_to(folder) for folder in (within, *self._folders)):
            raise InputError(one_line(f"{path} is outside of the model path; add its folder to the model path"))
        return path


def _version(sdf: Element) -> tuple[int, ...]:
    return tuple(int(part) for part in sdf.get("version", "").split(".") if part.isdecimal())
