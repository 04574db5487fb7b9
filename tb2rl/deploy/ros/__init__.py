"""ROS 1 and ROS 2: policies drive robots, and programs of ROS drive our simulated robot.

`node` is the interface to ROS, which `ros1` (rospy) and `ros2` (rclpy) implement; `create_node` imports only one of
them. All other modules are independent of ROS: `messages` are plain values, `simulation_server` connects a
`simulated_robot`, `driver_node` connects a driver, and `robot` makes an environment of a robot, with `remote` as its
simulator.
"""

from collections.abc import Sequence

from tb2rl.core.errors import InputError
from tb2rl.deploy.ros.node import Node


def create_node(version: int, name: str, arguments: Sequence[str] = ()) -> Node:
    """Join ROS 1 or ROS 2, as the environment variables configure it.

    `arguments` are the command line arguments after `--ros-args`, for ROS 2.

    Raises:
        InputError: If this version of ROS is not installed, does not answer, or rejects the arguments.
    """
    if version == 1 and arguments:
        raise InputError("--ros-args needs --ros 2")
    if version == 1:
        from tb2rl.deploy.ros.ros1 import Ros1Node

        return Ros1Node(name)
    from tb2rl.deploy.ros.ros2 import Ros2Node

    return Ros2Node(name, arguments)
