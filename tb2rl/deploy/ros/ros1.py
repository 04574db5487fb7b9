"""ROS 1 by rospy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.ros.debian import INSTALL, find_rospy
from tb2rl.deploy.ros.generated_messages import write_packages
from tb2rl.deploy.ros.messages import BILLION, LATEST_ONLY
from tb2rl.deploy.ros.node import QUEUE, SET_PHYSICS, Endpoint, M, Node, Publisher
from tb2rl.deploy.ros.protocols import OutgoingMessage

find_rospy()

import rosgraph  # noqa: E402 (now they can be found)
import rospy  # noqa: E402

_SIM_TIME = "/use_sim_time"


class Ros1Node(Node):
    """A node of ROS 1.

    Raises:
        InputError: If no master answers.
    """

    version, install = 1, f"on Debian and Ubuntu: {INSTALL}"

    def __init__(self, name: str) -> None:
        try:
            online = rosgraph.is_master_online()
        except (OSError, ValueError):  # ROS_MASTER_URI is no address
            online = False
        if not online:
            raise InputError(
                f"no ROS master answers at {rosgraph.get_master_uri()}: start one with `rosmaster --core` or "
                "`roscore`, or set ROS_MASTER_URI to the address of yours"
            )
        if rospy.is_shutdown():
            raise InputError("rospy joins ROS once in the life of a process: start another process")
        rospy.init_node(name, disable_signals=True)
        self._announced = False

    def time(self, nanoseconds: int) -> Any:
        return rospy.Time(*divmod(nanoseconds, BILLION))

    def uint8_array(self, data: bytes) -> bytes:
        return data

    def _create_publisher(self, topic: str, message_type: type[OutgoingMessage]) -> Publisher:
        publisher = rospy.Publisher(topic, self.get_type(message_type.kind), queue_size=QUEUE)
        return Publisher(publisher.get_num_connections, publisher.publish, self)

    def _create_subscription(self, topic: str, message_type: type[M], callback: Callable[[M], None]) -> Endpoint:
        def convert(message: Any) -> None:
            callback(message_type.from_ros(message))

        queue = 1 if message_type in LATEST_ONLY else None
        ros_type = self.get_type(message_type.kind)
        return Endpoint(
            rospy.Subscriber(topic, ros_type, convert, queue_size=queue, tcp_nodelay=True).get_num_connections
        )

    def create_service(self, service: str, kind: str, callback: Callable[[], str | None]) -> None:
        service_type = self._set_physics() if kind == SET_PHYSICS else self.get_type(kind, "srv")
        response = service_type._response_class  # rospy's generated classes have no public name for it

        def answer(request: Any) -> Any:
            failure = callback() or ""
            if "success" not in response.__slots__:
                return response()
            return response(not failure, failure)  # Gazebo's response begins with the same two fields

        rospy.Service(service.replace("~/", "~"), service_type, answer)

    def call(self, service: str, kind: str) -> bool:
        code, _, _ = rospy.get_master().lookupService(service)
        if code != 1:
            return False
        try:
            rospy.ServiceProxy(service, self.get_type(kind, "srv"))()
        except rospy.ServiceException as error:
            raise InputError(one_line(f"the service {service} failed: {error}")) from None
        return True

    def now(self) -> float:
        return rospy.get_time()

    def uses_sim_time(self) -> bool:
        return not rospy.rostime.is_wallclock()

    def announce_sim_time(self) -> None:
        self._announced = not rospy.get_param(_SIM_TIME, False)
        rospy.set_param(_SIM_TIME, True)

    def is_shutdown(self) -> bool:
        return rospy.is_shutdown()

    def close(self) -> None:
        with suppress(OSError):  # the master may have ended first
            if self._announced:
                rospy.delete_param(_SIM_TIME)  # otherwise later programs wait for a clock that has stopped
        rospy.signal_shutdown("the program has ended")

    def _set_physics(self) -> Any:
        """Return the class of the service, generated from our definition if Gazebo's messages are not installed."""
        found = self.find_type(SET_PHYSICS, "srv")
        if found is not None:
            return found
        with TemporaryDirectory() as folder:
            write_packages(Path(folder))
            sys.path.append(folder)
            try:
                return self.find_type(SET_PHYSICS, "srv")
            finally:
                sys.path.remove(folder)
