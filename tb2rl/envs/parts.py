"""The parts of a task: sensors and filters from its settings, and a dry run of its methods."""

import inspect
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core import InputError, find_plugin, import_object, make_part, one_line, unknown
from tb2rl.envs import filters, passive_safety, recovery, safe_motion, safety
from tb2rl.envs.filters import Filter
from tb2rl.sensors import Sensor, camera, goal, laser, motion
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.tasks import Actions, Outcome, Task

# In every exported policy, in this order.
_PORTABLE = filters, safe_motion, safety, passive_safety, recovery
PORTABLE_FILTERS = tuple(Path(inspect.getfile(module)) for module in _PORTABLE)
_GRIP = 0.85  # share of the motors' deceleration that a robot has in every direction
_NUM_ENVS = 2  # of a dry run; with one, `if after.bumped` and arrays of a fixed length of 1 would pass

SENSORS: dict[str, tuple[type[Sensor], ...]] = {  # by name in `task.observe`
    "bumper": (motion.Bumper,),
    "camera": (camera.Camera,),
    "free_paths": (laser.FreePaths,),
    "goal": (goal.GoalDistance, goal.GoalBearing),
    "goal_direction": (goal.GoalDirection,),
    "imu": (motion.YawRate, motion.ForwardAcceleration),
    "laser": (laser.LaserRanges,),
    "last_action": (motion.LastAction,),
    "path_length": (goal.PathLength,),
    "twist": (motion.ForwardSpeed, motion.TurnRate),
    "visited": (motion.Visited,),
    "waypoint": (goal.Waypoint,),
    "waypoint_bearing": (goal.WaypointBearing,),
}


def find_sensors(
    entries: Sequence[Any], setting: str, task: Task, task_sensors: tuple[Sensor, ...], spec: SimulationSpec
) -> tuple[Sensor, ...]:
    """The sensors in a setting, such as `task.observe`.

    An entry with arguments makes a new sensor. An entry without arguments selects the task's own sensor of its class,
    from `task_sensors` or else from `task.available_sensors`; if there is none, it makes one with default settings.

    Args:
        entries: The value of the setting.
        setting: Name of the setting.
        task: The task.
        task_sensors: The task's own sensors.
        spec: The robot and the worlds.

    Raises:
        InputError: If a name is unknown, an argument is invalid, or a sensor is listed twice.
    """
    configured = {type(sensor): sensor for sensor in reversed([*task_sensors, *task.available_sensors(spec)])}
    scene_parts = {"robot": spec.robot, "laser": spec.laser, "camera": spec.robot.camera, "worlds": spec.worlds}
    sensors: list[Sensor] = []
    for name, arguments in _entries(entries):
        if ":" not in name and name not in SENSORS:
            raise unknown(f"sensor of {setting}:", name, SENSORS)
        label = f"{setting}: {name!r}"
        classes = (_checked_class(import_object(name), Sensor, label),) if ":" in name else SENSORS[name]
        if arguments and len(classes) > 1:
            references = " and ".join(f"{cls.__module__}:{cls.__name__}" for cls in classes)
            raise InputError(f"{setting}.{name} is several sensors; give arguments to {references} instead")
        for cls in classes:
            if cls in configured and not arguments:
                sensors.append(configured[cls])
            else:
                given = {key: scene_parts[key] for key in inspect.signature(cls).parameters if key in scene_parts}
                sensors.append(make_part(cls, arguments, f"{setting}.{name}", given))
    names = [sensor.name for sensor in sensors]
    duplicates = [name for name in names if names.count(name) > 1]
    if duplicates:
        raise InputError(one_line(f"{setting}: sensor {duplicates[0]!r} is listed twice"))
    return tuple(sensors)


def task_filters(task: Task, spec: SimulationSpec) -> tuple[Filter, ...]:
    """New filters, in the order of `task.filters`.

    Raises:
        InputError: If there is no such filter, or an argument is invalid.
    """
    parts = ((cls, arguments, f"task.filters.{cls.__name__}", facts) for cls, arguments, facts in _filters(task, spec))
    return tuple(make_part(*part) for part in parts)


def describe_filters(task: Task, spec: SimulationSpec) -> tuple[list[dict[str, Any]], list[Path]]:
    """Describe the filters of a task for an exported policy.

    Returns:
        Class name and arguments of each filter, and the files of users' filter classes.
    """
    found = list(_filters(task, spec))
    entries = [{"class": cls.__name__, "arguments": {**facts, **arguments}} for cls, arguments, facts in found]
    files = [Path(inspect.getfile(cls)) for cls, _, _ in found]
    return entries, [file for file in dict.fromkeys(files) if file not in PORTABLE_FILTERS]


