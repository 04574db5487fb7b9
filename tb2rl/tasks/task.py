"""Base classes of tasks, and the outcome of a control step: rewards and endings."""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tb2rl.core import InputError, find_plugin
from tb2rl.core.values import (
    Bins,
    Count,
    DynamicObstaclesSetting,
    NonNegative,
    PluginNames,
    RobotSetting,
    SensorNames,
    Worlds,
)
from tb2rl.robots import Robot
from tb2rl.robots.robot_file import variation_setting
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges
from tb2rl.simulation import InitialState, RandomSource, RobotState, SimulationSpec
from tb2rl.simulation.variation import Variation, find_variation
from tb2rl.tasks.actions import Actions
from tb2rl.worlds import World

Beams = Annotated[int, Ge(1), Le(100_000)]
Clearance = Annotated[float, Gt(0), Le(100)]  # [m]
Period = Annotated[float, Gt(0), Le(60)]  # [s]
VariationSetting = Annotated[Any, "name, mapping or file"]  # read by `Task.resolved_variation`
# Names of endings:
TIME_LIMIT = "time limit"  # the episode reached `episode_steps`
COLLISION, DYNAMIC_COLLISION = "collision", "collision with a dynamic obstacle"


def collision_endings(collided: np.ndarray, after: RobotState) -> dict[str, np.ndarray]:
    """Split the mask `collided`, shape (num_envs,), by the kind of obstacle: endings for `Outcome.failed`."""
    if after.nearest_is_dynamic is None:
        return {COLLISION: collided}
    return {COLLISION: collided & ~after.nearest_is_dynamic, DYNAMIC_COLLISION: collided & after.nearest_is_dynamic}


class Ending(NamedTuple):
    """The reason why an episode ended."""

    name: str
    failed: bool
    success: bool


@dataclass(frozen=True)
class Outcome:
    """Rewards and endings of a control step.

    An episode ends where a mask is true. If several masks are true, the first failure is the ending, or else the first
    success.

    Attributes:
        reward: Shape (num_envs,).
        failed: Masks of failures, by name of the ending, each bool, shape (num_envs,).
        succeeded: Masks of successes, by name. None if the task has no goal; then the time limit is a success.
    """

    reward: np.ndarray
    failed: Mapping[str, np.ndarray] = field(default_factory=dict)
    succeeded: Mapping[str, np.ndarray] | None = None

    @property
    def terminated(self) -> np.ndarray:
        """Whether each episode ends, bool, shape (num_envs,)."""
        masks = [*self.failed.values(), *(self.succeeded or {}).values()]
        if len(masks) == 1:  # a common case, for which the reduction below is slow
            return masks[0]
        return np.logical_or.reduce(masks) if masks else np.zeros(len(self.reward), dtype=bool)

    def ending(self, index: int, timed_out: bool) -> Ending | None:
        """Ending of the episode in one environment, which may have timed out; None if the episode continues."""
        return self.endings(np.array([index]))[0] if timed_out or self.terminated[index] else None

    def endings(self, indices: np.ndarray) -> list[Ending]:
        """Endings of the episodes with these indices, shape (n,); the time limit where all masks are false."""
        endings = [Ending(TIME_LIMIT, failed=False, success=self.succeeded is None)] * len(indices)
        for masks, failed in ((self.succeeded or {}, False), (self.failed, True)):
            for name, mask in reversed(list(masks.items())):  # so that the first mask overwrites the others
                ending = Ending(name, failed, success=not failed)
                for i in mask[indices].nonzero()[0].tolist():
                    endings[i] = ending
        return endings


