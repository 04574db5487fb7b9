"""Environments of a robot with ROS: `make_env(policy, simulation="ros")`, or with a `RosRobot` for other settings.

An episode begins at the pose of the robot, in an empty world: x ahead, y to the left. If the policy plans on a map, the
world is that map, and an episode begins at the start of the map.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

from tb2rl.core.errors import InputError
from tb2rl.core.values import Positive, build, checked
from tb2rl.deploy import Mounting, Needs, ScanReader, SpeedLimits
from tb2rl.deploy.description import find_needs
from tb2rl.deploy.ros import create_node
from tb2rl.deploy.ros.remote import RemoteRobot
from tb2rl.deploy.ros.topics import TURTLEBOT2, DriverTopics
from tb2rl.deploy.trained import make_empty_world
from tb2rl.envs.scene import Scene
from tb2rl.simulation import SimulationSpec, SimulatorType

_UPSIDE_DOWN = "upside-down"


@dataclass(frozen=True)
class RosRobot:
    """Connection to a robot and its properties.

    Attributes:
        ros: Version of ROS, 1 or 2.
        topics: Topic names other than those of a TurtleBot2, by the keys of `tb2rl.deploy.ros.topics.DriverTopics`.
        mounting: Pose of the scanner.
        limits: Limits of the commands.
        goal: Goal x, y [m] ahead and to the left of the start of an episode, or on the map; None: `task.goal`.
        arguments: Command line arguments after `--ros-args`, for ROS 2.
    """

    ros: int = 1
    topics: Mapping[str, str] = field(default_factory=dict)
    mounting: Mounting = field(default_factory=Mounting)
    limits: SpeedLimits = field(default_factory=SpeedLimits)
    goal: tuple[float, float] | None = None
    arguments: tuple[str, ...] = ()

    def simulator_type(self) -> SimulatorType:
        """The robot as a type of simulator, for `find_simulator`; a robot allows one connection at a time."""
        if self.ros not in TURTLEBOT2:
            raise InputError(f"ros is {self.ros!r}; give 1 or 2")
        title, prepare = "a robot with ROS", lambda scene: adapt_scene(scene, self.goal)
        return SimulatorType(name="ros", title=title, make=self._connect, is_external=True, prepare=prepare)

    def _connect(self, spec: SimulationSpec, num_envs: int) -> RemoteRobot:
        topics = build(DriverTopics, {**asdict(TURTLEBOT2[self.ros]), **self.topics}, "topics")
        laser, robot = spec.laser, spec.robot
        other_needs = 1.0, robot.max_speed, robot.max_turn_rate, robot.name  # a `ScanReader` does not use them
        node = create_node(self.ros, "tb2rl_environment", self.arguments)
        needs = Needs(laser.angles, laser.min_range, laser.max_range, *other_needs)
        return RemoteRobot(spec, node, topics, ScanReader(needs, self.mounting), self.limits)


SIMULATOR = RosRobot().simulator_type()


def adapt_scene(scene: Scene, goal: tuple[float, float] | None = None) -> Scene:
    """Adapt the scene of a training to a real robot: no variation, and no walls unless the policy plans on a map.

    Raises:
        InputError: If there are several maps, a goal is missing or superfluous, or no robot senses an observation.
    """
    task, worlds, plans_on_map = scene.task, scene.spec.worlds, find_needs(scene).goal == "plan"
    if plans_on_map and len(worlds) > 1:
        raise InputError(f"{scene.worlds_title} are {len(worlds)} maps: set task.world to the map of the robot")
    if goal is not None and not hasattr(task, "goal"):
        raise InputError("the task has no goal: omit the goal, or take a task such as navigate")
    goal = goal or getattr(task, "goal", None)
    if task.goal_task and goal is None and not (plans_on_map and worlds[0].goal):
        raise InputError("the task needs a goal, such as --goal 3,0.5: [m] ahead and to the left of the start")
    if not plans_on_map:
        worlds = (make_empty_world((0.0, 0.0), goal or (0.0, 0.0)),)
    worlds = tuple(replace(world, dynamic_obstacles=()) for world in worlds)
    override = {} if goal is None else {"goal": goal}
    return scene.in_worlds(worlds, start="fixed", variation="none", dynamic_obstacles=None, laser_noise=0.0, **override)


def parse_mounting(text: str) -> Mounting:
    """Parse "x,y,yaw" or "x,y,yaw,upside-down"; raises an `InputError` for any other text."""
    pose = text.removesuffix(f",{_UPSIDE_DOWN}")
    try:
        x, y, yaw = map(float, pose.split(","))
        return Mounting(x, y, yaw, upside_down=pose != text)
    except ValueError:
        forms = f"x,y,yaw or x,y,yaw,{_UPSIDE_DOWN} in m and rad, such as 0.1,0,3.14159"
        raise InputError(f"--mounting is {text!r}; give {forms}") from None


def parse_limits(speed: float | None, option: str = "--speed") -> SpeedLimits:
    """Return the limits for a maximum speed [m/s]; None: no limit."""
    return SpeedLimits() if speed is None else SpeedLimits(speed=checked(Positive, speed, option))
