"""What a task observes: its own sensors, or those that its setting `observe` names in their place."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, get_type_hints

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.plugins import import_object
from tb2rl.core.values import checked
from tb2rl.sensors import Sensor
from tb2rl.sensors.names import SENSORS
from tb2rl.simulation import SimulationSpec
from tb2rl.tasks import Task

_ANY_NUMBER = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def observed_sensors(task: Task, own: tuple[Sensor, ...], spec: SimulationSpec) -> tuple[Sensor, ...]:
    """The sensors that `task.observe` lists; those of the task itself if it is None.

    A sensor that is named without arguments, and that the task has or offers, is the task's: with its settings.

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
    """What one entry of the list means: a name, or {name: arguments}."""
    ((name, arguments),) = [(entry, None)] if isinstance(entry, str) else entry.items()
    kinds = _kinds(name)
    if not arguments:
        found = [next((sensor for sensor in present if type(sensor) is kind), None) for kind in kinds]
        return [sensor or _made(kind, name, {}, spec) for sensor, kind in zip(found, kinds, strict=True)]
    if len(kinds) > 1:
        singly = " and ".join(f"{kind.__module__}:{kind.__name__}" for kind in kinds)
        raise InputError(f"task.observe.{name}: it takes no arguments, being several sensors: {singly}")
    return [_made(kinds[0], name, arguments, spec)]


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


def _made(kind: type[Sensor], name: str, arguments: Mapping[str, Any], spec: SimulationSpec) -> Sensor:
    """A sensor with what the robot decides, and with arguments that are held against its class."""
    where, given, taken = f"task.observe.{name}", kind.given(spec), inspect.signature(kind).parameters
    for key in arguments:
        if key not in taken or key in given:
            raise unknown(f"argument of {where}:", key, taken.keys() - given.keys())
    needed = [key for key, one in taken.items() if one.default is one.empty and one.kind not in _ANY_NUMBER]
    lacking = [key for key in needed if key not in {*given, *arguments}]
    if lacking:
        raise InputError(f"{where}: it needs {', '.join(lacking)}; write {{{name}: {{{lacking[0]}: ...}}}}")
    try:
        hints = get_type_hints(kind.__init__, include_extras=True) if arguments else {}
        fitting = {key: checked(hints.get(key, Any), value, f"{where}.{key}") for key, value in arguments.items()}
        return kind(**given, **fitting)
    except InputError:
        raise
    except Exception as error:  # of a user's own class
        raise InputError(one_line(f"{where}: {type(error).__name__}: {error}")) from error
