"""Scenes: the robot, the worlds, the sensors and the spaces that a task's settings select."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError, unknown
from tb2rl.envs.encodings import DEFAULT_BEAMS, Encoding, SensorBox, has_images, make_encoding
from tb2rl.envs.episode_state import CommandHistory, EpisodeState, PositionHistory
from tb2rl.envs.filters import Filter
from tb2rl.envs.observation_pipeline import ObservationPipeline, stacked_space
from tb2rl.envs.occupancy_mapper import OccupancyMapper
from tb2rl.envs.parts import checked_task_parts, find_sensors, task_filters
from tb2rl.envs.worlds import are_generated, find_worlds, worlds_title
from tb2rl.robots import Laser, Robot
from tb2rl.robots.robot import find_robot
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, SimulationSpec, SimulatorType
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.simulation.spec import GOAL, POSE
from tb2rl.tasks import Actions, Task
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import check_count, parse_dynamic_obstacles
from tb2rl.worlds.generators import Purpose

_START_MARGIN = 0.05  # [m] added to the radius of a robot that is larger than the default `start_clearance`


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that an environment is made of. `make_scene` makes one.

    Attributes:
        task: The task.
        observation: Observation mode, "discrete" or "raw".
        spec: The robot, its laser and the worlds.
        encoding: Function from a robot state to an observation, see `observation_pipeline`.
        observation_space: Observation space of a single environment.
        actions: The task's actions, clipped to the robot's limits.
        sensors: Sensors, in the order of the observation.
        filters: The task's filters of commands, in the order of application.
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
        return self.spec.robot

    @property
    def laser(self) -> Laser:
        """The laser with the beams of the task."""
        return self.spec.laser

    @property
    def world(self) -> World:
        """The first world."""
        return self.spec.worlds[0]

    @property
    def worlds_title(self) -> str:
        """The worlds, and the robot unless it is the default one: "loop", "loop with turtlebot3"."""
        title = worlds_title(self.task.world, self.spec.worlds)
        return title if self.robot.name == Task.robot else f"{title} with {self.robot.name}"

    @property
    def action_space(self) -> spaces.Space:
        """Action space of a single environment."""
        return self.actions.space

    @property
    def has_images(self) -> bool:
        return has_images(self.observation_space)

    def goal_in(self, world_index: int) -> tuple[float, float] | None:
        """Goal x, y [m] of episodes in a world; None if there is no goal, or a random one."""
        if not self.task.goal_task:
            return None
        spec, sources = self.spec.for_world(world_index), [GeneratorSource(np.random.default_rng(i)) for i in range(2)]
        goal, other_goal = (tuple(self.task.initial_state(spec, source).goal[0].tolist()) for source in sources)
        return goal if goal == other_goal else None

    def observation_pipeline(self, real_spec: SimulationSpec | None = None) -> ObservationPipeline:
        """A new pipeline from robot states to observations.

        Args:
            real_spec: Spec of a real robot, whose latency is not simulated. None: the scene's spec, with latency.
        """
        task, sensors = self.task, self.sensors
        episode_states: list[EpisodeState] = [OccupancyMapper(real_spec or self.spec)] if task.maps_online else []
        if any(sensor.reads_position_history for sensor in sensors):
            episode_states.append(PositionHistory(task.control_period))
        if history_length := max(sensor.command_history_length for sensor in sensors):
            episode_states.append(CommandHistory(history_length))
        latency = 0 if real_spec else task.resolved_variation.observation_latency[1]
        return ObservationPipeline(self.encoding, sensors, episode_states, task.frame_stack, latency)

    def vary_initial_state(self, initial_state: InitialState, rng: np.random.Generator) -> InitialState:
        """Draw the robot's variation and the obstacles' seed; keep world, pose and goal of `initial_state` (one row).

        The draws come from a copy of `rng`, so that later sensor noise from `rng` does not depend on them.
        """
        spec = self.spec.for_world(int(initial_state.world[0]))
        randomized = self.task.randomized_initial_state(spec, GeneratorSource(deepcopy(rng)))
        randomized.records["goal_path"] = initial_state.records["goal_path"]
        for columns in (POSE, GOAL):
            randomized.table[:, columns] = initial_state.table[:, columns]
        return randomized

    def check(self, simulator: SimulatorType) -> None:
        """Raise an `InputError` if a simulator lacks the data of a sensor."""
        for sensor in self.sensors:
            sensor.check(simulator)

    def with_privileged_sensors(self, names: Sequence[Any]) -> Scene:
        """A copy for a training whose critic also observes these sensors, given as in `task.observe`.

        Its observations end with their numbers, and `observation_space.actor_space` is the space without them.

        Raises:
            InputError: If there is no such sensor, or the observations are not a single vector of numbers.
        """
        space = self.observation_space
        if not isinstance(space, SensorBox) or self.task.frame_stack > 1:
            raise InputError("train.privileged needs task.observation=raw without images, and task.frame_stack=1")
        sensors = *self.sensors, *find_sensors(names, "train.privileged", self.task, self.sensors, self.spec)
        encoding = make_encoding(self.observation, sensors)
        if not isinstance(encoding.space, SensorBox):
            raise InputError("train.privileged: images are no numbers, which the critic needs")
        encoding.space.actor_space = space
        return replace(self, sensors=sensors, encoding=encoding, observation_space=encoding.space)

    def with_time_limit(self, steps: int) -> Scene:
        """A copy of the scene with another time limit [control steps]."""
        return replace(self, task=replace(self.task, episode_steps=steps))

    def for_purpose(self, purpose: Purpose) -> Scene:
        """The same scene in worlds generated for a purpose; without generated worlds, the scene itself."""
        if not are_generated(self.task.world):
            return self
        worlds = find_worlds(self.task.world, purpose)
        return self.in_worlds(worlds)

    def in_worlds(self, worlds: tuple[World, ...], **settings: Any) -> Scene:
        """A copy of the scene with the given worlds, not those of `task.world`, and with changed settings of the task.

        Raises:
            InputError: If a world or a setting is invalid for the task or the robot.
        """
        return _assemble(replace(self.task, **settings), self.observation, self.robot, worlds)


def with_robot_settings(
    settings: Mapping[str, Any], task_class: type[Task], task: Task | None = None
) -> dict[str, Any]:
    """Add the task settings of the robot `settings["robot"]`; other keys of `settings` take precedence.

    Args:
        settings: Settings for a new or changed task; without "robot" nothing is added.
        task_class: Class of the task.
        task: The task before the change. Settings that it got from its old robot return to the defaults of the class.

    Raises:
        InputError: If there is no such robot, or a key of its task settings is not a field of `Task`.
    """
    name = settings.get("robot")
    if not isinstance(name, str | Mapping):  # absent, or invalid, which the validation of settings reports later
        return dict(settings)
    task_defaults = {field.name: field.default for field in fields(task_class)}
    robot_settings = _settings_of(find_robot(name), task_defaults)
    for key in robot_settings:
        if key not in Task.__dataclass_fields__:
            raise unknown(f"key of robot {find_robot(name).name}.task_settings", key, Task.__dataclass_fields__)
    old_settings = _settings_of(find_robot(task.robot), task_defaults) if task else {}
    reverted = {key: task_defaults[key] for key, value in old_settings.items() if getattr(task, key) == value}
    return {**reverted, **robot_settings, **settings}


def _settings_of(robot: Robot, task_defaults: Mapping[str, Any]) -> Mapping[str, Any]:
    """The task settings of a robot, with a larger `start_clearance` if the default is below the robot's radius."""
    if task_defaults["start_clearance"] >= robot.radius:
        return robot.task_settings
    return {"start_clearance": robot.radius + _START_MARGIN, **robot.task_settings}


