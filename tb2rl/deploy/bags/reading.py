"""Bags read as drives: ROS 1 files, ROS 2 folders, mcap and db3 files, of anybody's robot.

A bag brings definitions of its messages along. They are compared with ROS's own and never used: the library would make
code of them. The library promises no kind of error for a broken file, so all are caught here.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.bags.drive import Drive
from tb2rl.deploy.bags.memory import limited_memory
from tb2rl.deploy.bags.topics import KINDS, find_topics, message_types, rosbags_library

ENDINGS = (".bag", ".mcap", ".db3")
MOST = 2_000_000  # messages that are read of a bag: eleven hours at 50 Hz
MEMORY = 2 * 2**30  # [B] that reading may take
_FARTHEST = 1e9  # [m], [s] what is beyond is a mistake
_LONGEST = 100_000  # characters of a definition; ROS's own have 1 500, comments come on top


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag, whatever is in it."""
    return path.suffix in ENDINGS or (path / "metadata.yaml").is_file()


def read_drive(path: Path, topics: Mapping[str, str]) -> Drive:
    """The drive that a bag holds.

    Args:
        path: Of the bag.
        topics: Topics to read, by the kinds of `tb2rl.deploy.bags.topics`; others are found by their names and types.

    Raises:
        InputError: If `rosbags` is not installed, the bag cannot be read, holds too much or no drive.
    """
    library = rosbags_library()
    if not path.exists():
        raise InputError(one_line(f"there is no bag {path}"))
    try:
        with limited_memory(MEMORY):
            return _read(library, path, topics)
    except InputError as error:
        raise InputError(one_line(f"{path}: {error}")) from None
    except MemoryError:
        raise InputError(f"{path} takes more than {MEMORY / 2**30:.1g} GB of memory to read: cut it first") from None
    except Exception as error:  # whatever a broken file leads to, see above
        said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(one_line(f"{path} is not a bag that can be read ({said})")) from None


def _read(library: Any, path: Path, topics: Mapping[str, str]) -> Drive:
    first = path.suffix == ".bag"
    store = message_types(library, first)
    deserialize = store.deserialize_ros1 if first else store.deserialize_cdr
    with (library.rosbag1 if first else library.rosbag2).Reader(path) as bag:
        counts: dict[str, tuple[str, int]] = {}
        for each in bag.connections:  # of ROS 1: one for each that publishes
            counts[each.topic] = each.msgtype, counts.get(each.topic, ("", 0))[1] + each.msgcount
        found = find_topics(counts, topics)
        if not {"odom", "ground_truth"} & set(found):
            known = ", ".join(f"{topic} ({held})" for topic, (held, _) in sorted(counts.items()))
            raise InputError(f"it has no odometry, so it tells no drive; its topics: {known or 'none'}")
        chosen = [
            each for each in bag.connections if each.topic in found.values() and each.msgtype == counts[each.topic][0]
        ]
        for each in chosen:
            _check_definition(library, store, each)
        rows: dict[str, array[float]] = {kind: array("d") for kind in KINDS}
        kinds = {topic: [kind for kind in found if found[kind] == topic] for topic in found.values()}
        began = None
        for number, (each, stamp, raw) in enumerate(bag.messages(chosen)):
            if number == MOST:
                raise InputError(f"it holds more than {MOST} messages on {', '.join(kinds)}: cut it first")
            began = stamp if began is None else began
            message = deserialize(raw, each.msgtype)
            for kind in kinds[each.topic]:
                rows[kind].append((stamp - began) / 1e9)
                rows[kind].extend(_COLUMNS[kind][1](message))
    tables = {kind: _table(kind, rows[kind]) for kind in KINDS}
    if not len(tables["odom"]) + len(tables["ground_truth"]):
        raise InputError("its odometry tells no place")
    odometry, truth, scans = tables["odom"], tables["ground_truth"], tables["scan"]
    return Drive(path.name, found, odometry, truth, tables["cmd_vel"], scans, tables["bumper"], tables["goal"])


def _check_definition(library: Any, store: Any, connection: Any) -> None:
    """Raise an `InputError` if a bag means something else by the name of a message than ROS does."""
    definition = connection.msgdef
    if definition.format.name != "MSG":  # there is none, or it is written otherwise
        return
    typical = len(definition.data) <= _LONGEST
    parsed = library.typesys.get_types_from_msg(definition.data, connection.msgtype) if typical else {}
    if not parsed or any(store.fielddefs.get(name, ((), ()))[1] != fields for name, (_, fields) in parsed.items()):
        raise InputError(f"its {connection.msgtype} on {connection.topic} is not the one of ROS")


def _motion(message: Any) -> tuple[float, ...]:
    at, turned, moving = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    sin = 2.0 * (turned.w * turned.z + turned.x * turned.y)
    cos = 1.0 - 2.0 * (turned.y * turned.y + turned.z * turned.z)
    return at.x, at.y, math.atan2(sin, cos), moving.linear.x, moving.angular.z


def _nearest(message: Any) -> tuple[float, ...]:
    ranges = message.ranges
    valid = ranges[(ranges >= message.range_min) & (ranges <= min(message.range_max, _FARTHEST))]
    return (float(valid.min(initial=math.inf)),)


def _command(message: Any) -> tuple[float, ...]:
    told = getattr(message, "twist", message)
    return told.linear.x, told.angular.z


def _touch(message: Any) -> tuple[float, ...]:
    return (float(message.data if hasattr(message, "data") else message.state),)


def _goal(message: Any) -> tuple[float, ...]:
    return message.pose.position.x, message.pose.position.y


_COLUMNS: Mapping[str, tuple[int, Callable[[Any], tuple[float, ...]]]] = {  # how many, after the time, and their values
    "odom": (5, _motion),
    "ground_truth": (5, _motion),
    "scan": (1, _nearest),
    "cmd_vel": (2, _command),
    "bumper": (1, _touch),
    "goal": (2, _goal),
}


def _table(kind: str, rows: array[float]) -> np.ndarray:
    """The rows of a kind in the order of time, but for those that are not numbers of this world."""
    table = np.array(rows).reshape(-1, 1 + _COLUMNS[kind][0])
    table = table[np.argsort(table[:, 0], kind="stable")]
    checked = table[:, :1] if kind == "scan" else table  # a scan that hit nothing is inf
    return table[(np.abs(checked) < _FARTHEST).all(axis=1)]
