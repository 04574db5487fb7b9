"""Writes messages to a ROS bag: a file (ROS 1), or a folder with an mcap file (ROS 2)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core import InputError, check_output, one_line
from tb2rl.core.files import atomic_write
from tb2rl.deploy.bags.messages import BagMessages, rosbags_library
from tb2rl.deploy.ros.messages import Message


class BagWriter:
    """Writes messages to an open bag; `open_writer` makes it."""

    def __init__(self, bag: Any, messages: BagMessages) -> None:
        self._bag, self.messages = bag, messages
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, message: Any, time: int) -> None:
        """Write a message, ours or of `messages`, with its time in the bag [ns]."""
        message = message.to_ros(self.messages) if isinstance(message, Message) else message
        if topic not in self._connections:
            store = self.messages.store
            self._connections[topic] = self._bag.add_connection(topic, message.__msgtype__, typestore=store)
        self._bag.write(self._connections[topic], time, self.messages.serialize(message))


def checked_bag_path(path: str | Path) -> Path:
    """Return the path of a bag, if the bag can be written.

    Raises:
        InputError: If the path is invalid, or exists (a file NAME.bag is replaced), or `rosbags` is not installed.
    """
    path = Path(path)
    rosbags_library()
    if path.suffix not in ("", ".bag"):
        raise InputError(f"the bag is {str(path)!r}; give a file NAME.bag (ROS 1) or a folder without a dot (ROS 2)")
    if path.exists() and not path.suffix:
        raise InputError(f"cannot write {path}: it exists already; remove it, or give another name")
    check_output(path)
    return path


@contextmanager
def open_writer(path: Path) -> Iterator[BagWriter]:
    """Open a bag at a path from `checked_bag_path`. A bag appears there only if the block ends without an error.

    Raises:
        InputError: If the bag cannot be written.
    """
    library, messages = rosbags_library(), BagMessages(1 if path.suffix else 2)
    try:
        if messages.ros == 1:
            with atomic_write(path) as temporary, library.rosbag1.Writer(temporary) as bag:
                yield BagWriter(bag, messages)
        else:
            plugin = library.rosbag2.StoragePlugin.MCAP
            with TemporaryDirectory(dir=path.absolute().parent, prefix=".") as parent:
                folder = Path(parent, path.name)  # the final name, because a bag stores its own name
                with library.rosbag2.Writer(folder, version=8, storage_plugin=plugin) as bag:
                    yield BagWriter(bag, messages)
                folder.rename(path)
    except OSError as error:
        raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None