@dataclass(frozen=True)
class Task(ABC):
    """A task in any simulator, for any number of environments.

    The fields are settings, for YAML (`task.world: circuit`), `--set task.world=circuit` and
    `gymnasium.make(id, world="circuit")`. A subclass defines `actions` and `outcome`, and can override `sensors` and
    `initial_state`. Arrays have a leading axis of environments.
    """

    goal_task: ClassVar[bool] = False  # whether an episode succeeds at a goal, not at the time limit

    robot: RobotSetting = "turtlebot2"  # a name, "module:ROBOT", or a robot file: see tb2rl/robots/README.md
    world: Worlds = "loop"  # a name, a list, or settings of a generator: see tb2rl/worlds/README.md
    start: Literal["fixed", "random"] = "random"  # start of episodes: that of the world, or anywhere
    start_clearance: Clearance = 0.6  # [m] least distance of a random start from walls and bounds
    control_period: Period = 0.2  # [s] duration of a control step
    episode_steps: Count = 1500  # [control steps] time limit of an episode
    beams: Beams | None = None  # number of laser beams; None: the default of the observation mode
    field_of_view: Annotated[float, Gt(0), Le(math.tau)] | None = None  # [rad] angle of all beams; None: the laser's
    beam_indices: Annotated[tuple[Annotated[int, Ge(0)], ...], Len(1, 1000)] | None = None  # beams to read; None: all
    laser_noise: NonNegative = 0.0  # [m] standard deviation of the ranges; 0.01 is realistic
    variation: VariationSetting = "none"  # a preset, ranges by name, or a robot file: see tb2rl/robots/README.md
    dynamic_obstacles: DynamicObstaclesSetting = None  # groups, such as {people: 4}: see tb2rl/worlds/README.md
    frame_stack: Annotated[int, Ge(1), Le(100)] = 1  # number of stacked observations, the oldest first
    range_bins: Bins = (0.7, 1.0, 1.7)  # [m] borders between bins of laser ranges
    observe: SensorNames | None = None  # sensors by name: see tb2rl/sensors/README.md; None: the task's `sensors`
    filters: PluginNames = ()  # filters of commands, by name: see tb2rl/tasks/README.md

    @cached_property
    def resolved_variation(self) -> Variation:
        """The ranges of domain randomisation; raises an `InputError` if the setting `variation` is invalid."""
        return find_variation(variation_setting(self.variation, self.control_period))

    @property
    def maps_online(self) -> bool:
        """Whether robots map their surroundings online, see `RobotState.occupancy_map`."""
        return False

    @property
    @abstractmethod
    def actions(self) -> Actions:
        """The action space."""

    @abstractmethod
    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        """Rewards and endings of a control step.

        Args:
            before, after: Robot states before and after the step.
            action: Shape (num_envs,), or (num_envs, 2) for `Velocities`.
        """

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """Sensors, in the order of the observation."""
        return (LaserRanges(spec.laser, self.range_bins),)

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """Sensors, made with the task's settings, that `observe` can select by name besides those of `sensors`."""
        return Task.sensors(self, spec)

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        """Change the worlds before episodes start, for example their goals; by default they stay unchanged."""
        return worlds

    def initial_state(self, spec: SimulationSpec, random: RandomSource) -> InitialState:
        """Draw initial states of episodes: a random world of `spec`, and a random pose or the world's start."""
        worlds = spec.draw_worlds(random)
        initial_state = InitialState.default(spec, random.num_envs, worlds)
        if self.start == "random":
            initial_state.pose[:] = spec.sample_poses(worlds, random.uniform(4), self.start_clearance)
        return initial_state

    def randomized_initial_state(self, spec: SimulationSpec, random: RandomSource) -> InitialState:
        """Draw initial states, then the variation of the robot, then the seeds of dynamic obstacles.

        Because of this order, the variation does not change the initial poses of a seed, and obstacles change neither.
        """
        initial_state = self.initial_state(spec, random)
        self.resolved_variation.vary(initial_state, random)
        if spec.has_dynamic_obstacles:
            initial_state.records["obstacle_seed"] = random.uniform(1)[:, 0]
        return initial_state


@dataclass(frozen=True)
class CollisionTask(Task):
    """A task whose episodes end at a collision, which is a contact, or a range below `collision_range`."""

    collision_reward: float = -200.0  # replaces the step's reward
    collision_range: NonNegative = 0.5  # [m] a range below this is a collision
    margin: NonNegative = 0.0  # [m] gaps between robot and obstacle below this are penalised
    margin_reward: float = 0.0  # added at a gap of 0 (negative); at gaps below `margin`, scaled by (1 - gap / margin)^2

    def collision_outcome(self, reward: np.ndarray, after: RobotState) -> Outcome:
        """The outcome of a step; `reward` (num_envs,) gets the margin penalty, or is replaced by `collision_reward`."""
        collided = after.bumped | (after.nearest_range < self.collision_range)
        if self.margin:
            gap = after.nearest_range - after.initial_state.records["radius"]
            reward = reward + self.margin_reward * (np.clip(self.margin - gap, 0.0, self.margin) / self.margin) ** 2
        reward = np.where(collided, self.collision_reward, reward)
        return Outcome(reward, failed=collision_endings(collided, after))


def find_task(name: str | type[Task]) -> type[Task]:
    """Find a task class by its name or "module:Class"; a class is returned unchanged.

    Raises:
        InputError: If there is no such task, or it has settings but is not a dataclass.
    """
    task_class = name if isinstance(name, type) else find_plugin("task", name)
    if not (isinstance(task_class, type) and issubclass(task_class, Task)) or inspect.isabstract(task_class):
        raise InputError(f"task {name!r} is not a class derived from tb2rl.tasks.Task with actions and outcome")
    settings = [key for key, annotation in task_class.__annotations__.items() if "ClassVar" not in str(annotation)]
    if settings and "__dataclass_fields__" not in vars(task_class):
        raise InputError(f"task {name!r} has the settings {', '.join(settings)}, so it needs @dataclass(frozen=True)")
    return task_class