def make_scene(task: Task, observation: str) -> Scene:
    """Make the scene of a task, in worlds for training.

    Args:
        task: The task.
        observation: "discrete" or "raw".

    Raises:
        InputError: If a name is unknown, or settings contradict each other.
    """
    if observation not in DEFAULT_BEAMS:
        raise unknown("observation", observation, DEFAULT_BEAMS)
    return _assemble(task, observation, find_robot(task.robot), find_worlds(task.world))


def _assemble(task: Task, observation: str, robot: Robot, worlds: tuple[World, ...]) -> Scene:
    worlds = task.prepare_worlds(worlds, robot)
    beams, max_index = task.beams or DEFAULT_BEAMS[observation], max(task.beam_indices or (0,))
    if max_index >= beams:
        raise InputError(f"task.beam_indices has beam {max_index}; the laser has beams 0 to {beams - 1}")
    if task.start_clearance < robot.radius:
        raise InputError(f"task.start_clearance must be at least {robot.name}'s radius, {robot.radius:g} m")
    fov, max_fov = task.field_of_view or robot.laser.field_of_view, robot.laser.field_of_view
    if fov > max_fov:
        raise InputError(f"task.field_of_view cannot be {fov:.4g}: {robot.name}'s laser sees {max_fov:.4g} rad")
    laser = replace(robot.laser, beams=beams, indices=task.beam_indices, noise=task.laser_noise, field_of_view=fov)
    obstacles = parse_dynamic_obstacles(task.dynamic_obstacles, "task.dynamic_obstacles")
    spec = SimulationSpec(robot, laser, worlds, dynamic_obstacles=obstacles)
    for index, world in enumerate(worlds):
        check_count(spec.dynamic_obstacles_in(index), f"world {world.name} and task.dynamic_obstacles")
        if len(worlds) > 1:
            world.check_start(task.start_clearance if task.start == "random" else robot.radius)
    if len(worlds) == 1:
        worlds[0].free_space(robot.radius)  # checks the start, too; slower than `check_start`, but cached
    actions, sensors = checked_task_parts(task, spec)
    encoding = make_encoding(observation, sensors)
    space = stacked_space(encoding.space, task.frame_stack)
    return Scene(task, observation, spec, encoding, space, actions.clipped_to(robot), sensors, task_filters(task, spec))
