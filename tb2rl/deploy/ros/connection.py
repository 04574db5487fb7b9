"""Connection to ROS 1 or ROS 2."""

from __future__ import annotations

from collections.abc import Sequence

from tb2rl.deploy.ros.node import Node


def create_node(version: int, name: str, arguments: Sequence[str] = ()) -> Node:
    """Join ROS 1 or ROS 2 as the environment configures it; only this ROS is imported.

    `arguments` are those behind `--ros-args` of a command line, for ROS 2.

    Raises:
        InputError: If this ROS is not installed, its master does not answer, or it rejects the arguments.
    """
    if version == 1:
        from tb2rl.deploy.ros.ros1 import Ros1Node

        return Ros1Node(name)
    from tb2rl.deploy.ros.ros2 import Ros2Node

    return Ros2Node(name, arguments)
