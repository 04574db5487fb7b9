"""A node of ROS 1, implemented with rospy."""

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.ros.debian import INSTALL_COMMAND, find_rospy, write_packages
from tb2rl.deploy.ros.messages import BILLION, Message
from tb2rl.deploy.ros.node import QUEUE_SIZE, SET_PHYSICS, Endpoint, Node

find_rospy()

import rosgraph  # noqa: E402 (after `find_rospy`)
import rospy  # noqa: E402

_SIM_TIME_PARAMETER = "/use_sim_time"


class Ros1Node(Node):
    """A node of ROS 1; raises an `InputError` if no master answers, or this process has left ROS 1 already."""

    version, install_hint = 1, f"on Debian and Ubuntu: {INSTALL_COMMAND}"

    def __init__(self, name: str) -> None:
        is_online = False
        with suppress(OSError, ValueError):  # if ROS_MASTER_URI is not an address
            is_online = rosgraph.is_master_online()
        if not is_online:
            hint = "start one with `rosmaster --core` or `roscore`, or set ROS_MASTER_URI to its address"
            raise InputError(f"no ROS master answers at {rosgraph.get_master_uri()}: {hint}")
        if rospy.is_shutdown():
            raise InputError("a process can join ROS 1 only once: start another process")
        rospy.init_node(name, disable_signals=True)
        self._has_set_sim_time = False

    def make_time(self, nanoseconds: int) -> Any:
        return rospy.Time(*divmod(nanoseconds, BILLION))

    def make_array(self, values: np.ndarray) -> Any:
        return values.tobytes() if values.dtype == np.uint8 else super().make_array(values)

    def _publisher(self, topic: str, message_type: type[Message], ros_type: Any) -> Endpoint:
        publisher = rospy.Publisher(topic, ros_type, queue_size=QUEUE_SIZE)
        return Endpoint(publisher.get_num_connections, lambda message: publisher.publish(message.to_ros(self)))

    def _subscription(
        self, topic: str, ros_type: Any, latest_only: bool, receive: Callable[[Any], None], depth: int | None
    ) -> Endpoint:
        queue_size = depth or (1 if latest_only else None)
        subscriber = rospy.Subscriber(topic, ros_type, receive, queue_size=queue_size, tcp_nodelay=True)
        return Endpoint(subscriber.get_num_connections)

    def create_service(self, service: str, type_name: str, callback: Callable[[], str | None]) -> None:
        service_type = self._find_set_physics() if type_name == SET_PHYSICS else self.find_type(type_name, "srv")
        response_type = service_type._response_class  # has no public name

        def answer(request: Any) -> Any:
            failure = callback() or ""  # the responses of Trigger and `SET_PHYSICS` begin with success and a message
            return response_type(not failure, failure) if "success" in response_type.__slots__ else response_type()

        rospy.Service(service.replace("~/", "~"), service_type, answer)

    def call(self, service: str, type_name: str) -> bool:
        is_offered = rospy.get_master().lookupService(service)[0] == 1
        try:
            if is_offered:
                rospy.ServiceProxy(service, self.find_type(type_name, "srv"))()
        except rospy.ServiceException as error:
            raise InputError(one_line(f"the service {service} failed: {error}")) from None
        return is_offered

    def now(self) -> float:
        return rospy.get_time()

    def uses_sim_time(self) -> bool:
        return not rospy.rostime.is_wallclock()

    def announce_sim_time(self) -> None:
        self._has_set_sim_time = not rospy.get_param(_SIM_TIME_PARAMETER, False)
        rospy.set_param(_SIM_TIME_PARAMETER, True)

    def is_shutdown(self) -> bool:
        return rospy.is_shutdown()

    def close(self) -> None:
        with suppress(OSError):  # the master may have ended first
            if self._has_set_sim_time:
                rospy.delete_param(_SIM_TIME_PARAMETER)  # otherwise later programs wait for a clock that has stopped
        rospy.signal_shutdown("the program has ended")

    def _find_set_physics(self) -> Any:
        """Return the class of `SET_PHYSICS`, generated from `interfaces/` if Gazebo's messages are not installed."""
        if service_type := self.find_type(SET_PHYSICS, "srv", optional=True):
            return service_type
        with TemporaryDirectory() as folder:
            write_packages(Path(folder))
            sys.path.append(folder)  # may stay in the path, because Python ignores folders that do not exist
            return self.find_type(SET_PHYSICS, "srv")
