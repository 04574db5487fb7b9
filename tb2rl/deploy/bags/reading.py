"""Reads drives from bags of any robot: ROS 1 files, ROS 2 folders, mcap and db3 files.

A bag contains definitions of its message types, from which the library would generate code. For safety they are only
compared with the definitions of ROS. `read_drive` catches all exceptions, because the library documents none.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.bags.drive import Drive
from tb2rl.deploy.bags.messages import BagMessages, rosbags_library
from tb2rl.deploy.bags.topics import MAX_VALUE, TOPIC_KINDS, find_topics

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
MAX_MESSAGES = 2_000_000  # eleven hours at 50 Hz


def is_bag(path: Path) -> bool:
    """Whether a path looks like the path of a bag."""
    return path.suffix in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def read_drive(path: Path, topics: Mapping[str, str]) -> Drive:
    """Read the drive in a bag.

    Args:
        path: The bag.
        topics: Topics that the user chose, by kind; the others are found by their names and types, see `find_topics`.

    Raises:
        InputError: If `rosbags` is not installed, or the bag cannot be read, is too large or has no odometry.
    """
    rosbags_library()
    if not path.exists():
        raise InputError(one_line(f"there is no bag {path}"))
    try:
        return _read(path, topics)
    except InputError as error:
        raise InputError(one_line(f"{path}: {error}")) from None
    except Exception as error:
        raise InputError(one_line(f"cannot read the bag {path}: {error!r}")) from None


def _read(path: Path, topics: Mapping[str, str]) -> Drive:
    library, messages = rosbags_library(), BagMessages(1 if path.suffix == ".bag" else 2)
    with (library.rosbag1 if messages.ros == 1 else library.rosbag2).Reader(path) as bag:
        available = {name: (topic.msgtype or "several types", topic.msgcount) for name, topic in bag.topics.items()}
        found = find_topics(available, topics)
        if not {"odom", "ground_truth"} & set(found):
            name_list = ", ".join(f"{topic} ({message_type})" for topic, (message_type, _) in sorted(available.items()))
            raise InputError(f"the bag has no odometry; its topics: {name_list or 'none'}")
        connections = [connection for connection in bag.connections if connection.topic in found.values()]
        for connection in connections:
            _check_definition(messages.store, connection)
        values: dict[str, array[float]] = {kind: array("d") for kind in TOPIC_KINDS}
        start = None  # [ns] of the first message
        for count, (connection, stamp, raw) in enumerate(bag.messages(connections)):
            if count == MAX_MESSAGES:
                name_list = ", ".join(dict.fromkeys(found.values()))
                raise InputError(f"the bag has more than {MAX_MESSAGES} messages on {name_list}: cut it first")
            start = stamp if start is None else start
            message = messages.deserialize(raw, connection.msgtype)
            for kind in found:
                if found[kind] == connection.topic:
                    values[kind].extend(((stamp - start) / 1e9, *TOPIC_KINDS[kind].convert(message)))
    tables = {kind: _make_table(kind, values[kind]) for kind in TOPIC_KINDS}
    if not len(tables["odom"]) + len(tables["ground_truth"]):
        raise InputError("the odometry has no valid pose")
    return Drive(path.name, found, *tables.values())


def _check_definition(store: Any, connection: Any) -> None:
    """Raise an `InputError` if the bag defines a message type differently from ROS."""
    definition = connection.msgdef
    if definition.format.name != "MSG":  # there is no definition, or one in another language
        return
    parsed = rosbags_library().typesys.get_types_from_msg(definition.data, connection.msgtype)
    if any(store.fielddefs.get(name, ((), ()))[1] != fields for name, (_, fields) in parsed.items()):
        raise InputError(f"{connection.msgtype} on {connection.topic} is defined differently from ROS")


def _make_table(kind: str, values: array[float]) -> np.ndarray:
    """Make a table in the order of time, without rows that have NaN, infinite or implausible values."""
    table = np.array(values).reshape(-1, 1 + TOPIC_KINDS[kind].value_count)
    table = table[np.argsort(table[:, 0], kind="stable")]
    checked_columns = table[:, :1] if kind == "scan" else table  # a shortest range may be inf
    return table[(np.abs(checked_columns) < MAX_VALUE).all(axis=1)]
