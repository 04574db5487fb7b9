"""Topic names; those of a TurtleBot2 are the defaults."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Annotated, TypeVar

from pydantic import AfterValidator

from tb2rl.core.errors import InputError
from tb2rl.core.values import build

_NAME = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", flags=re.ASCII)


def _check_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError("must be the name of a topic, such as /scan")
    return name


Topic = Annotated[str, AfterValidator(_check_name)]


@dataclass(frozen=True)
class Topics:
    """Topics of the simulated robot: those of the 2018 tutorial's robot in Gazebo."""

    velocity: Topic = "/cmd_vel"  # commands to the base
    navigation: Topic = "/cmd_vel_mux/input/navi"  # the same, by the TurtleBot2's multiplexer
    scan: Topic = "/kobuki/laser/scan"
    odometry: Topic = "/odom"
    colours: Topic = "/camera/rgb/image_raw"
    depth: Topic = "/camera/depth/image_raw"
    bumper: Topic = "/mobile_base/events/bumper"


@dataclass(frozen=True)
class DriverTopics:
    """Topics of a node that drives a robot: those of a TurtleBot2 with ROS 1.

    The multiplexer gives its safety controller and manual control priority over its navigation input.
    """

    velocity: Topic = "/cmd_vel_mux/input/navi"
    scan: Topic = "/scan"
    odometry: Topic = "/odom"
    bumper: Topic = "/mobile_base/events/bumper"
    goal: Topic = "/move_base_simple/goal"  # RViz: 2D Nav Goal
    plan: Topic = "/move_base/NavfnROS/plan"


TURTLEBOT2 = {  # by the version of ROS
    1: DriverTopics(),
    2: DriverTopics(velocity="/cmd_vel", bumper="/events/bumper", goal="/goal_pose", plan="/plan"),
}
T = TypeVar("T", Topics, DriverTopics)


def parse_topics(pairs: Iterable[str], defaults: T) -> T:
    """Parse topics from the command line, such as "scan=/scan".

    Raises:
        InputError: For a pair without "=", an unknown key, or an invalid name.
    """
    names = asdict(defaults)
    for pair in pairs:
        key, equals, name = pair.partition("=")
        if not equals:
            raise InputError(f"--topics takes KEY=TOPIC, for example scan=/scan, got {pair!r}")
        names[key] = name
    return build(type(defaults), names, "--topics")
