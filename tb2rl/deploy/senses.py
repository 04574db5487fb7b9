"""What the sensors of a task ask of a robot, and whether a robot can know it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.scene import Scene
from tb2rl.sensors import Sensor
from tb2rl.simulation import Reading, Setup, Start

_ODOMETRY = frozenset({"pose", "odometry", "odometry_twist", "twist", "acceleration", "trail"})
_SENSED = _ODOMETRY | {"ranges", "nearest", "bumped", "command", "told", "goal"}


@dataclass(frozen=True)
class Senses:
    """What a policy senses beside its laser.

    Attributes:
        odometry: Whether it senses where it is, or how it moves.
        goal: Whether it senses where its goal is.
        reach: How far ahead on a plan the point is that it senses [m]; None: it senses none.
    """

    odometry: bool
    goal: bool
    reach: float | None


def find_senses(scene: Scene) -> Senses:
    """What the sensors of a scene ask of a robot.

    Raises:
        InputError: If one asks for what no robot knows, such as its true pose, or for images.
    """
    asked: set[str] = set()
    reaches: set[float] = set()
    for sensor in scene.sensors:
        reading = _Asked(sensor, scene.setup)
        if "pose" in reading.asked and not reading.reaches:  # which who follows a plan knows by odometry
            raise _unknown(sensor, "pose")
        asked, reaches = asked | reading.asked, reaches | reading.reaches
    if len(reaches) > 1:
        raise InputError(f"its sensors look at {len(reaches)} points of a plan, and a driver is told one")
    return Senses(bool(asked & _ODOMETRY), "goal" in asked, reaches.pop() if reaches else None)


class _Asked:
    """A reading of a robot that stands, and what a sensor asks of it."""

    def __init__(self, sensor: Sensor, setup: Setup) -> None:
        if len(sensor.shape) == 3:
            raise InputError(one_line(f"sensor {sensor.name} reads images, and a driver has none"))
        still, here = np.zeros((1, 2)), np.zeros((1, 3))
        start = Start.proposed(setup, 1)
        start.goal[:] = 1.0, 0.0
        ranges = np.full((1, len(setup.laser.angles)), setup.laser.max_range)
        self._reading = Reading(here, still, here, still, ranges, np.zeros(1, dtype=bool), still, np.zeros(1), start)
        self._sensor, self.asked, self.reaches = sensor, set[str](), set[float]()
        sensor.read(self)  # type: ignore[arg-type]

    def ahead(self, reach: float) -> np.ndarray:
        """See `Reading.ahead`."""
        self.reaches.add(reach)
        return self._reading.goal

    def __getattr__(self, name: str) -> Any:
        if name not in _SENSED:
            raise _unknown(self._sensor, name)
        self.asked.add(name)
        return getattr(self._reading, name)


def _unknown(sensor: Sensor, name: str) -> InputError:
    return InputError(one_line(f"sensor {sensor.name} reads the simulation's {name!r}, which no robot can sense"))