def robot_facts(task: Task, spec: SimulationSpec) -> dict[str, Any]:
    """Facts about the robot for filters with a parameter `robot`, in plain values, see `Safety`.

    The bounds of the setting "guaranteed" are the ends of the ranges of `task.variation`.
    """
    variation, robot, period = task.resolved_variation, spec.robot, task.control_period
    noise = max((variation.laser_noise or (0.0, 0.0))[1], spec.laser.noise)
    mounting = [max(map(abs, limits)) for limits in (variation.mount_x, variation.mount_y)]
    (weak, strong), (light, heavy) = variation.acceleration, variation.mass
    fastest = robot.wheel_acceleration + abs(robot.wheel_coupling)
    mean = (weak + strong) / (light + heavy) * robot.wheel_acceleration
    return {
        "radius": robot.radius,
        "wheel_separation": robot.wheel_separation,
        "angles": spec.laser.angles.tolist(),
        "control_period": period,
        "guaranteed": {
            "latency": variation.latency[1] * period,
            "accelerations": [_GRIP * weak / heavy * robot.wheel_acceleration, strong / light * fastest],
            "braking": 0.5,
            "error": max(variation.bias[1], 0.0) + math.hypot(*mounting) + noise,
            "margin": 0.03,
        },
        "usual": {
            "latency": 0.5 * sum(variation.latency) * period,
            "accelerations": [mean],
            "braking": 1.0,
            "error": 0.0,
            "margin": 0.02,
        },
    }


def _filters(task: Task, spec: SimulationSpec) -> Iterator[tuple[type[Filter], Mapping[str, Any], dict[str, Any]]]:
    """Class, arguments of the config, and facts about the robot if the class takes them, of each filter."""
    for name, arguments in _entries(task.filters):
        cls = _checked_class(find_plugin("filter", name), Filter, f"task.filters: {name!r}")
        takes_facts = "robot" in inspect.signature(cls).parameters
        yield cls, arguments, {"robot": robot_facts(task, spec)} if takes_facts else {}


