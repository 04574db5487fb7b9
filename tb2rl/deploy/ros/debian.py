"""Makes Debian's packages of ROS 1 importable, and generates the message packages that Debian lacks.

The programs of the ROS tutorial import these message packages, and the Kobuki sends events of `kobuki_msgs`.
`interfaces/` contains their definitions. The constants, and the order and the types of the fields, match the original
packages `gazebo_msgs`, `controller_manager_msgs`, `kobuki_msgs` and `openai_ros`, because nodes compare checksums of
the definitions.
"""

import argparse
import sys
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path

from tb2rl.core.errors import InputError

PACKAGES = Path("/usr/lib/python3/dist-packages")  # of Debian's Python
INSTALL_COMMAND = (
    "apt-get install --no-install-recommends python3-rospy python3-sensor-msgs python3-nav-msgs python3-geometry-msgs "
    "python3-std-srvs python3-tf2-msgs python3-diagnostic-msgs"
)
INTERFACES = Path(__file__).parent / "interfaces"  # PACKAGE/msg/NAME.msg and PACKAGE/srv/NAME.srv
_INSTALLED_PACKAGE = "geometry_msgs"  # not generated; the checksums of the others depend on its definition
# Merges a generated package with an installed package of the same name, such as the tutorial's openai_ros.
_PACKAGE_INIT = '__path__ = __import__("pkgutil").extend_path(__path__, __name__)\n'


def find_rospy() -> None:
    """Make rospy importable, with the messages of ROS 1 even if those of ROS 2 have the same names.

    Raises:
        InputError: If rospy is not installed.
    """
    spec = find_spec("rospy")
    if spec is None and not (PACKAGES / "rospy").is_dir():
        raise InputError(f"--ros 1 needs rospy, which is not installed; on Debian and Ubuntu: {INSTALL_COMMAND}")
    folder = PACKAGES if spec is None or spec.origin is None else Path(spec.origin).parent.parent
    if spec is None:
        sys.path.append(str(folder))  # after the packages of this Python
    if not any(isinstance(finder, _MessageFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _MessageFinder(folder))


class _MessageFinder:
    """Finds message packages in the folder of rospy before those of ROS 2."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Find a message package, as an `importlib.abc.MetaPathFinder`; None for other modules."""
        return PathFinder.find_spec(name, [self._folder]) if name.endswith(("_msgs", "_srvs")) else None


def run(options: argparse.Namespace) -> None:
    """Write the message packages."""
    write_packages(options.folder)


def write_packages(folder: Path, interfaces: Path = INTERFACES) -> None:
    """Generate Python packages of messages and services of ROS 1 in a folder, which the user adds to PYTHONPATH."""
    find_rospy()
    from genpy.generate_initpy import write_modules
    from genpy.generator import MsgGenerator, SrvGenerator

    search_path = {package.name: [str(package / "msg")] for package in interfaces.iterdir()}
    for definition in sorted(interfaces.glob("*/*/*")):
        package, module = definition.parts[-3:-1]
        if package == _INSTALLED_PACKAGE:
            continue
        generator = MsgGenerator() if module == "msg" else SrvGenerator()
        out = folder / package / module
        exit_status = generator.generate_messages(package, [str(definition)], str(out), search_path)
        assert exit_status == 0, "genpy has printed the reason"
        write_modules(str(out))
        init = folder / package / "__init__.py"
        if not init.exists():
            init.write_text(_PACKAGE_INIT, encoding="utf-8")
