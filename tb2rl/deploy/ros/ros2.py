"""A node of ROS 2, implemented with rclpy."""

import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Event, Thread
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.deploy.ros.messages import BILLION, Image, LaserScan, Message
from tb2rl.deploy.ros.node import QUEUE_SIZE, SET_PHYSICS, Endpoint, Node

_INSTALL_HINT = f"source your installation of ROS 2, or: {install_extra('ros2')}"

try:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
    from rclpy.signals import SignalHandlerOptions
    from rclpy.time import Time
except ImportError as error:
    raise InputError(f"--ros 2 needs rclpy ({error}); {_INSTALL_HINT}") from None

_DISCOVERY_TIMEOUT, _ANSWER_TIMEOUT = 1.0, 30.0  # [s] of a service


class Ros2Node(Node):
    """A node of ROS 2.

    Publishes scans and images with the QoS of sensor data (best effort), as laser drivers do, and all else reliably.
    Receives scans and odometry with either reliability.

    Raises:
        InputError: If ROS rejects the arguments.
    """

    version, install_hint = 2, _INSTALL_HINT

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

    def make_time(self, nanoseconds: int) -> Any:
        return Time(nanoseconds=nanoseconds).to_msg()

    def find_type(self, type_name: str, module: str = "msg", optional: bool = False) -> Any:
        return super().find_type(type_name.replace("kobuki_msgs/", "kobuki_ros_interfaces/"), module, optional)

    def _publisher(self, topic: str, message_type: type[Message], ros_type: Any) -> Endpoint:
        qos = qos_profile_sensor_data if message_type in (LaserScan, Image) else QUEUE_SIZE
        publisher = self._node.create_publisher(ros_type, topic, qos)
        return Endpoint(publisher.get_subscription_count, lambda message: publisher.publish(message.to_ros(self)))

    def _subscription(
        self, topic: str, ros_type: Any, latest_only: bool, receive: Callable[[Any], None], depth: int | None
    ) -> Endpoint:
        def guarded(message: Any) -> None:
            try:
                receive(message)
            except Exception:  # would end the thread that receives all topics
                self._node.get_logger().error(f"a message on {topic} is ignored: {traceback.format_exc()}")

        depth = depth or (qos_profile_sensor_data.depth if latest_only else QUEUE_SIZE)
        best_effort = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(ros_type, topic, guarded, best_effort if latest_only else depth)
        return Endpoint(lambda: self._node.count_publishers(topic))

    def create_service(self, service: str, type_name: str, callback: Callable[[], str | None]) -> None:
        def answer(request: Any, response: Any) -> Any:
            failure = callback() or ""
            if hasattr(response, "success"):
                response.success, response.message = not failure, failure
            return response

        if type_name != SET_PHYSICS:  # only programs of ROS 1 call this service
            self._node.create_service(self.find_type(type_name, "srv"), service, answer)

    def call(self, service: str, type_name: str) -> bool:
        service_type = self.find_type(type_name, "srv")
        client = self._node.create_client(service_type, service)
        try:
            if not client.wait_for_service(_DISCOVERY_TIMEOUT):
                return False
            done, future = Event(), client.call_async(service_type.Request())
            future.add_done_callback(lambda _: done.set())
            if not done.wait(_ANSWER_TIMEOUT):
                raise InputError(f"the service {service} does not answer")
            return True
        finally:
            self._node.destroy_client(client)

    def now(self) -> float:
        return self._node.get_clock().now().nanoseconds / BILLION

    def uses_sim_time(self) -> bool:
        return bool(self._node.get_parameter("use_sim_time").value)

    def announce_sim_time(self) -> None:
        """Do nothing, because each node of ROS 2 has its own setting."""

    def is_shutdown(self) -> bool:
        return not rclpy.ok()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()
