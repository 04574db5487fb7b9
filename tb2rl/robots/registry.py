"""Robots by name."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin
from tb2rl.core.values import build
from tb2rl.robots.robot import Robot


def find_robot(name: str) -> Robot:
    """The robot of a name, or of "module:ROBOT".

    Raises:
        InputError: If there is none, or one of its numbers does not fit.
    """
    found = find_plugin("robot", name)
    if not isinstance(found, Robot):
        raise InputError(f"robot {name!r} is not a tb2rl.robots.Robot")
    _check(found)
    return found


@cache  # a check takes a fifth of the time to open an environment
def _check(robot: Robot) -> None:
    build(type(robot), asdict(robot), f"robot {robot.name}")
    laser, camera = robot.laser, robot.camera
    for name, least, largest in (
        ("laser.min_range and max_range", laser.min_range, laser.max_range),
        ("camera.range", *camera.range),
    ):
        if least >= largest:
            raise InputError(f"robot {robot.name}.{name}: the first must be below the second, got {least}, {largest}")
