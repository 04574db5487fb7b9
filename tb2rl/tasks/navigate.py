"""TurtleBot2Navigate: reach a goal in an unseen world."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.values import Count, NonNegative, Point, Positive, Worlds
from tb2rl.robots import Robot
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import GoalDirection, GoalDistance
from tb2rl.sensors.motion import ForwardSpeed, LastAction, TurnRate
from tb2rl.sensors.visited import Visited
from tb2rl.sensors.waypoint import LOOKAHEAD, Lookahead, Waypoint, WaypointBearing
from tb2rl.simulation import Draws, InitialState, RobotState, SimulationSpec
from tb2rl.tasks.actions import Actions, Commands, Velocities
from tb2rl.tasks.outcome import Outcome, collision_endings
from tb2rl.tasks.task import Beams, Clearance, Period, Task
from tb2rl.worlds import World
from tb2rl.worlds.goal_paths import GOALS, OWN, shortest_path_length

_COMMANDS = 3  # observed without a plan: those pending at a latency of one step each way, and one more
_APPROACH = 0.02  # [m/s] least speed towards an obstacle at which the robot causes the contact


@dataclass(frozen=True)
class Navigate(Task):
    """Reach any goal in one of many worlds, to within `goal_radius` and without contact.

    With `start: random` an episode starts anywhere and leads to one of a few random goals of its world, or to `goal`;
    with `fixed` it leads from the start of the world to its goal. The robot observes its laser, its speeds, its latest
    commands, and a guide:

    - `goal`: the goal and the places visited lately, by odometry; no map.
    - `plan`: the point `lookahead` ahead on the shortest path. The planner knows the robot's pose and a map: with
      `map: known` that of the world, with `online` the one built from laser scans.

    The reward is the reduction of the path length to the goal [m], so the straight line into a dead end earns nothing.
    If a dynamic obstacle runs into a robot that stands or drives away, the episode continues.
    """

    goal_task: ClassVar[bool] = True

    world: Worlds = "mixed"
    goal: Point | None = None  # [m] x and y; None: the world's goal, or a random one
    guide: Literal["goal", "plan"] = "goal"
    map: Literal["known", "online"] = "known"
    lookahead: Lookahead = LOOKAHEAD  # [m] along the path
    start_clearance: Clearance = 0.25  # [m]
    control_period: Period = 0.1  # [s]
    episode_steps: Count = 600
    beams: Beams | None = 60
    max_speed: Positive = 0.65  # [m/s]; the least is 0
    turn_rate: Positive = 2.0  # [rad/s] to both sides
    named_actions: bool = False  # five commands instead of continuous velocities
    goal_radius: Positive = 0.3  # [m]
    goal_reward: float = 10.0  # replaces the step's reward, like the next one
    collision_reward: float = -10.0
    progress_reward: float = 2.5  # for a metre of path
    step_reward: float = -0.05
    turn_reward: float = -0.02  # at the largest turn rate
    margin: NonNegative = 0.1  # [m] gap between robot and wall, below which a step is penalised
    margin_reward: float = -0.1  # the penalty at contact; it falls to 0 linearly with the gap

    @cached_property
    def actions(self) -> Actions:
        if not self.named_actions:
            return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))
        v, w = self.max_speed, 0.5 * self.turn_rate
        turns = {"left": (0.5 * v, w), "right": (0.5 * v, -w), "spin_left": (0.0, w), "spin_right": (0.0, -w)}
        return Commands(forward=(v, 0.0), **turns)

    @property
    def maps_online(self) -> bool:
        return self.guide == "plan" and self.map == "online"

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        robot, laser = spec.robot, super().sensors(spec)
        speeds = ForwardSpeed(robot), TurnRate(robot)
        if self.guide == "plan":
            return (*laser, Waypoint(self.lookahead), *speeds, LastAction(robot))
        return (*laser, GoalDistance(), GoalDirection(), Visited(), *speeds, LastAction(robot, count=_COMMANDS))

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        return (*super().available_sensors(spec), Waypoint(self.lookahead), WaypointBearing(self.lookahead))

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        if self.goal is None:
            return worlds
        x, y = self.goal
        worlds = tuple(world.with_places(None, (x, y, 0.0)) for world in worlds)
        for world in worlds:
            if math.isinf(shortest_path_length(world, robot.radius)):
                route = f"from the start to the goal ({x:g}, {y:g})"
                raise InputError(f"world {world.name}: {robot.name} finds no way {route}")
        return worlds

    def initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        initial_state = super().initial_state(spec, draws)
        if self.start == "fixed" or self.goal is not None:
            initial_state.goal_path[:] = OWN
            return initial_state
        world, choices = initial_state.world.astype(int), 1 + (draws.uniform(2) * GOALS).astype(int)
        lengths = [spec.goal_paths.path_length(world, choice, initial_state.pose) for choice in choices.T]
        farther = np.where(lengths[0] >= lengths[1], *choices.T)  # because few episodes should start at their goal
        initial_state.goal_path[:], initial_state.goal[:] = farther, spec.goal_paths.goals(world, farther)
        return initial_state

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        distance = np.hypot(*(after.goal - after.pose[:, :2]).T)
        reached, collided = (distance <= self.goal_radius) & ~after.bumped, self._collided(before, after)
        # Path lengths are rounded to squares; near a wall, where the robot fits into none, they can jump.
        most = 1.5 * self.max_speed * self.control_period
        progress = np.clip(before.path_length - after.path_length, -most, most)
        penalty = self.turn_reward * np.abs(after.twist[:, 1]) / self.turn_rate
        if self.margin:
            gap = after.nearest - after.initial_state.rows["radius"]
            penalty = penalty + self.margin_reward * np.clip(self.margin - gap, 0.0, self.margin) / self.margin
        moving = self.progress_reward * progress + self.step_reward + penalty
        reward = np.select([collided, reached], [self.collision_reward, self.goal_reward], moving)
        return Outcome(reward, failed=collision_endings(collided, after), succeeded={"goal": reached})

    def _collided(self, before: RobotState, after: RobotState) -> np.ndarray:
        """Which robots caused a contact with a wall or a dynamic obstacle, bool, shape (num_envs,).

        As in nuPlan's collisions at fault (Karnchanachari et al. 2024, "Towards learning-based planning"), a robot that
        stands or drives away from a dynamic obstacle causes none; nor does turning, because the base is round.
        """
        if after.nearest_is_dynamic is None or not (after.bumped & after.nearest_is_dynamic).any():
            return after.bumped
        speed, (x, y) = np.maximum(before.twist[:, 0], after.command[:, 0]), after.direction_to_obstacle.T
        approach = speed * (np.cos(after.pose[:, 2]) * x + np.sin(after.pose[:, 2]) * y)
        return after.bumped & (~after.nearest_is_dynamic | (approach >= _APPROACH))
