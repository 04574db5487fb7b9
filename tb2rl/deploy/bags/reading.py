"""Reads drives from bags of any robot: ROS 1 files, ROS 2 folders, mcap and db3 files.

A bag contains definitions of its messages. They are compared with those of ROS and never used, because the library
would generate code from them. The library documents no exceptions for broken files, so all are caught here.
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
from tb2rl.deploy.bags.topics import FARTHEST, KINDS, find_topics

ENDINGS = (".bag", ".mcap", ".db3")
MOST = 2_000_000  # messages of a bag that are read: eleven hours at 50 Hz
_LONGEST = 100_000  # characters of a definition; those of ROS have 1 500, and comments


def is_bag(path: Path) -> bool:
    """Whether a path looks like that of a bag."""
    return path.suffix in ENDINGS or (path / "metadata.yaml").is_file()


def read_drive(path: Path, topics: Mapping[str, str]) -> Drive:
    """Read the drive in a bag.

    Args:
        path: The bag.
        topics: Topics to read, by the kinds of `tb2rl.deploy.bags.topics`; others are found by their names and types.

    Raises:
        InputError: If `rosbags` is not installed, or the bag cannot be read, is too large or holds no drive.
    """
    rosbags_library()
    if not path.exists():
        raise InputError(one_line(f"there is no bag {path}"))
    try:
        return _read(path, topics)
    except InputError as error:
        raise InputError(one_line(f"{path}: {error}")) from None
    except Exception as error:  # any, see above
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(one_line(f"{path} is not a bag that can be read ({reason})")) from None


def _read(path: Path, topics: Mapping[str, str]) -> Drive:
    library, messages = rosbags_library(), BagMessages(1 if path.suffix == ".bag" else 2)
    with (library.rosbag1 if messages.ros == 1 else library.rosbag2).Reader(path) as bag:
        counts: dict[str, tuple[str, int]] = {}
        for each in bag.connections:  # in ROS 1 one for each publisher
            counts[each.topic] = each.msgtype, counts.get(each.topic, ("", 0))[1] + each.msgcount
        found = find_topics(counts, topics)
        if not {"odom", "ground_truth"} & set(found):
            known = ", ".join(f"{topic} ({held})" for topic, (held, _) in sorted(counts.items()))
            raise InputError(f"it has no odometry, so it holds no drive; its topics: {known or 'none'}")
        kinds = {topic: [kind for kind in found if found[kind] == topic] for topic in found.values()}
        chosen = [each for each in bag.connections if each.topic in kinds and each.msgtype == counts[each.topic][0]]
        for each in chosen:
            _check_definition(messages.store, each)
        rows: dict[str, array[float]] = {kind: array("d") for kind in KINDS}
        began = None
        for number, (each, stamp, raw) in enumerate(bag.messages(chosen)):
            if number == MOST:
                raise InputError(f"it holds more than {MOST} messages on {', '.join(kinds)}: cut it first")
            began = stamp if began is None else began
            message = messages.deserialize(raw, each.msgtype)
            for kind in kinds[each.topic]:
                rows[kind].append((stamp - began) / 1e9)
                rows[kind].extend(KINDS[kind].convert(message))
    tables = {kind: _table(kind, rows[kind]) for kind in KINDS}
    if not len(tables["odom"]) + len(tables["ground_truth"]):
        raise InputError("its odometry has no valid pose")
    names = ("odom", "ground_truth", "cmd_vel", "scan", "bumper", "goal")
    return Drive(path.name, found, *(tables[name] for name in names))


def _check_definition(store: Any, connection: Any) -> None:
    """Raise an `InputError` if the bag defines a message differently from ROS."""
    definition = connection.msgdef
    if definition.format.name != "MSG":  # without a definition, or in another format
        return
    parsed = {}
    if len(definition.data) <= _LONGEST:
        parsed = rosbags_library().typesys.get_types_from_msg(definition.data, connection.msgtype)
    if not parsed or any(store.fielddefs.get(name, ((), ()))[1] != fields for name, (_, fields) in parsed.items()):
        raise InputError(f"its {connection.msgtype} on {connection.topic} is not the one of ROS")


def _table(kind: str, rows: array[float]) -> np.ndarray:
    """Return the rows of a kind in the order of time, without those of NaN, infinite or implausible values."""
    table = np.array(rows).reshape(-1, 1 + KINDS[kind].columns)
    table = table[np.argsort(table[:, 0], kind="stable")]
    checked = table[:, :1] if kind == "scan" else table  # the nearest range is inf where nothing was hit
    return table[(np.abs(checked) < FARTHEST).all(axis=1)]
