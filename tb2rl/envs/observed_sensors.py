"""The sensors that a task observes: its own, or those of its setting `observe`."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.plugins import import_object, make_part
from tb2rl.sensors import Sensor
from tb2rl.sensors.names import SENSORS
from tb2rl.simulation import SimulationSpec
from tb2rl.tasks import Task


def observed_sensors(task: Task, own: tuple[Sensor, ...], spec: SimulationSpec) -> tuple[Sensor, ...]:
    """The sensors that `task.observe` lists; those of the task itself if it is None.

    A sensor that is named without arguments has the task's settings if it is among the task's own or available ones.

    Args:
        task: The task.
        own: Its own sensors.
        spec: The robot and the worlds.

    Raises:
        InputError: For an unknown name, arguments that do not fit, or a sensor that is listed twice.
    """
    if task.observe is None:
        return own
    present = [*own, *task.available_sensors(spec)]
    sensors = [sensor for entry in task.observe for sensor in _sensors(entry, present, spec)]
    names = [sensor.name for sensor in sensors]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(one_line(f"task.observe: sensor {twice[0]!r} is listed twice"))
    return tuple(sensors)


def _sensors(entry: str | Mapping[str, Any], present: list[Sensor], spec: SimulationSpec) -> list[Sensor]:
    """The sensors of an entry: a name, or {name: arguments}."""
    ((name, arguments),) = [(entry, None)] if isinstance(entry, str) else entry.items()
    kinds = _kinds(name)
    if not arguments:
        found = [next((sensor for sensor in present if type(sensor) is kind), None) for kind in kinds]
        return [
            sensor or make_part(kind, {}, f"task.observe.{name}", kind.given(spec))
            for sensor, kind in zip(found, kinds, strict=True)
        ]
    if len(kinds) > 1:
        singly = " and ".join(f"{kind.__module__}:{kind.__name__}" for kind in kinds)
        raise InputError(f"task.observe.{name}: it takes no arguments, being several sensors: {singly}")
    return [make_part(kinds[0], arguments, f"task.observe.{name}", kinds[0].given(spec))]


def _kinds(name: str) -> tuple[type[Sensor], ...]:
    """The classes of a name, or of "module:Sensor"."""
    if ":" not in name:
        if name not in SENSORS:
            raise unknown("sensor of task.observe:", name, SENSORS)
        return SENSORS[name]
    try:
        found = import_object(name)
    except InputError as error:
        raise InputError(one_line(f"task.observe: {error}")) from None
    if not (isinstance(found, type) and issubclass(found, Sensor)) or inspect.isabstract(found):
        raise InputError(one_line(f"task.observe: {name!r} is not a class derived from tb2rl.sensors.Sensor with read"))
    return (found,)
