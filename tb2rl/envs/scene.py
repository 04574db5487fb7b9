"""Scenes: the objects that the settings of a task name, resolved once."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError, unknown
from tb2rl.envs.check_task import check_task
from tb2rl.envs.command_history import CommandHistory
from tb2rl.envs.encodings import BEAMS, Encoding, encode
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.envs.filters import CommandDelay, Filter
from tb2rl.envs.observation_pipeline import ObservationPipeline, stacked_space
from tb2rl.envs.occupancy_mapper import OccupancyMapper
from tb2rl.envs.pose_history import PoseHistory
from tb2rl.envs.task_filters import task_filters
from tb2rl.envs.worlds import are_generated, find_worlds, place_of
from tb2rl.robots import Laser, Robot
from tb2rl.robots.registry import find_robot
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, SimulationSpec, SimulatorType
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.simulation.spec import GOAL, POSE
from tb2rl.tasks import Actions, Task
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import check_number, find_dynamic_obstacles
from tb2rl.worlds.generators import Purpose

_ROOM = 0.05  # [m] around a robot at the start, if it is too large for the usual `start_clearance`


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that an environment is made of; made by `make_scene`.

    Attributes:
        task: The task.
        observation: How it is observed, "discrete" or "raw".
        spec: The robot, its laser and the worlds.
        encoding: From robot states to observations; see `observation_pipeline`.
        observation_space: Of one environment.
        actions: Of the task, within the limits of the robot.
        sensors: In the order of the observation.
        filters: Those of the task, in order; see `make_filters`.
    """

    task: Task
    observation: str
    spec: SimulationSpec
    encoding: Encoding
    observation_space: spaces.Space
    actions: Actions
    sensors: tuple[Sensor, ...]
    filters: tuple[Filter, ...]

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.spec.robot

    @property
    def laser(self) -> Laser:
        """The laser with the beams of the task."""
        return self.spec.laser

    @property
    def world(self) -> World:
        """The first of the worlds."""
        return self.spec.worlds[0]

    @property
    def place(self) -> str:
        """Worlds and robot for titles: "loop", or "loop with turtlebot3" if it is not the default robot."""
        worlds = place_of(self.task.world, self.spec.worlds)
        return worlds if self.robot.name == Task.robot else f"{worlds} with {self.robot.name}"

    @property
    def action_space(self) -> spaces.Space:
        """Of one environment."""
        return self.actions.space

    @cached_property
    def goal(self) -> tuple[float, float] | None:
        """The goal in the first world, see `goal_in`."""
        return self.goal_in(0)

    def goal_in(self, world: int) -> tuple[float, float] | None:
        """The goal x, y [m] of episodes in the world with this index; None: there is none, or it is drawn."""
        if not self.task.goal_task:
            return None
        draws = [GeneratorDraws(np.random.default_rng(seed)) for seed in range(2)]
        one, other = (tuple(self.task.initial_state(self.spec.within(world), each).goal[0].tolist()) for each in draws)
        return one if one == other else None

    def make_filters(self) -> list[Filter]:
        """New filters between action and simulator: those of the task, then the latency of commands."""
        return [*deepcopy(self.filters), CommandDelay(self.task.resolved_variation.latency[1])]

    def observation_pipeline(self) -> ObservationPipeline:
        """A new pipeline from robot states to observations."""
        latency = self.task.resolved_variation.observation_latency[1]
        states = self.episode_states(self.spec)
        return ObservationPipeline(
            self.encoding, self.observation_space, self.task.frame_stack, latency, states, self._prompt
        )

    def episode_states(self, spec: SimulationSpec) -> list[EpisodeState]:
        """New memories of episodes in these worlds, as the sensors need them."""
        states: list[EpisodeState] = [OccupancyMapper(spec)] if self.task.maps_online else []
        if any(sensor.reads_pose_history for sensor in self.sensors):
            states.append(PoseHistory(self.task.control_period))
        commands = max(sensor.reads_commands for sensor in self.sensors)
        if commands:
            states.append(CommandHistory(commands, delayed=self.task.resolved_variation.latency[1] > 0))
        return states

    @property
    def _prompt(self) -> np.ndarray:
        """Whether each observed number is of commands, which have no latency; bool, shape (numbers,)."""
        numbers = [sensor for sensor in self.sensors if len(sensor.shape) == 1]
        return np.repeat([s.reads_commands > 0 for s in numbers], [s.shape[0] for s in numbers])

    def randomized(self, initial_state: InitialState, rng: np.random.Generator) -> InitialState:
        """The task's variation of the robot for an initial state of one environment, which keeps world, pose and goal.

        `rng` is copied, so that the sensor noise that it draws later does not depend on this.
        """
        spec = self.spec.within(int(initial_state.world[0]))
        varied = self.task.randomized_initial_state(spec, GeneratorDraws(deepcopy(rng)))
        varied.goal_path[:] = initial_state.goal_path
        for columns in (POSE, GOAL):
            varied.table[:, columns] = initial_state.table[:, columns]
        return varied

    def check(self, simulator: SimulatorType) -> None:
        """Raise an `InputError` if a simulator cannot show what a sensor reads."""
        for sensor in self.sensors:
            sensor.check(simulator)

    def with_time_limit(self, steps: int) -> Scene:
        """The scene with another time limit of its episodes [control steps]."""
        return replace(self, task=replace(self.task, episode_steps=steps))

    def changed(self, **settings: Any) -> Scene:
        """The scene with other settings of its task, but with the same robot and worlds.

        Raises:
            InputError: If they do not fit.
        """
        if not settings.keys().isdisjoint({"robot", "world"}):
            raise InputError("a scene keeps its robot and its world; make another one")
        return _assemble(replace(self.task, **settings), self.observation, self.robot, self.spec.worlds)

    def worlds_for(self, purpose: Purpose) -> Scene:
        """The scene in the worlds for a purpose: generated ones differ, see `tb2rl.worlds.generators`."""
        if not are_generated(self.task.world):
            return self
        return _assemble(self.task, self.observation, self.robot, find_worlds(self.task.world, purpose))

    def in_worlds(self, worlds: tuple[World, ...], **settings: Any) -> Scene:
        """The scene in these worlds, whatever `task.world` says, and with other settings of its task.

        Raises:
            InputError: If they do not fit.
        """
        return _assemble(replace(self.task, **settings), self.observation, self.robot, worlds)


