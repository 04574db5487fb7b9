"""The description of an exported policy as plain values with units: observation, actions, requirements."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.deploy.needs import needs_in
from tb2rl.deploy.portable.encoding import SENSORS
from tb2rl.runs.config import Config
from tb2rl.sensors import Sensor
from tb2rl.tasks.actions import Commands, Velocities

_FACTS = ("name", "unit", "shape", "low", "high", "bins")
_ARGUMENTS = ("around", "directions", "max_speeds", "near", "radius", "reads_commands")  # that SENSORS use


def describe(config: Config, name: str) -> dict[str, Any]:
    """Describe a policy without its layers, in values for JSON.

    Args:
        config: Its training.
        name: The user's name for it.

    Raises:
        InputError: If its actions are neither `Commands` nor `Velocities`.
    """
    sensors = [_sensor(sensor) for sensor in config.scene.sensors]
    return {
        "policy": name,
        "agent": config.agent_name,
        "task": config.task_name,
        "tb2rl": tb2rl.__version__,
        "observation": {"mode": config.observation, "frame_stack": config.task.frame_stack, "sensors": sensors},
        "actions": _actions(config),
    }


def portable_needs(config: Config) -> dict[str, Any]:
    """The requirements of a policy on a robot without tb2rl: the fields of `portable.policy_contract.Needs`.

    Raises:
        InputError: If it has a sensor that is not available there.
    """
    for sensor in config.scene.sensors:
        if sensor.name not in SENSORS or not type(sensor).__module__.startswith("tb2rl.sensors."):
            raise InputError(
                f"without tb2rl a robot cannot read sensor {sensor.name!r}, only {', '.join(SENSORS)}; export to a "
                "file policy.onnx, which takes the observation, and compute that yourself"
            )
    needs = needs_in(config.scene)
    if config.task.maps_online:  # there is no mapper on the robot
        needs = replace(needs, goal="plan")
    return {**asdict(needs), "beams": needs.beams.tolist()}


def _sensor(sensor: Sensor) -> dict[str, Any]:
    arguments = {name: value for name, value in vars(sensor).items() if name in _ARGUMENTS}
    facts = {name: getattr(sensor, name) for name in _FACTS}
    return facts | {name: np.asarray(value).tolist() for name, value in arguments.items()}


def _actions(config: Config) -> dict[str, Any]:
    """The commands v [m/s] and w [rad/s] of each named action, or of -1 and 1, the ends of a continuous one."""
    actions = config.scene.actions
    if isinstance(actions, Commands):
        return {"names": actions.names, "commands": actions.table.tolist()}
    if isinstance(actions, Velocities):
        return {"low": actions.low.tolist(), "high": actions.high.tolist()}
    raise InputError(f"actions of the kind {type(actions).__name__} cannot be exported, only Commands and Velocities")
