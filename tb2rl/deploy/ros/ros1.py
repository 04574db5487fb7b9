"""ROS 1 by rospy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.ros.debian import INSTALL, find_rospy
from tb2rl.deploy.ros.definitions import write_packages
from tb2rl.deploy.ros.graph import SET_PHYSICS, End, H, Nobody, Publisher, find_kind
from tb2rl.deploy.ros.messages import BILLION, RARE, SENSED, Message

find_rospy()

import rosgraph  # noqa: E402 (now they can be found)
import rospy  # noqa: E402

_QUEUE = 10  # messages wait for a slow listener, then the oldest goes
_SIMULATED = "/use_sim_time"


class Graph1:
    """A node of ROS 1, see `tb2rl.deploy.ros.graph.Graph`.

    Args:
        name: Of the node.

    Raises:
        InputError: If no master answers.
    """

    def __init__(self, name: str) -> None:
        where = rosgraph.get_master_uri()
        try:
            answers = rosgraph.is_master_online()
        except (OSError, ValueError):  # what is not the address of anything
            answers = False
        if not answers:
            raise InputError(
                f"no ROS master answers at {where}: start one with `rosmaster --core` or `roscore`, "
                "or set ROS_MASTER_URI to the address of yours"
            )
        if rospy.is_shutdown():
            raise InputError("rospy joins a graph once in the life of a process: begin another process")
        rospy.init_node(name, disable_signals=True)
        self._keeps_time = False

    def publisher(self, topic: str, kind: type[Message]) -> Publisher:
        if kind in RARE and _find(kind.kind) is None:
            return Nobody()
        return _Publisher(topic, _class(kind.kind))

    def listen(self, topic: str, kind: type[H], heard: Callable[[H], None]) -> End:
        if kind in RARE and _find(kind.kind) is None:
            return Nobody()

        def hear(message: Any) -> None:
            heard(kind.from_ros(message))

        newest = 1 if kind in SENSED else None
        return _End(rospy.Subscriber(topic, _class(kind.kind), hear, queue_size=newest, tcp_nodelay=True))

    def serve(self, service: str, kind: str, called: Callable[[], str | None]) -> None:
        offered = _set_physics() if kind == SET_PHYSICS else _class(kind, "srv")
        response = offered._response_class

        def answer(request: Any) -> Any:
            failed = called() or ""
            if "success" not in response.__slots__:
                return response()
            return response(not failed, failed)  # and so begins that of Gazebo

        rospy.Service(service.replace("~/", "~"), offered, answer)

    def call(self, service: str, kind: str) -> bool:
        code, _, _ = rospy.get_master().lookupService(service)
        if code != 1:
            return False
        try:
            rospy.ServiceProxy(service, _class(kind, "srv"))()
        except rospy.ServiceException as error:
            raise InputError(one_line(f"the service {service} failed: {error}")) from None
        return True

    def now(self) -> float:
        return rospy.get_time()

    def time_is_simulated(self) -> bool:
        return not rospy.rostime.is_wallclock()

    def keep_time(self) -> None:
        self._keeps_time = not rospy.get_param(_SIMULATED, False)
        rospy.set_param(_SIMULATED, True)

    def is_over(self) -> bool:
        return rospy.is_shutdown()

    def close(self) -> None:
        with suppress(OSError):  # the master may have gone first
            if self._keeps_time:
                rospy.delete_param(_SIMULATED)  # else all that begins later waits for a clock that has stopped
        rospy.signal_shutdown("the program has ended")


class _Dialect:
    """See `tb2rl.deploy.ros.messages.Dialect`."""

    def new(self, kind: str) -> Any:
        return _class(kind)()

    def time(self, nanoseconds: int) -> Any:
        return rospy.Time(*divmod(nanoseconds, BILLION))

    def octets(self, data: bytes) -> bytes:
        return data


class _End:
    """See `tb2rl.deploy.ros.graph.End`."""

    def __init__(self, topic: Any) -> None:
        self._topic = topic

    def connected(self) -> bool:
        return self._topic.get_num_connections() > 0


class _Publisher(_End):
    """See `tb2rl.deploy.ros.graph.Publisher`."""

    def __init__(self, topic: str, kind: type) -> None:
        super().__init__(rospy.Publisher(topic, kind, queue_size=_QUEUE))

    def say(self, message: Message) -> None:
        if self.connected():
            self._topic.publish(message.to_ros(_Dialect()))


@cache
def _class(kind: str, part: str = "msg") -> Any:
    found = _find(kind, part)
    if found is None:
        raise InputError(f"there is no {kind} for ROS 1; on Debian and Ubuntu: {INSTALL}")
    return found


def _find(kind: str, part: str = "msg") -> Any:
    package, name = kind.split("/")
    return find_kind(package, part, name)


def _set_physics() -> Any:
    """The class of the service, by our own definition where Gazebo's messages are not installed."""
    found = _find(SET_PHYSICS, "srv")
    if found is not None:
        return found
    with TemporaryDirectory() as folder:
        write_packages(Path(folder))
        sys.path.append(folder)
        try:
            return _find(SET_PHYSICS, "srv")
        finally:
            sys.path.remove(folder)
