"""Robots by name."""

from __future__ import annotations

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin
from tb2rl.robots.robot import Robot, check_robot


def find_robot(name: str) -> Robot:
    """The robot of a name, or of "module:ROBOT"."""
    found = find_plugin("robot", name)
    if not isinstance(found, Robot):
        raise InputError(f"robot {name!r} is not a tb2rl.robots.Robot")
    check_robot(found)
    return found
