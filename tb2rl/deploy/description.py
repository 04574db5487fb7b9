"""Describes a policy in plain values: observation, actions, and requirements on a robot."""

from dataclasses import asdict
from itertools import product
from typing import Any

import numpy as np
from gymnasium import spaces

import tb2rl
from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.portable.encoding import SENSORS
from tb2rl.deploy.portable.policy_contract import Needs
from tb2rl.envs.scene import Scene
from tb2rl.runs.config import Config
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.tasks.actions import Commands, Velocities

_SENSOR_ATTRIBUTES = ("name", "unit", "shape", "low", "high", "bins")
_SENSOR_SETTINGS = ("around", "directions", "max_speeds", "near", "radius", "command_history_length")  # for `SENSORS`
_ODOMETRY_FIELDS = frozenset({"pose", "odometry", "odometry_twist", "twist", "acceleration", "position_history"})
_SENSED_FIELDS = _ODOMETRY_FIELDS | {"ranges", "nearest_range", "bumped", "command", "command_history", "goal"}
_DEFAULT_GOAL_RADIUS = 0.3  # [m] for tasks without `goal_radius` and `goal_tolerance`


def describe(config: Config, name: str) -> dict[str, Any]:
    """Describe a policy without its layers, in values for JSON; `name` is the user's name for it.

    Raises:
        InputError: If the actions are neither `Commands` nor `Velocities`.
    """
    sensors = []
    for sensor in config.scene.sensors:
        values = {key: getattr(sensor, key) for key in _SENSOR_ATTRIBUTES}
        settings = {key: np.asarray(value).tolist() for key, value in vars(sensor).items() if key in _SENSOR_SETTINGS}
        sensors.append(values | settings)
    actions = config.scene.actions
    if isinstance(actions, Commands):  # v [m/s] and w [rad/s] of each action
        action_values = {"names": actions.names, "commands": actions.table.tolist()}
    elif isinstance(actions, Velocities):  # v [m/s] and w [rad/s] of the actions (-1, -1) and (1, 1)
        action_values = {"low": actions.low.tolist(), "high": actions.high.tolist()}
    else:
        raise InputError(f"actions {type(actions).__name__} cannot be exported, only Commands and Velocities")
    return {
        "policy": name,
        "agent": config.agent_name,
        "task": config.task_name,
        "tb2rl": tb2rl.__version__,
        "observation": {"mode": config.observation, "frame_stack": config.task.frame_stack, "sensors": sensors},
        "actions": action_values,
    }


def find_portable_needs(config: Config) -> dict[str, Any]:
    """Find the requirements of a policy on a robot without tb2rl, as the fields of `Needs`.

    Raises:
        InputError: If a sensor is not available on such a robot.
    """
    for sensor in config.scene.sensors:
        if sensor.name not in SENSORS or not type(sensor).__module__.startswith("tb2rl.sensors."):
            hint = "export a file policy.onnx, and compute the observation yourself"
            raise InputError(f"the folder has no sensor {sensor.name!r}, only tb2rl's own {', '.join(SENSORS)}; {hint}")
    needs = find_needs(config.scene, maps_online=False)  # another program must map and plan
    return {**asdict(needs), "beams": needs.beams.tolist()}


def find_needs(scene: Scene, maps_online: bool | None = None) -> Needs:
    """Find the requirements of a policy that was trained in a scene.

    Args:
        scene: The scene.
        maps_online: Whether the driver maps and plans online; None: if the task does.

    Raises:
        InputError: If the policy observes what `Driver` lacks, such as the true pose, or images.
    """
    task, laser = scene.task, scene.laser
    maps_online = task.maps_online if maps_online is None else maps_online
    fields, lookaheads = set[str](), set[float]()
    for sensor in scene.sensors:
        if len(sensor.shape) == 3:
            raise InputError(one_line(f"sensor {sensor.name} reads images, and a driver has no camera"))
        probe = _Probe(sensor, scene.spec)
        if "pose" in probe.fields and not probe.lookaheads:  # odometry replaces it only for lookahead points
            raise _unavailable_error(sensor, "pose")
        fields, lookaheads = fields | probe.fields, lookaheads | probe.lookaheads
    if len(lookaheads) > 1 and not maps_online:
        raise InputError(f"the sensors read {len(lookaheads)} points of a plan, and a driver has only one")
    has_goal = task.goal_task or maps_online or "goal" in fields
    goal = "plan" if lookaheads and not maps_online else "goal" if has_goal else None
    space: Any = scene.actions.space
    is_discrete = isinstance(space, spaces.Discrete)
    extremes = np.arange(space.n) if is_discrete else np.array([*product(*zip(space.low, space.high, strict=True))])
    max_speed, max_turn_rate = np.abs(scene.actions.commands(extremes)).max(axis=0).tolist()
    limits = laser.min_range, laser.max_range, task.control_period, max_speed, max_turn_rate
    uses_odometry = bool(fields & _ODOMETRY_FIELDS) or maps_online
    radius = getattr(task, "goal_radius", getattr(task, "goal_tolerance", _DEFAULT_GOAL_RADIUS))
    return Needs(laser.angles, *limits, scene.robot.name, uses_odometry, goal, radius, max(lookaheads, default=0.0))


class _Probe:
    """A robot state at rest that records the fields that a sensor reads."""

    def __init__(self, sensor: Sensor, spec: SimulationSpec) -> None:
        rest, pose, bumped = np.zeros((1, 2)), np.zeros((1, 3)), np.zeros(1, dtype=bool)
        ranges = np.full((1, len(spec.laser.angles)), spec.laser.max_range)
        initial_state = InitialState.default(spec, 1)
        initial_state.goal[:] = 1.0, 0.0
        self._state = RobotState(pose, rest, pose, rest, ranges, bumped, rest, np.zeros(1), initial_state)
        self._sensor, self.fields, self.lookaheads = sensor, set[str](), set[float]()
        sensor.read(self)  # type: ignore[arg-type]

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """Record the lookahead; stands in for `RobotState.lookahead_point`, and returns an arbitrary point."""
        self.lookaheads.add(lookahead)
        return self._state.goal

    def __getattr__(self, name: str) -> Any:
        if name not in _SENSED_FIELDS:
            raise _unavailable_error(self._sensor, name)
        self.fields.add(name)
        return getattr(self._state, name)


def _unavailable_error(sensor: Sensor, name: str) -> InputError:
    return InputError(one_line(f"sensor {sensor.name} reads {name!r}, which no robot can sense"))
