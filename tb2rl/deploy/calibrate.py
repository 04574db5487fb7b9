"""The command `ros calibrate`: drives the calibration drive on a robot with ROS, and records it as a bag."""

import argparse
import shlex
import signal
import sys
import threading
from contextlib import AbstractContextManager, closing, nullcontext
from typing import cast

from tb2rl.core.errors import InputError
from tb2rl.core.values import Positive, checked
from tb2rl.deploy import Driver
from tb2rl.deploy.bags.recorded_node import RecordedNode
from tb2rl.deploy.bags.writing import BagWriter, checked_bag_path, open_writer
from tb2rl.deploy.calibration_drive import MIN_RADIUS, CalibrationDrive
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros import create_node
from tb2rl.deploy.ros.driver_node import NODE_NAME, DriverNode
from tb2rl.deploy.ros.node import Node
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, DriverTopics, parse_topics
from tb2rl.robots.robot import find_robot

_BAG = {1: "drive.bag", 2: "drive"}  # by version of ROS
_QUESTION = f"Radius of the free space around the robot in metres, at least {MIN_RADIUS} (1.5 is good): "


def run(options: argparse.Namespace) -> None:
    """Drive until the manoeuvres are over, or something cuts them short; the bag is kept in both cases.

    Raises:
        InputError: If an argument is invalid, nobody says how large the free space is, or the drive was cut short.
    """
    topics = parse_topics(options.topics, TURTLEBOT2[options.ros])
    mounting, limits = parse_mounting(options.mounting), parse_limits(options.speed)
    robot, path = find_robot(options.robot), checked_bag_path(options.out or _BAG[options.ros])
    try:
        radius = _ask_radius() if options.free is None else checked(Positive, options.free, "--free")
        policy = CalibrationDrive(robot, radius)
    except ValueError as error:
        raise InputError(str(error)) from None
    driver, shutdown = Driver(policy, limits, mounting, options.dry_run), threading.Event()
    for termination_signal in termination_signals():
        signal.signal(termination_signal, lambda *_: shutdown.set())
    bag: AbstractContextManager[BagWriter | None] = nullcontext() if options.dry_run else open_writer(path)
    with bag as writer, closing(RecordedNode(create_node(options.ros, NODE_NAME, options.ros_args), writer)) as node:
        output = "no commands and no bag (dry run)" if options.dry_run else f"commands to {topics.velocity}, bag {path}"
        print(f"calibration drive on ROS {options.ros}: scans from {topics.scan}, {output}", flush=True)
        problem = drive(driver, policy, node, topics, shutdown)
    content = "" if options.dry_run else f"; {path} has the {node.count} messages until then"
    if problem:
        raise InputError(f"the drive was cut short: {problem}{content}")
    if not options.dry_run:
        command = f"python -m tb2rl.calibrate {shlex.quote(str(path))} -o my_robot.yaml"
        print(f"the drive is over: {node.count} messages. Next:\n{command}", flush=True)


def drive(
    driver: Driver, policy: CalibrationDrive, node: RecordedNode, topics: DriverTopics, shutdown: threading.Event
) -> str:
    """Drive the manoeuvres, and stop; returns what cut them short, or an empty string."""
    with closing(CalibrationNode(driver, policy, node, topics)) as driver_node:
        driver_node.run(shutdown)
    if node.error:
        raise node.error
    ended = "a signal ended the program" if shutdown.is_set() else "ROS shut the node down"
    return policy.problem or driver_node.stopped or ("" if policy.done else ended)


class CalibrationNode(DriverNode):
    """A driver node that ends with its policy, and at a contact or a call of `~/stop`."""

    def __init__(self, driver: Driver, policy: CalibrationDrive, node: RecordedNode, topics: DriverTopics) -> None:
        self._policy, self._recorded_node = policy, node
        self.stopped = ""  # why the drive was stopped before its end
        super().__init__(driver, cast(Node, node), topics, waits=False)

    def _is_over(self) -> bool:
        return bool(self._policy.done or self.stopped or self._recorded_node.error) or super()._is_over()

    def _stop(self, *why: str) -> str:
        failure = super()._stop(*why)
        self.stopped = self.stopped or self._command.why
        return failure


def _ask_radius() -> float:
    """Ask for the radius of the free space [m]."""
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError("the robot drives only if it has room: give the radius of the free space, such as --free 1.5")
    try:
        return checked(Positive, float(input(_QUESTION)), "--free")
    except (ValueError, EOFError):
        raise InputError("the radius of the free space must be a number of metres, such as 1.5") from None
