"""What the sensors of a task ask of a robot, and whether a robot can know it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.scene import Scene
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, RobotState, SimulationSpec

_ODOMETRY = frozenset({"pose", "odometry", "odometry_twist", "twist", "acceleration", "pose_history"})
_SENSED = _ODOMETRY | {"ranges", "nearest", "bumped", "command", "command_history", "goal"}


@dataclass(frozen=True)
class Senses:
    """What a policy senses beside its laser.

    Attributes:
        odometry: Whether it senses where it is, or how it moves.
        goal: Whether it senses where its goal is.
        lookahead: How far ahead on a plan the point is that it senses [m]; None: it senses none.
    """

    odometry: bool
    goal: bool
    lookahead: float | None


def find_senses(scene: Scene) -> Senses:
    """What the sensors of a scene ask of a robot.

    Raises:
        InputError: If one asks for what no robot knows, such as its true pose, or for images.
    """
    asked: set[str] = set()
    lookaheads: set[float] = set()
    for sensor in scene.sensors:
        robot_state = _Asked(sensor, scene.spec)
        if "pose" in robot_state.asked and not robot_state.lookaheads:  # which who follows a plan knows by odometry
            raise _unknown(sensor, "pose")
        asked, lookaheads = asked | robot_state.asked, lookaheads | robot_state.lookaheads
    if len(lookaheads) > 1:
        raise InputError(f"its sensors look at {len(lookaheads)} points of a plan, and a driver is told one")
    return Senses(bool(asked & _ODOMETRY), "goal" in asked, lookaheads.pop() if lookaheads else None)


class _Asked:
    """A reading of a robot that stands, and what a sensor asks of it."""

    def __init__(self, sensor: Sensor, spec: SimulationSpec) -> None:
        if len(sensor.shape) == 3:
            raise InputError(one_line(f"sensor {sensor.name} reads images, and a driver has none"))
        still, here = np.zeros((1, 2)), np.zeros((1, 3))
        initial_state = InitialState.default(spec, 1)
        initial_state.goal[:] = 1.0, 0.0
        ranges = np.full((1, len(spec.laser.angles)), spec.laser.max_range)
        self._reading = RobotState(
            here, still, here, still, ranges, np.zeros(1, dtype=bool), still, np.zeros(1), initial_state
        )
        self._sensor, self.asked, self.lookaheads = sensor, set[str](), set[float]()
        sensor.read(self)  # type: ignore[arg-type]

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        self.lookaheads.add(lookahead)
        return self._reading.goal

    def __getattr__(self, name: str) -> Any:
        if name not in _SENSED:
            raise _unknown(self._sensor, name)
        self.asked.add(name)
        return getattr(self._reading, name)


def _unknown(sensor: Sensor, name: str) -> InputError:
    return InputError(one_line(f"sensor {sensor.name} reads the simulation's {name!r}, which no robot can sense"))
