"""Topic names; the defaults are those of a TurtleBot2."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Annotated, TypeVar

from pydantic import StringConstraints

from tb2rl.core.errors import InputError
from tb2rl.core.values import build

Topic = Annotated[str, StringConstraints(pattern="^/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$")]


@dataclass(frozen=True)
class Topics:
    """Topics of the simulated robot; the defaults are those of the tutorial's robot in Gazebo, see FROM_ROS.md."""

    velocity: Topic = "/cmd_vel"  # commands to the base
    navigation: Topic = "/cmd_vel_mux/input/navi"  # commands to the navigation input of the TurtleBot2's multiplexer
    scan: Topic = "/kobuki/laser/scan"
    odometry: Topic = "/odom"
    colours: Topic = "/camera/rgb/image_raw"
    depth: Topic = "/camera/depth/image_raw"
    bumper: Topic = "/mobile_base/events/bumper"
    cliff: Topic = "/mobile_base/events/cliff"
    wheel_drop: Topic = "/mobile_base/events/wheel_drop"
    button: Topic = "/mobile_base/events/button"


@dataclass(frozen=True)
class DriverTopics:
    """Topics of a node that drives a robot; the defaults are those of a TurtleBot2 with ROS 1.

    The velocity multiplexer of the robot gives priority to its safety controller and to manual control.
    """

    velocity: Topic = "/cmd_vel_mux/input/navi"
    scan: Topic = "/scan"
    odometry: Topic = "/odom"
    bumper: Topic = "/mobile_base/events/bumper"
    cliff: Topic = "/mobile_base/events/cliff"
    wheel_drop: Topic = "/mobile_base/events/wheel_drop"
    button: Topic = "/mobile_base/events/button"
    goal: Topic = "/move_base_simple/goal"  # RViz: 2D Nav Goal
    plan: Topic = "/move_base/NavfnROS/plan"


_EVENTS2 = {key: f"/events/{key}" for key in ("bumper", "cliff", "wheel_drop", "button")}
# By version of ROS:
TURTLEBOT2 = {1: DriverTopics(), 2: DriverTopics(velocity="/cmd_vel", goal="/goal_pose", plan="/plan", **_EVENTS2)}
SIMULATED = {1: Topics(), 2: Topics(**_EVENTS2)}
T = TypeVar("T", Topics, DriverTopics)


def parse_topics(pairs: Iterable[str], defaults: T) -> T:
    """Parse topics such as "scan=/scan"; raises an `InputError` for a pair without "=", or an invalid key or name."""
    return build(type(defaults), asdict(defaults) | split_pairs(pairs, "KEY=TOPIC, such as scan=/scan"), "--topics")


def split_pairs(pairs: Iterable[str], form: str) -> dict[str, str]:
    """Split pairs "KEY=TOPIC"; raises an `InputError` if a pair has no "="."""
    try:
        return dict(pair.split("=", 1) for pair in pairs)
    except ValueError:
        raise InputError(f"--topics takes {form}") from None
