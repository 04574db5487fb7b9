"""ROS 2 by rclpy."""

from __future__ import annotations

import traceback
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Event, Thread
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.deploy.ros.messages import BILLION, LATEST_ONLY, Image, LaserScan
from tb2rl.deploy.ros.node import QUEUE, SET_PHYSICS, Endpoint, M, Node, Publisher
from tb2rl.deploy.ros.protocols import OutgoingMessage

_INSTALL = f"source your installation of ROS 2, or: {install_extra('ros2')}"

try:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.qos import qos_profile_sensor_data
    from rclpy.signals import SignalHandlerOptions
except ImportError as error:
    raise InputError(f"--ros 2 needs rclpy ({error}); {_INSTALL}") from None

_DISCOVERY, _ANSWER = 1.0, 30.0  # [s] timeouts for finding a service and for its answer


class Ros2Node(Node):
    """A node of ROS 2.

    It publishes scans and images with the QoS of sensor data (best effort, as laser drivers do), the rest reliably. It
    receives scans and odometry with either reliability.

    Raises:
        InputError: If ROS rejects the arguments.
    """

    version, install = 2, _INSTALL

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        try:
            rclpy.init(args=["--ros-args", *arguments], signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise InputError(one_line(f"--ros-args {' '.join(arguments)}: {error}")) from None
        self._node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def time(self, nanoseconds: int) -> Any:
        message = self.new("builtin_interfaces/Time")
        message.sec, message.nanosec = divmod(nanoseconds, BILLION)
        return message

    def uint8_array(self, data: bytes) -> array[int]:
        return array("B", data)

    def find_type(self, kind: str, part: str = "msg") -> Any:
        return super().find_type(kind.replace("kobuki_msgs/", "kobuki_ros_interfaces/"), part)

    def _create_publisher(self, topic: str, message_type: type[OutgoingMessage]) -> Publisher:
        quality = qos_profile_sensor_data if message_type in (LaserScan, Image) else QUEUE
        publisher = self._node.create_publisher(self.get_type(message_type.kind), topic, quality)
        return Publisher(publisher.get_subscription_count, publisher.publish, self)

    def _create_subscription(self, topic: str, message_type: type[M], callback: Callable[[M], None]) -> Endpoint:
        def convert(message: Any) -> None:
            try:
                callback(message_type.from_ros(message))
            except Exception:  # would end the thread that receives all topics; rospy logs it, too
                self._node.get_logger().error(f"a message on {topic} is ignored: {traceback.format_exc()}")

        quality = qos_profile_sensor_data if message_type in LATEST_ONLY else QUEUE
        self._node.create_subscription(self.get_type(message_type.kind), topic, convert, quality)
        return Endpoint(lambda: self._node.count_publishers(topic))

    def create_service(self, service: str, kind: str, callback: Callable[[], str | None]) -> None:
        def answer(request: Any, response: Any) -> Any:
            failure = callback() or ""
            if hasattr(response, "success"):
                response.success, response.message = not failure, failure
            return response

        if kind != SET_PHYSICS:  # only programs of ROS 1 call it
            self._node.create_service(self.get_type(kind, "srv"), service, answer)

    def call(self, service: str, kind: str) -> bool:
        service_type = self.get_type(kind, "srv")
        client = self._node.create_client(service_type, service)
        try:
            if not client.wait_for_service(_DISCOVERY):
                return False
            answered, answer = Event(), client.call_async(service_type.Request())
            answer.add_done_callback(lambda _: answered.set())
            if not answered.wait(_ANSWER):
                raise InputError(f"the service {service} does not answer")
            return True
        finally:
            self._node.destroy_client(client)

    def now(self) -> float:
        return self._node.get_clock().now().nanoseconds / BILLION

    def uses_sim_time(self) -> bool:
        return bool(self._node.get_parameter("use_sim_time").value)

    def announce_sim_time(self) -> None:
        """Do nothing: each node of ROS 2 has its own setting."""

    def is_shutdown(self) -> bool:
        return not rclpy.ok()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()
