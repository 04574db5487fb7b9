"""Debian's packages of ROS 1, made importable in a virtual environment."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from tb2rl.core.errors import InputError

PACKAGES = Path("/usr/lib/python3/dist-packages")  # of Debian's own Python, by its policy
INSTALL = (
    "apt-get install --no-install-recommends python3-rospy python3-sensor-msgs python3-nav-msgs python3-geometry-msgs "
    "python3-std-srvs python3-tf2-msgs python3-diagnostic-msgs"
)


def find_rospy() -> None:
    """Make rospy importable, with the messages of ROS 1: those of ROS 2 may be installed under the same names.

    Raises:
        InputError: If it is not installed.
    """
    spec = find_spec("rospy")
    if spec is None and not (PACKAGES / "rospy").is_dir():
        raise InputError(f"--ros 1 needs rospy, which is not installed; on Debian and Ubuntu: {INSTALL}")
    folder = PACKAGES if spec is None or spec.origin is None else Path(spec.origin).parent.parent
    if spec is None:
        sys.path.append(str(folder))  # at the end, because packages of pip come first
    if not any(isinstance(finder, _MessageFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _MessageFinder(folder))


class _MessageFinder:
    """Finds message packages in the folder of rospy first."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`."""
        return PathFinder.find_spec(name, [self._folder]) if name.endswith(("_msgs", "_srvs")) else None
