"""What an exported policy says of itself in plain values: what it observes, commands and needs, with units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.deploy.trained import TrainedPolicy
from tb2rl.runs.config import Config
from tb2rl.sensors import Sensor
from tb2rl.sensors.bumper import Bumper
from tb2rl.sensors.goal import GoalBearing, GoalDirection, GoalDistance
from tb2rl.sensors.laser import LaserRanges
from tb2rl.sensors.motion import ForwardAcceleration, ForwardSpeed, LastAction, TurnRate, YawRate
from tb2rl.sensors.paths import FreePaths
from tb2rl.sensors.visited import Visited
from tb2rl.sensors.waypoint import Waypoint, WaypointBearing
from tb2rl.tasks.actions import Commands, Velocities

_ARGUMENTS: Mapping[type[Sensor], tuple[str, ...]] = {  # what `portable/encoding.py` reads, too, and by which arguments
    Bumper: (),
    ForwardAcceleration: (),
    ForwardSpeed: (),
    FreePaths: ("directions", "radius"),
    GoalBearing: (),
    GoalDirection: (),
    GoalDistance: (),
    LaserRanges: (),
    LastAction: ("max_speeds", "reads_commands"),
    TurnRate: (),
    Visited: ("around", "near"),
    Waypoint: (),
    WaypointBearing: (),
    YawRate: (),
}


def describe(config: Config, name: str) -> dict[str, Any]:
    """A policy, but for its layers, as JSON can hold it.

    Args:
        config: What it was trained to do.
        name: What the user calls it.

    Raises:
        InputError: If its actions are of a kind of a user's own.
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


def needs_of(policy: BaseAlgorithm, config: Config) -> dict[str, Any]:
    """What a policy needs of a robot that has no tb2rl: the fields of `portable.policy_contract.Needs`.

    Raises:
        InputError: If it observes what cannot be read there.
    """
    for sensor in config.scene.sensors:
        if type(sensor) not in _ARGUMENTS:
            known = ", ".join(sorted(kind.name for kind in _ARGUMENTS))
            raise InputError(
                f"without tb2rl a robot cannot read sensor {sensor.name!r}, only {known}; export to a file "
                "policy.onnx, which begins at the observation, and make that yourself"
            )
    needs = TrainedPolicy(policy, config).needs
    if config.task.maps_online:  # it draws no map there
        needs = replace(needs, goal="plan")
    return {**asdict(needs), "beams": needs.beams.tolist()}


def _sensor(sensor: Sensor) -> dict[str, Any]:
    facts = {name: getattr(sensor, name) for name in ("name", "unit", "shape", "low", "high", "bins")}
    arguments = {name: np.asarray(getattr(sensor, name)).tolist() for name in _ARGUMENTS.get(type(sensor), ())}
    return {**facts, **arguments}


def _actions(config: Config) -> dict[str, Any]:
    """What the actions command, v [m/s] and w [rad/s]: each named one, or -1 and 1, the ends of a range."""
    actions = config.scene.actions
    if isinstance(actions, Commands):
        return {"names": actions.names, "commands": actions.table.tolist()}
    if isinstance(actions, Velocities):
        return {"low": actions.low.tolist(), "high": actions.high.tolist()}
    raise InputError(f"actions of the kind {type(actions).__name__} cannot be exported, only Commands and Velocities")
