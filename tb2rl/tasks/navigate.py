"""TurtleBot2Navigate: get to a goal in a world that was never seen."""

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

_TOLD = 3  # actions: with commands and readings a step late, what the robot is still to do, and one more
_TOWARDS = 0.02  # [m/s] slower than this towards something is not driving into it; to turn is not either, it is round


@dataclass(frozen=True)
class Navigate(Task):
    """Get to within `goal_radius` of the goal without a touch, in a world of many.

    With `start: random` an episode begins anywhere and leads to one of a few random goals of its world, or to `goal`;
    with `fixed` it leads from the world's start to the world's goal. The robot observes its laser, its speeds, what it
    was last told, and what guides it:

    - `goal`: where the goal is, by odometry, and where the robot has been lately. It knows no map.
    - `plan`: a point `lookahead` ahead on the shortest way, as from a planner that knows where the robot is, and the
    map:
      with `map: known` the world's, with `online` what the laser has seen so far.

    What moves and runs into a robot that stands, or drives away from it, ends nothing, for the robot has not driven
    into it: it may go on when the other has gone.

    A step pays the metres by which the way to the goal became shorter, round all obstacles. That is why the straight
    line into a dead end pays nothing.
    """

    goal_task: ClassVar[bool] = True

    world: Worlds = "mixed"
    goal: Point | None = None  # [m] x and y, in place of the world's goal and of random ones
    guide: Literal["goal", "plan"] = "goal"
    map: Literal["known", "online"] = "known"
    lookahead: Lookahead = LOOKAHEAD  # [m] from the robot to the point of the plan, along the way
    start_clearance: Clearance = 0.25  # [m]
    control_period: Period = 0.1  # [s]
    episode_steps: Count = 600
    beams: Beams | None = 60
    max_speed: Positive = 0.65  # [m/s] the slowest is to stand
    turn_rate: Positive = 2.0  # [rad/s] to both sides
    named_actions: bool = False  # five commands in place of any speeds, for learners that choose
    goal_radius: Positive = 0.3  # [m]
    goal_reward: float = 10.0  # replaces the step's, as does a crash's
    collision_reward: float = -10.0
    progress_reward: float = 2.5  # for a metre of way
    step_reward: float = -0.05
    turn_reward: float = -0.02  # at the largest turn rate
    margin: NonNegative = 0.1  # [m] between robot and wall, below which a step is fined
    margin_reward: float = -0.1  # the fine at a touch; farther away it falls to 0 evenly

    @cached_property
    def actions(self) -> Actions:
        if not self.named_actions:
            return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))
        half, some = 0.5 * self.max_speed, 0.5 * self.turn_rate
        return Commands(
            forward=(self.max_speed, 0.0),
            left=(half, some),
            right=(half, -some),
            spin_left=(0.0, some),
            spin_right=(0.0, -some),
        )

    @property
    def maps_online(self) -> bool:
        return self.guide == "plan" and self.map == "online"

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        speeds = ForwardSpeed(spec.robot), TurnRate(spec.robot)
        if self.guide == "plan":
            return (*super().sensors(spec), Waypoint(self.lookahead), *speeds, LastAction(spec.robot))
        guides = GoalDistance(), GoalDirection(), Visited()
        return (*super().sensors(spec), *guides, *speeds, LastAction(spec.robot, count=_TOLD))

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        return (*super().available_sensors(spec), Waypoint(self.lookahead), WaypointBearing(self.lookahead))

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        if self.goal is None:
            return worlds
        placed = tuple(world.with_places(None, (*self.goal, 0.0)) for world in worlds)
        for world in placed:
            if shortest_path_length(world, robot.radius) == math.inf:
                x, y = self.goal
                where = f"from the start to the goal ({x:g}, {y:g})"
                raise InputError(f"world {world.name}: {robot.name} finds no way {where}")
        return placed

    def initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        initial_state = super().initial_state(spec, draws)
        if self.start == "fixed" or self.goal is not None:
            initial_state.goal_path[:] = OWN
            return initial_state
        world, choices = initial_state.world.astype(int), 1 + (draws.uniform(2) * GOALS).astype(int)
        ways = [spec.goal_paths.path_length(world, choice, initial_state.pose) for choice in choices.T]
        initial_state.goal_path[:] = np.where(
            ways[0] >= ways[1], *choices.T
        )  # the farther of two: few begin at their goal
        initial_state.goal[:] = spec.goal_paths.goals(world, initial_state.goal_path.astype(int))
        return initial_state

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        missing = np.hypot(*(after.goal - after.pose[:, :2]).T)
        reached, collided = (missing <= self.goal_radius) & ~after.bumped, self._collided(before, after)
        # Close to a wall the way is rounded from squares that no robot can be at, and may jump by more than a step.
        at_most = 1.5 * self.max_speed * self.control_period
        closer = np.clip(before.path_length - after.path_length, -at_most, at_most)
        gap = after.nearest - after.initial_state.rows["radius"]
        fines = self.turn_reward * np.abs(after.twist[:, 1]) / self.turn_rate
        if self.margin:
            fines = fines + self.margin_reward * np.clip(self.margin - gap, 0.0, self.margin) / self.margin
        moving = self.progress_reward * closer + self.step_reward + fines
        reward = np.select([collided, reached], [self.collision_reward, self.goal_reward], moving)
        return Outcome(reward, failed=collision_endings(collided, after), succeeded={"goal": reached})

    def _collided(self, before: RobotState, after: RobotState) -> np.ndarray:
        """Which robots drove into something, bool, shape (num_envs,): a wall, or something that moves.

        Of what moves it is what nuPlan calls a collision at fault (Karnchanachari et al. 2024, "Towards learning-based
        planning"): not when the robot stands, nor when it drives away from what runs into it.
        """
        if after.nearest_is_dynamic is None or not (after.bumped & after.nearest_is_dynamic).any():
            return after.bumped
        speed, east, north = np.maximum(before.twist[:, 0], after.command[:, 0]), *after.direction_to_obstacle.T
        towards = speed * (np.cos(after.pose[:, 2]) * east + np.sin(after.pose[:, 2]) * north)
        return after.bumped & (~after.nearest_is_dynamic | (towards >= _TOWARDS))
