"""Checks a task by one dry-run step, before a training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.observed_sensors import observed_sensors
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks import Actions, Outcome, Task

_NUM_ENVS = 2  # one would hide `if after.bumped` and arrays without a leading axis


def check_task(task: Task, spec: SimulationSpec) -> tuple[Actions, tuple[Sensor, ...]]:
    """Run the methods of a task for two environments without a simulator.

    Returns:
        The task's actions and sensors.

    Raises:
        InputError: If a method returns a wrong type or shape; exceptions inside a method pass unchanged.
    """
    actions, where = task.actions, f"task {type(task).__name__}"
    hint = ", or @property is missing above it" if callable(actions) else ""
    _demand(isinstance(actions, Actions), f"{where}: actions must be Commands or Velocities{hint}", actions)
    with np.errstate(all="ignore"):  # some tasks divide by a speed, which is 0 here
        lacking = [number for number, world in enumerate(spec.worlds) if task.goal_task and world.goal is None]
        each = dict.fromkeys([0, *lacking])
        for part in (*map(spec.within, each), spec):
            draws = GeneratorDraws(np.random.default_rng(0), _NUM_ENVS)
            initial_state = task.initial_state(part, draws)
            _check_start(initial_state, task, spec, where)
            task.resolved_variation.vary(initial_state, draws)
        robot_state, own = _at_rest(initial_state, spec), task.sensors(spec)
        _demand(isinstance(own, tuple | list), f"{where}: sensors must return a tuple: (Compass(),)", own)
        sensors = observed_sensors(task, tuple(own), spec)
        for sensor in sensors:
            _check_sensor(sensor, robot_state, where)
        action = np.zeros((_NUM_ENVS, *(actions.space.shape or ())), actions.space.dtype)
        _check_outcome(task.outcome(robot_state, action, robot_state), task, where)
    return actions, sensors


@dataclass(frozen=True)
class _BlankCamera:
    """Images of nothing.

    Attributes:
        spec: The worlds.
    """

    spec: SimulationSpec

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        sizes = len(robot_state.pose), height, width
        return np.zeros((*sizes, 3), dtype=np.uint8), np.full(sizes, np.inf, dtype=np.float32)


def _check_start(initial_state: Any, task: Task, spec: SimulationSpec, where: str) -> None:
    _demand(
        isinstance(initial_state, InitialState), f"{where}: initial_state must return an InitialState", initial_state
    )
    table, shape = initial_state.table, (_NUM_ENVS, spec.table.shape[1])
    _demand(np.shape(table) == shape, f"{where}: initial_state must return draws.num_envs rows, here {shape}", table)
    known = np.isin(initial_state.world, range(len(spec.worlds))).all()
    _demand(
        known,
        f"{where}: initial_state must name worlds by index, below {len(spec.worlds)}",
        initial_state.world.tolist(),
    )
    _demand(
        np.isfinite(initial_state.pose).all(),
        f"{where}: initial_state must return finite poses",
        initial_state.pose.tolist(),
    )
    if task.goal_task and np.isnan(initial_state.goal).any():
        lacking = spec.worlds[int(initial_state.world[np.isnan(initial_state.goal).any(axis=1).argmax()])].name
        place = "task.goal to [x, y]" if hasattr(task, "goal") else "initial_state.goal in initial_state"
        raise InputError(f"world {lacking} has no goal; set {place}, or a goal in the world's file")


def _at_rest(initial_state: InitialState, spec: SimulationSpec) -> RobotState:
    """A read-only robot state at the start of episodes, far from all walls."""
    table, poses, twists = initial_state.table.copy(), initial_state.pose.copy(), np.zeros((_NUM_ENVS, 2))
    ranges = np.full((_NUM_ENVS, len(spec.laser.angles)), spec.laser.max_range)
    bumped, still, nearest = np.zeros(_NUM_ENVS, dtype=bool), np.zeros(_NUM_ENVS), ranges.min(axis=1)
    dynamic_obstacles: tuple[np.ndarray, ...] = (
        (np.zeros((_NUM_ENVS, 1, 6)), np.zeros(_NUM_ENVS, dtype=bool)) if spec.has_dynamic_obstacles else ()
    )
    for array in (table, poses, twists, ranges, bumped, still, nearest, *dynamic_obstacles):
        array.flags.writeable = False
    truth = poses, twists
    robot_state = RobotState(
        *truth, *truth, ranges, bumped, twists, still, InitialState(table), _BlankCamera(spec), *dynamic_obstacles
    )
    vars(robot_state)["nearest"] = nearest  # else read-only arrays would compile its function again
    return robot_state


def _check_sensor(sensor: Any, robot_state: RobotState, where: str) -> None:
    hint = f": write {sensor.__name__}()" if isinstance(sensor, type) else ""
    _demand(isinstance(sensor, Sensor), f"{where}: sensors must return sensors{hint}", sensor)
    where = f"sensor {type(sensor).__name__}"
    declared: list[Any] = [getattr(sensor, key, None) for key in ("name", "unit", "shape", "bins", "low", "high")]
    name, unit, shape, bins, low, high = declared
    _demand(isinstance(name, str) and isinstance(unit, str), f"{where}: name and unit must be strings", (name, unit))
    counts = isinstance(shape, tuple) and all(isinstance(count, int | np.integer) and count > 0 for count in shape)
    _demand(counts, f"{where}: shape must be a tuple of counts, such as (1,)", shape)
    _demand(_numeric(bins) and np.ndim(bins) == 1, f"{where}: bins must be a tuple of numbers", bins)
    kind: type = np.uint8 if len(shape) == 3 else float
    below = kind is np.uint8 or (_numeric(low) and _numeric(high) and np.all(np.less(low, high)))
    _demand(below, f"{where}: low and high must be numbers, low the smaller one", (low, high))
    values, fits = sensor.read(robot_state), f"an array of shape {('num_envs', *shape)}, {kind.__name__}, not NaN"
    shaped = _is_array(values, shape, kind)
    hint = " (there is no goal in this task's episodes)" if shaped and np.isnan(robot_state.goal).any() else ""
    _demand(shaped and not np.isnan(values).any(), f"sensor {name} must read {fits}{hint}", values)


def _check_outcome(outcome: Any, task: Task, where: str) -> None:
    _demand(isinstance(outcome, Outcome), f"{where}: outcome must return an Outcome", outcome)
    _demand(
        _is_array(outcome.reward, (), float), f"{where}: outcome's reward must have shape (num_envs,)", outcome.reward
    )
    succeeded = {} if outcome.succeeded is None else outcome.succeeded
    for kind, endings in (("failed", outcome.failed), ("succeeded", succeeded)):
        _demand(isinstance(endings, Mapping), f'{where}: outcome must return {kind}={{"name": mask}}', endings)
        for name, mask in endings.items():
            _demand(_is_array(mask, (), bool), f"{where}: {kind}[{name!r}] must be bool, shape (num_envs,)", mask)
    if outcome.succeeded is None and task.goal_task:
        raise InputError(
            f'{where}: goal_task is True, so outcome must return succeeded={{"goal": mask}} in the Outcome'
        )
    if outcome.succeeded is not None and not task.goal_task:
        raise InputError(f"{where}: outcome returned an Outcome with succeeded, so set goal_task = True in the class")


def _is_array(value: Any, shape: tuple[int, ...], kind: type) -> bool:
    return isinstance(value, np.ndarray) and value.shape == (_NUM_ENVS, *shape) and np.can_cast(value.dtype, kind)


def _numeric(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "iuf"


def _demand(holds: Any, what: str, got: Any) -> None:
    if not holds:
        array = isinstance(got, np.ndarray) and got.ndim > 0
        got_text = f"an array of {got.dtype}, shape {got.shape}" if array else one_line(repr(got), 60)
        raise InputError(f"{what}; got {got_text}")
