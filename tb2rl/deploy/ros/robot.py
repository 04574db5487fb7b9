"""Environments of a robot with ROS: `make_env(policy, simulation="ros")`, or with a `RosRobot` for other settings.

Episodes begin where the robot stands, on a floor without walls: x ahead, y to the left. A policy that plans on a map
needs the map's world: there they begin at its start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

from tb2rl.core.errors import InputError
from tb2rl.core.values import Positive, build, checked
from tb2rl.deploy import Mounting, Needs, SpeedLimits
from tb2rl.deploy.needs import needs_in
from tb2rl.deploy.ros.connection import create_node
from tb2rl.deploy.ros.remote import RemoteRobot
from tb2rl.deploy.ros.topics import TURTLEBOT2, DriverTopics
from tb2rl.deploy.trained import floor
from tb2rl.envs.scene import Scene
from tb2rl.simulation import SimulationSpec, SimulatorType

NAME = "tb2rl_environment"  # of the node
_UPSIDE_DOWN = "upside-down"


@dataclass(frozen=True)
class RosRobot:
    """Connection to a robot and its properties.

    Attributes:
        ros: Version of ROS, 1 or 2.
        topics: Topic names that differ from a TurtleBot2's, by the keys of `tb2rl.deploy.ros.topics.DriverTopics`.
        mounting: Pose of its scanner.
        limits: Limits of its commands.
        goal: Goal of a task that has one: x, y [m] ahead and to the left of the start of an episode, or on the map of a
            policy that plans on one; None: `task.goal`.
        arguments: Command line arguments behind `--ros-args`; for ROS 2.
    """

    ros: int = 1
    topics: Mapping[str, str] = field(default_factory=dict)
    mounting: Mounting = field(default_factory=Mounting)
    limits: SpeedLimits = field(default_factory=SpeedLimits)
    goal: tuple[float, float] | None = None
    arguments: tuple[str, ...] = ()

    def simulator_type(self) -> SimulatorType:
        """The robot as a simulator, see `find_simulator`; there is one connection at a time.

        Raises:
            InputError: If there is no such ROS.
        """
        if self.ros not in TURTLEBOT2:
            raise InputError(f"there is ROS 1 and ROS 2, got {self.ros!r}")
        if self.arguments and self.ros == 1:
            raise InputError("--ros-args is for --ros 2")
        return SimulatorType(
            name="ros",
            title="a robot with ROS",
            make=self._connect,
            is_robot=True,
            prepare=lambda scene: robot_scene(scene, self.goal),
        )

    def _connect(self, spec: SimulationSpec, num_envs: int) -> RemoteRobot:
        topics = build(DriverTopics, {**asdict(TURTLEBOT2[self.ros]), **self.topics}, "topics")
        laser, robot = spec.laser, spec.robot
        limits = 1.0, robot.max_speed, robot.max_turn_rate, robot.name
        node = create_node(self.ros, NAME, self.arguments)
        try:
            needs = Needs(laser.angles, laser.min_range, laser.max_range, *limits)
            return RemoteRobot(spec, needs, node, topics, self.mounting, self.limits)
        except BaseException:
            node.close()
            raise


SIMULATOR = RosRobot().simulator_type()


def robot_scene(scene: Scene, goal: tuple[float, float] | None = None) -> Scene:
    """Adapt a scene to a robot: without variation, and in a world without walls unless the policy plans on a map.

    Args:
        scene: Scene in which the policy was trained.
        goal: See `RosRobot`.

    Raises:
        InputError: If a robot cannot do the task.
    """
    task, plans_on_map = scene.task, needs_in(scene).goal == "plan"
    worlds = scene.spec.worlds
    if plans_on_map and len(worlds) > 1:
        raise InputError(f"a path is planned on one map, and {scene.place} are {len(worlds)}: name yours by task.world")
    if goal is not None and not hasattr(task, "goal"):
        raise InputError("a goal goes with a task that has one, such as navigate")
    goal = goal or getattr(task, "goal", None)
    if task.goal_task and goal is None and not (plans_on_map and worlds[0].goal):
        raise InputError("the task needs a goal, such as --goal 3,0.5: m ahead and to the left of the robot's start")
    if not plans_on_map:
        worlds = (floor((0.0, 0.0), goal or (0.0, 0.0)),)
    worlds = tuple(replace(world, dynamic_obstacles=()) for world in worlds)
    goals = {} if goal is None else {"goal": goal}
    return scene.in_worlds(worlds, start="fixed", variation="none", dynamic_obstacles=None, laser_noise=0.0, **goals)


def parse_mounting(text: str) -> Mounting:
    """Parse "x,y,yaw" or "x,y,yaw,upside-down".

    Raises:
        InputError: For another form.
    """
    *numbers, last = text.split(",")
    upside_down = last == _UPSIDE_DOWN
    try:
        x, y, yaw = map(float, numbers if upside_down else [*numbers, last])
    except ValueError:
        x = y = yaw = math.nan
    if not all(map(math.isfinite, (x, y, yaw))):
        raise InputError(
            f"--mounting takes x,y,yaw or x,y,yaw,{_UPSIDE_DOWN} in m and rad, such as 0.1,0,3.14159, got {text!r}"
        )
    return Mounting(x, y, yaw, upside_down)


def parse_limits(speed: float | None, option: str = "--speed") -> SpeedLimits:
    """Return the limits for a speed [m/s]; None: those of the policy."""
    return SpeedLimits() if speed is None else SpeedLimits(speed=checked(Positive, speed, option))
