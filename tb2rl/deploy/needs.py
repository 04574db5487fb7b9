"""The requirements of a policy on a robot, found by probing the sensors of its task."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError, one_line
from tb2rl.deploy.portable.policy_contract import Needs, Speeds
from tb2rl.envs.scene import Scene
from tb2rl.sensors import Sensor
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.tasks import Actions

_ODOMETRY = frozenset({"pose", "odometry", "odometry_twist", "twist", "acceleration", "pose_history"})
_AVAILABLE = _ODOMETRY | {"ranges", "nearest", "bumped", "command", "command_history", "goal"}
_GOAL_RADIUS = 0.3  # [m] for tasks without `goal_radius` and `goal_tolerance`


def needs_in(scene: Scene) -> Needs:
    """The requirements of a policy that was trained in a scene.

    Raises:
        InputError: If it observes what no robot can sense, such as its true pose, or images.
    """
    task, laser = scene.task, scene.laser
    fields, lookahead = _fields_read(scene)
    goal = "plan" if lookahead is not None and not task.maps_online else None
    if goal is None and (task.goal_task or task.maps_online or "goal" in fields):
        goal = "goal"
    max_speed, max_turn_rate = _largest_command(scene.actions)
    return Needs(
        beams=laser.angles,
        min_range=laser.min_range,
        max_range=laser.max_range,
        period=task.control_period,
        max_speed=max_speed,
        max_turn_rate=max_turn_rate,
        robot=scene.robot.name,
        uses_odometry=bool(fields & _ODOMETRY) or task.maps_online,
        goal=goal,
        goal_radius=getattr(task, "goal_radius", getattr(task, "goal_tolerance", _GOAL_RADIUS)),
        lookahead=lookahead or 0.0,
    )


def _fields_read(scene: Scene) -> tuple[set[str], float | None]:
    """The fields of `RobotState` that the sensors read, and the lookahead [m] of the point on a plan, if any."""
    fields: set[str] = set()
    lookaheads: set[float] = set()
    for sensor in scene.sensors:
        if len(sensor.shape) == 3:
            raise InputError(one_line(f"sensor {sensor.name} reads images, and a driver has none"))
        probe = _Probe(sensor, scene.spec)
        if "pose" in probe.fields and not probe.lookaheads:  # a follower of a plan knows its pose by odometry
            raise _unavailable(sensor, "pose")
        fields, lookaheads = fields | probe.fields, lookaheads | probe.lookaheads
    if len(lookaheads) > 1:
        raise InputError(f"its sensors look at {len(lookaheads)} points of a plan, and a driver has one")
    return fields, lookaheads.pop() if lookaheads else None


class _Probe:
    """The state of a robot at rest that records which of its fields a sensor reads."""

    def __init__(self, sensor: Sensor, spec: SimulationSpec) -> None:
        rest, pose = np.zeros((1, 2)), np.zeros((1, 3))
        initial_state = InitialState.default(spec, 1)
        initial_state.goal[:] = 1.0, 0.0
        ranges, bumped = np.full((1, len(spec.laser.angles)), spec.laser.max_range), np.zeros(1, dtype=bool)
        self._state = RobotState(pose, rest, pose, rest, ranges, bumped, rest, np.zeros(1), initial_state)
        self._sensor, self.fields, self.lookaheads = sensor, set[str](), set[float]()
        sensor.read(self)  # type: ignore[arg-type]

    def lookahead_point(self, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        self.lookaheads.add(lookahead)
        return self._state.goal

    def __getattr__(self, name: str) -> Any:
        if name not in _AVAILABLE:
            raise _unavailable(self._sensor, name)
        self.fields.add(name)
        return getattr(self._state, name)


def _unavailable(sensor: Sensor, name: str) -> InputError:
    return InputError(one_line(f"sensor {sensor.name} reads the simulation's {name!r}, which no robot can sense"))


def _largest_command(actions: Actions) -> Speeds:
    """The largest |v| [m/s] and |w| [rad/s] of the actions."""
    space = actions.space
    if isinstance(space, spaces.Discrete):
        extremes = np.arange(space.n)
    else:
        assert isinstance(space, spaces.Box)
        extremes = np.array(list(product(*zip(space.low, space.high, strict=True))))
    v, w = np.abs(actions.commands(extremes)).max(axis=0).tolist()
    return v, w
