"""TurtleBot2Navigate: reach a goal in any world."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.values import Count, NonNegative, Point, Positive, Worlds
from tb2rl.robots import Robot
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import LOOKAHEAD, GoalDirection, GoalDistance, Lookahead, Waypoint, WaypointBearing
from tb2rl.sensors.motion import ForwardSpeed, LastAction, TurnRate, Visited
from tb2rl.simulation import InitialState, RandomSource, RobotState, SimulationSpec
from tb2rl.simulation.obstacles.outlines import directions_to_nearest
from tb2rl.tasks.actions import Actions, Commands, Velocities
from tb2rl.tasks.task import Beams, Clearance, Outcome, Period, Task, collision_endings
from tb2rl.worlds import World
from tb2rl.worlds.goal_paths import OWN_GOAL, RANDOM_GOALS, shortest_path_length

_HISTORY_LENGTH = 3  # observed past commands: the latest, and one more for each latency (commands, observations)
_MIN_APPROACH_SPEED = 0.02  # [m/s] a robot that approaches an obstacle at this speed causes the contact


@dataclass(frozen=True)
class Navigate(Task):
    """Reach any goal in one of many worlds, to within `goal_radius` and without contact.

    With `start: random` an episode starts anywhere and leads to `goal`, or to one of a few random goals of the world.
    With `start: fixed` it leads from the start of the world to `goal`, or to the goal of the world. The robot observes
    its laser, its speeds, its latest commands, and a guide:

    - `guide: goal`: the goal, and where the robot was in the last minute, both by odometry; no map.
    - `guide: plan`: the lookahead point on the shortest path. The planner knows the map of the world and the robot's
      pose (`map: known`), or builds the map from laser scans and estimates the pose (`map: online`).

    The reward for progress is the reduction of the path length to the goal, so driving straight into a dead end earns
    nothing. In this length, a metre near a wall counts as more than a metre. If a dynamic obstacle runs into a robot
    that stands or drives away, the episode continues.
    """

    goal_task: ClassVar[bool] = True

    world: Worlds = "mixed"
    goal: Point | None = None  # x, y [m]; None: the world's goal, or a random goal
    guide: Literal["goal", "plan"] = "goal"  # what leads the robot: the goal, or a planned path
    map: Literal["known", "online"] = "known"  # map of the planner: of the world, or built from laser scans
    lookahead: Lookahead = LOOKAHEAD  # [m] distance from the robot to the lookahead point, along the path
    start_clearance: Clearance = 0.25  # [m]
    control_period: Period = 0.1  # [s]
    episode_steps: Count = 600
    beams: Beams | None = 60
    max_speed: Positive = 0.65  # [m/s] largest forward speed; the lowest is 0
    turn_rate: Positive = 2.0  # [rad/s] largest turn rate to both sides
    named_actions: bool = False  # whether actions are five named commands, not continuous velocities
    goal_radius: Positive = 0.3  # [m] distance to the goal at which it is reached
    goal_reward: float = 10.0  # replaces the reward of the step
    collision_reward: float = -10.0  # replaces the reward of the step
    progress_reward: float = 2.5  # [1/m] reward per metre of path
    step_reward: float = -0.05  # reward of each step
    turn_reward: float = -0.02  # added at `turn_rate`; in proportion at lower turn rates
    margin: NonNegative = 0.1  # [m] gaps between robot and obstacle below this are penalised
    margin_reward: float = -0.1  # added at a gap of 0; at gaps below `margin`, scaled by 1 - gap / margin

    @cached_property
    def actions(self) -> Actions:
        if not self.named_actions:
            return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))
        v, w = self.max_speed, 0.5 * self.turn_rate
        turn_commands = {"left": (0.5 * v, w), "right": (0.5 * v, -w), "spin_left": (0.0, w), "spin_right": (0.0, -w)}
        return Commands(forward=(v, 0.0), **turn_commands)

    @property
    def maps_online(self) -> bool:
        return self.guide == "plan" and self.map == "online"

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        robot, laser = spec.robot, super().sensors(spec)
        speeds = ForwardSpeed(robot), TurnRate(robot)
        if self.guide == "plan":
            return (*laser, Waypoint(self.lookahead), *speeds, LastAction(robot))
        return (*laser, GoalDistance(), GoalDirection(), Visited(), *speeds, LastAction(robot, count=_HISTORY_LENGTH))

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        return (*super().available_sensors(spec), Waypoint(self.lookahead), WaypointBearing(self.lookahead))

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        if self.goal is None:
            return worlds
        x, y = self.goal
        worlds = tuple(world.with_changes(start=None, goal=(x, y, 0.0)) for world in worlds)
        for world in worlds:
            if math.isinf(shortest_path_length(world, robot.radius)):
                raise InputError(f"world {world.name}: no path for {robot.name} from start to goal ({x:g}, {y:g})")
        return worlds

    def initial_state(self, spec: SimulationSpec, random: RandomSource) -> InitialState:
        initial_state = super().initial_state(spec, random)
        if self.start == "fixed" or self.goal is not None:
            initial_state.records["goal_path"] = OWN_GOAL
            return initial_state
        world, goal_numbers = initial_state.world.astype(int), 1 + (random.uniform(2) * RANDOM_GOALS).astype(int)
        lengths = [spec.goal_paths.path_length(world, goal, initial_state.pose) for goal in goal_numbers.T]
        farther = np.where(lengths[0] >= lengths[1], *goal_numbers.T)  # so that few episodes start at their goal
        initial_state.records["goal_path"], initial_state.goal[:] = farther, spec.goal_paths.goals(world, farther)
        return initial_state

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        distance = np.hypot(*(after.goal - after.pose[:, :2]).T)
        reached, collided = (distance <= self.goal_radius) & ~after.bumped, self._collided(before, after)
        # Path lengths come from a grid and can jump near a wall, where no cell has enough clearance.
        max_progress = 1.5 * self.max_speed * self.control_period
        progress = np.clip(before.path_length - after.path_length, -max_progress, max_progress)
        penalty = self.turn_reward * np.abs(after.twist[:, 1]) / self.turn_rate  # a negative reward
        if self.margin:
            gap = after.nearest_range - after.initial_state.records["radius"]
            penalty = penalty + self.margin_reward * np.clip(self.margin - gap, 0.0, self.margin) / self.margin
        moving_reward = self.progress_reward * progress + self.step_reward + penalty
        reward = np.where(reached, self.goal_reward, moving_reward)
        reward = np.where(collided, self.collision_reward, reward)
        return Outcome(reward, failed=collision_endings(collided, after), succeeded={"goal": reached})

    def _collided(self, before: RobotState, after: RobotState) -> np.ndarray:
        """Whether each robot caused a contact with a wall or a dynamic obstacle, bool, shape (num_envs,).

        As in nuPlan's collisions at fault (Karnchanachari et al. 2024, "Towards learning-based planning"), a robot that
        stands, or drives away from a dynamic obstacle, causes no contact, nor does a round base that turns on the spot.
        """
        is_dynamic, outlines = after.nearest_is_dynamic, after.dynamic_obstacles
        if is_dynamic is None or outlines is None or not (after.bumped & is_dynamic).any():
            return after.bumped
        speed = np.maximum(before.twist[:, 0], after.command[:, 0])  # before the contact stopped the robot
        x, y = directions_to_nearest(after.pose, outlines).T
        approach_speed = speed * (np.cos(after.pose[:, 2]) * x + np.sin(after.pose[:, 2]) * y)
        return after.bumped & (~is_dynamic | (approach_speed >= _MIN_APPROACH_SPEED))
