"""ROS 2 by rclpy."""

from __future__ import annotations

import traceback
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from threading import Event, Thread
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.deploy.ros.graph import SET_PHYSICS, End, H, Nobody, Publisher, find_kind
from tb2rl.deploy.ros.messages import BILLION, RARE, SENSED, Image, Message, Scan

_INSTALL = f"source your installation of ROS 2, or: {install_extra('ros2')}"

try:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.qos import qos_profile_sensor_data
    from rclpy.signals import SignalHandlerOptions
except ImportError as error:
    raise InputError(f"--ros 2 needs rclpy ({error}); {_INSTALL}") from None

_DISCOVERY, _ANSWER = 1.0, 30.0  # [s] until services of others are known, and until they answer
_QUEUE = 10  # messages wait for a slow listener, then the oldest goes
_RENAMED = {"kobuki_msgs": "kobuki_ros_interfaces"}  # what has another name in ROS 1


class Graph2:
    """A node of ROS 2, see `tb2rl.deploy.ros.graph.Graph`.

    Scans and images are published as sensors' data (best effort, as drivers of lasers do), all else reliably; scans
    and odometry are heard whichever way they are published.

    Args:
        name: Of the node.
        arguments: What follows `--ros-args`.

    Raises:
        InputError: If ROS does not know these.
    """

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

    def publisher(self, topic: str, kind: type[Message]) -> Publisher:
        if kind in RARE and _find(kind.kind) is None:
            return Nobody()
        quality = qos_profile_sensor_data if kind in (Scan, Image) else _QUEUE
        return _Publisher(self._node.create_publisher(_class(kind.kind), topic, quality))

    def listen(self, topic: str, kind: type[H], heard: Callable[[H], None]) -> End:
        if kind in RARE and _find(kind.kind) is None:
            return Nobody()

        def hear(message: Any) -> None:
            try:
                heard(kind.from_ros(message))
            except Exception:  # it would end the thread that hears all topics, the bumper's, too; rospy does the same
                self._node.get_logger().error(f"a message on {topic} is ignored: {traceback.format_exc()}")

        quality = qos_profile_sensor_data if kind in SENSED else _QUEUE
        self._node.create_subscription(_class(kind.kind), topic, hear, quality)
        return _Listener(self._node, topic)

    def serve(self, service: str, kind: str, called: Callable[[], str | None]) -> None:
        def answer(request: Any, response: Any) -> Any:
            failed = called() or ""
            if hasattr(response, "success"):
                response.success, response.message = not failed, failed
            return response

        if kind != SET_PHYSICS:  # that is for programs of ROS 1 alone
            self._node.create_service(_class(kind, "srv"), service, answer)

    def call(self, service: str, kind: str) -> bool:
        offered = _class(kind, "srv")
        client = self._node.create_client(offered, service)
        try:
            if not client.wait_for_service(_DISCOVERY):
                return False
            answered, answer = Event(), client.call_async(offered.Request())
            answer.add_done_callback(lambda _: answered.set())
            if not answered.wait(_ANSWER):
                raise InputError(f"the service {service} does not answer")
            return True
        finally:
            self._node.destroy_client(client)

    def now(self) -> float:
        return self._node.get_clock().now().nanoseconds / BILLION

    def time_is_simulated(self) -> bool:
        return bool(self._node.get_parameter("use_sim_time").value)

    def keep_time(self) -> None:
        """In ROS 2 each program has a parameter of its own for that."""

    def is_over(self) -> bool:
        return not rclpy.ok()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()


class _Dialect:
    """See `tb2rl.deploy.ros.messages.Dialect`."""

    def new(self, kind: str) -> Any:
        return _class(kind)()

    def time(self, nanoseconds: int) -> Any:
        message = self.new("builtin_interfaces/Time")
        message.sec, message.nanosec = divmod(nanoseconds, BILLION)
        return message

    def octets(self, data: bytes) -> array:
        return array("B", data)


class _Listener:
    """See `tb2rl.deploy.ros.graph.End`."""

    def __init__(self, node: Any, topic: str) -> None:
        self._node, self._topic = node, topic

    def connected(self) -> bool:
        return self._node.count_publishers(self._topic) > 0


class _Publisher:
    """See `tb2rl.deploy.ros.graph.Publisher`."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def connected(self) -> bool:
        return self._publisher.get_subscription_count() > 0

    def say(self, message: Message) -> None:
        if self.connected():
            self._publisher.publish(message.to_ros(_Dialect()))


@cache
def _class(kind: str, part: str = "msg") -> Any:
    found = _find(kind, part)
    if found is None:
        raise InputError(f"there is no {kind} for ROS 2; {_INSTALL}")
    return found


def _find(kind: str, part: str = "msg") -> Any:
    package, name = kind.split("/")
    return find_kind(_RENAMED.get(package, package), part, name)