def _entries(setting: Sequence[str | Mapping[str, Any]]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and arguments of each entry, which is a name, or {name: arguments}."""
    for entry in setting:
        ((name, arguments),) = [(entry, None)] if isinstance(entry, str) else entry.items()
        yield name, arguments or {}


def _checked_class(found: Any, base: type, where: str) -> Any:
    """Return `found` if it is a concrete class derived from `base`."""
    if not (isinstance(found, type) and issubclass(found, base)) or inspect.isabstract(found):
        name = f"{base.__module__}.{base.__name__}"
        raise InputError(one_line(f"{where} is not a class derived from {name} that defines its abstract methods"))
    return found


def checked_task_parts(task: Task, spec: SimulationSpec) -> tuple[Actions, tuple[Sensor, ...]]:
    """The actions and sensors of a task, after a dry run of its methods in two environments without a simulator.

    Raises:
        InputError: If a method returns a wrong type or shape. Exceptions inside a method pass unchanged.
    """
    actions, where = task.actions, f"task {type(task).__name__}"
    hint = ", or @property is missing above it" if callable(actions) else ""
    _require(isinstance(actions, Actions), f"{where}: actions must be Commands or Velocities{hint}", actions)
    with np.errstate(all="ignore"):  # some tasks divide by a speed, which is 0 here
        goalless_worlds = [index for index, world in enumerate(spec.worlds) if task.goal_task and world.goal is None]
        # Initial states in world 0; in each world without a goal, which a random draw may miss; in random worlds.
        for start_spec in (*map(spec.for_world, {0, *goalless_worlds}), spec):
            random = GeneratorSource(np.random.default_rng(0), _NUM_ENVS)
            initial_state = task.initial_state(start_spec, random)
            _check_initial_state(initial_state, task, spec, f"{where}: initial_state must")
            task.resolved_variation.vary(initial_state, random)
        robot_state, task_sensors = _state_at_rest(initial_state, spec), task.sensors(spec)
        is_sequence = isinstance(task_sensors, tuple | list)
        _require(is_sequence, f"{where}: sensors must return a tuple: (Compass(),)", task_sensors)
        for sensor in task_sensors:
            hint = f": write {sensor.__name__}()" if isinstance(sensor, type) else ""
            _require(isinstance(sensor, Sensor), f"{where}: sensors must return sensors{hint}", sensor)
        sensors = tuple(task_sensors)
        if task.observe is not None:
            sensors = find_sensors(task.observe, "task.observe", task, sensors, spec)
        for sensor in sensors:
            _check_sensor(sensor, robot_state)
        action = np.zeros((_NUM_ENVS, *(actions.space.shape or ())), actions.space.dtype)
        _check_outcome(task.outcome(robot_state, action, robot_state), task.goal_task, where)
    return actions, sensors


@dataclass(frozen=True)
class _BlankCamera:
    """A camera source whose images are black and infinitely deep."""

    spec: SimulationSpec

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        shape = len(robot_state.pose), height, width
        return np.zeros((*shape, 3), dtype=np.uint8), np.full(shape, np.inf, dtype=np.float32)


def _check_initial_state(initial_state: Any, task: Task, spec: SimulationSpec, prefix: str) -> None:
    """Check the result of `Task.initial_state`; error messages begin with `prefix`."""
    _require(isinstance(initial_state, InitialState), f"{prefix} return an InitialState", initial_state)
    shape, table = (_NUM_ENVS, spec.table.shape[1]), initial_state.table
    _require(np.shape(table) == shape, f"{prefix} return random.num_envs rows, here a table of shape {shape}", table)
    worlds, num_worlds = initial_state.world.tolist(), len(spec.worlds)
    _require(set(worlds) <= set(range(num_worlds)), f"{prefix} use indices of worlds, below {num_worlds}", worlds)
    _require(np.isfinite(initial_state.pose).all(), f"{prefix} return finite poses", initial_state.pose.tolist())
    without_goal = np.isnan(initial_state.goal).any(axis=1)
    if task.goal_task and without_goal.any():
        world = spec.worlds[int(initial_state.world[without_goal.argmax()])].name
        fix = "task.goal to [x, y]" if hasattr(task, "goal") else "initial_state.goal in initial_state"
        raise InputError(f"world {world} has no goal; set {fix}, or a goal in the world's file")


def _state_at_rest(initial_state: InitialState, spec: SimulationSpec) -> RobotState:
    """A read-only robot state at the start of episodes, far from all obstacles."""
    pose, ranges = initial_state.pose.copy(), np.full((_NUM_ENVS, len(spec.laser.angles)), spec.laser.max_range)
    twist, acceleration, no_contact = np.zeros((_NUM_ENVS, 2)), np.zeros(_NUM_ENVS), np.zeros(_NUM_ENVS, bool)
    table, nearest, outlines = initial_state.table.copy(), ranges.min(axis=1), np.zeros((_NUM_ENVS, 1, 6))
    for array in (pose, ranges, twist, acceleration, no_contact, table, nearest, outlines):
        array.flags.writeable = False
    values = pose, twist, pose, twist, ranges, no_contact, twist, acceleration  # first fields of `RobotState`, in order
    obstacles = (outlines, no_contact) if spec.has_dynamic_obstacles else ()
    return RobotState(*values, InitialState(table), _BlankCamera(spec), *obstacles, nearest_range=nearest)


def _check_sensor(sensor: Sensor, robot_state: RobotState) -> None:
    where, shape = f"sensor {type(sensor).__name__}", sensor.shape
    declared: list[Any] = [getattr(sensor, key, None) for key in ("name", "low", "high")]
    name, low, high = declared
    _require(isinstance(name, str), f"{where}: name must be a string", name)
    is_shape = isinstance(shape, tuple) and all(isinstance(count, int | np.integer) and count > 0 for count in shape)
    _require(is_shape, f"{where}: shape must be a tuple of counts, such as (1,)", shape)
    dtype: type = np.uint8 if len(shape) == 3 else float
    has_limits = dtype is np.uint8 or (_is_numeric(low) and _is_numeric(high) and np.all(np.less(low, high)))
    _require(has_limits, f"{where}: low and high must be numbers, low the smaller one", (low, high))
    values = sensor.read(robot_state)
    is_valid = _is_array(values, shape, dtype)
    hint = " (episodes of this task have no goal)" if is_valid and np.isnan(robot_state.goal).any() else ""
    expected = f"an array of shape {('num_envs', *shape)}, {dtype.__name__}, not NaN{hint}"
    _require(is_valid and not np.isnan(values).any(), f"sensor {name} must read {expected}", values)


def _check_outcome(outcome: Any, goal_task: bool, where: str) -> None:
    _require(isinstance(outcome, Outcome), f"{where}: outcome must return an Outcome", outcome)
    reward, succeeded = outcome.reward, outcome.succeeded
    _require(_is_array(reward, (), float), f"{where}: outcome's reward must be float, shape (num_envs,)", reward)
    for key, endings in (("failed", outcome.failed), ("succeeded", {} if succeeded is None else succeeded)):
        _require(isinstance(endings, Mapping), f'{where}: outcome must return {key}={{"name": mask}}', endings)
        for name, mask in endings.items():
            _require(_is_array(mask, (), bool), f"{where}: {key}[{name!r}] must be bool, shape (num_envs,)", mask)
    if goal_task and succeeded is None:
        raise InputError(f'{where}: goal_task is True, so outcome must return succeeded={{"goal": mask}}')
    if succeeded is not None and not goal_task:
        raise InputError(f"{where}: outcome returns an Outcome with succeeded, so set goal_task = True in the class")


def _is_array(value: Any, shape: tuple[int, ...], dtype: type) -> bool:
    return isinstance(value, np.ndarray) and value.shape == (_NUM_ENVS, *shape) and np.can_cast(value.dtype, dtype)


def _is_numeric(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "iuf"


def _require(condition: Any, requirement: str, value: Any) -> None:
    if not condition:
        is_array = isinstance(value, np.ndarray) and value.ndim > 0
        shown = f"an array of {value.dtype}, shape {value.shape}" if is_array else one_line(repr(value), 60)
        raise InputError(f"{requirement}; got {shown}")