def with_robots_settings(settings: Mapping[str, Any], kind: type[Task], task: Task | None = None) -> dict[str, Any]:
    """Add the task settings of the robot that settings name; the given ones have precedence.

    Args:
        settings: Changes.
        kind: The class of the task.
        task: The task that changes; its settings that came with its robot return to the defaults.

    Raises:
        InputError: If there is no such robot, or one of its task settings is not of every task.
    """
    name = settings.get("robot")
    if not isinstance(name, str):  # unchanged, or invalid, as the check of settings says
        return dict(settings)
    own, known = _settings_of(find_robot(name), kind), [each.name for each in fields(Task)]
    for key in own:
        if key not in known:
            raise unknown(f"key of robot {name}.task_settings", key, known)
    if task is None:
        return {**own, **settings}
    former, default = _settings_of(find_robot(task.robot), kind), {each.name: each.default for each in fields(kind)}
    reverted = {key: default[key] for key, value in former.items() if getattr(task, key) == value}
    return {**reverted, **own, **settings}


def _settings_of(robot: Robot, kind: type[Task]) -> Mapping[str, Any]:
    """The task settings of a robot, with a larger `start_clearance` if it is too large for the default."""
    (usual,) = (each.default for each in fields(kind) if each.name == "start_clearance")
    if not isinstance(usual, float) or usual >= robot.radius:
        return robot.task_settings
    return {"start_clearance": robot.radius + _ROOM, **robot.task_settings}


def make_scene(task: Task, observation: str) -> Scene:
    """Make the scene of a task, in worlds for training.

    Args:
        task: The task.
        observation: "discrete" or "raw".

    Raises:
        InputError: For an unknown name, or settings that do not fit together.
    """
    if observation not in BEAMS:
        raise unknown("observation", observation, BEAMS)
    return _assemble(task, observation, find_robot(task.robot), find_worlds(task.world))


def _assemble(task: Task, observation: str, robot: Robot, worlds: tuple[World, ...]) -> Scene:
    worlds = task.prepare_worlds(worlds, robot)
    beams = task.beams or BEAMS[observation]
    if task.beam_indices is not None and max(task.beam_indices) >= beams:
        named = max(task.beam_indices)
        raise InputError(f"task.beam_indices names beam {named}, but the laser has {beams} beams, counted from 0")
    if task.start_clearance < robot.radius:
        raise InputError(f"task.start_clearance must be at least {robot.name}'s radius, {robot.radius:g} m")
    field = task.field_of_view or robot.laser.field_of_view
    if field > robot.laser.field_of_view:
        sees = f"{robot.name}'s laser sees {robot.laser.field_of_view:.4g} rad"
        raise InputError(f"task.field_of_view cannot be {field:.4g}: {sees}")
    laser = replace(robot.laser, beams=beams, indices=task.beam_indices, noise=task.laser_noise, field_of_view=field)
    spec = SimulationSpec(
        robot, laser, worlds, dynamic_obstacles=find_dynamic_obstacles(task.dynamic_obstacles, "task.dynamic_obstacles")
    )
    for number, world in enumerate(worlds):
        check_number(spec.dynamic_obstacles_in(number), f"world {world.name} and task.dynamic_obstacles")
    _check_starts(task, robot, worlds)
    actions, sensors = check_task(task, spec)
    encoding = encode(observation, sensors)
    space = stacked_space(encoding.space, task.frame_stack)
    return Scene(task, observation, spec, encoding, space, actions.within(robot), sensors, task_filters(task))


def _check_starts(task: Task, robot: Robot, worlds: tuple[World, ...]) -> None:
    """Raise an `InputError` if there is no room at the start of a world."""
    if len(worlds) == 1:  # starts need its exact free space anyway
        worlds[0].free_space(robot.radius)
        return
    for world in worlds:
        world.check_start(task.start_clearance if task.start == "random" else robot.radius)
