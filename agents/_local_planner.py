"""Base of the classical local planners: their view of the robot's surroundings, free distances, speeds to actions."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.errors import InputError
from tb2rl.robots.vehicle import Vehicle

STRAIGHT = 1e-3  # [1/m] an arc of less curvature counts as straight
STANDING = 0.05  # [m/s] a slower robot stands
TURNING = 0.5  # [rad/s] a faster one turns
STUCK = 0.15  # [m] a standing robot rotates away from an obstacle nearer ahead,
FREE = 0.5  # [m] until this much is free ahead
_STEP = math.radians(5.0)  # between the directions in which it looks for free space
TURTLEBOT2 = Vehicle()


@dataclass(frozen=True)
class LocalView:
    """The surroundings of each robot in its own frame: x ahead, y to the left.

    Attributes:
        points: Hits of the beams, x, y [m], shape (num_envs, beams, 2).
        target: x, y [m], shape (num_envs, 2).
        speed: Forward [m/s], shape (num_envs,).
        turn: Turn rate, positive to the left [rad/s], shape (num_envs,).
    """

    points: np.ndarray
    target: np.ndarray
    speed: np.ndarray
    turn: np.ndarray


class LocalPlanner(BasePolicy):
    """Drives to the target of its task by laser, speeds and target alone, without a map; `plan` decides how.

    The target is the waypoint of the plan (guide: plan), or the goal itself (guide: goal).

    Args:
        observation_space: `tb2rl.envs.encodings.SensorBox` of task `navigate`.
        action_space: v and w, from -1 to 1.
        vehicle: The robot; action -1 is standstill.

    Raises:
        InputError: If the laser, the target or the speeds are not observed, or the actions are not v and w.
    """

    def __init__(
        self, observation_space: spaces.Space, action_space: spaces.Space, vehicle: Vehicle, **kwargs: Any
    ) -> None:
        super().__init__(observation_space, action_space, **kwargs)
        name = type(self).__name__.lower()
        self._columns = columns = _Columns(observation_space, name)
        if not isinstance(action_space, spaces.Box) or not isinstance(observation_space, spaces.Box):
            raise InputError(f"{name} sets speeds, so it needs task.named_actions=false")
        self.max_speed, self.turn_rate = vehicle.max_speed, vehicle.turn_rate
        self.radius, self.period = vehicle.radius, vehicle.period
        beams, directions = len(columns.laser), vehicle.directions
        angles = np.linspace(-math.pi / 2, math.pi / 2, beams) if directions is None else np.asarray(directions)
        if len(angles) != beams:
            raise InputError(f"{name} needs the directions of its {beams} beams, got {len(angles)}")
        self._beams = np.column_stack([np.cos(angles), np.sin(angles)])

    @abstractmethod
    def plan(self, view: LocalView) -> np.ndarray:
        """The speeds v [m/s] and w [rad/s], shape (num_envs, 2)."""

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        commands = self.plan(self._view(observation.cpu().numpy().astype(float)))
        shares = np.column_stack([2.0 * commands[:, 0] / self.max_speed - 1.0, commands[:, 1] / self.turn_rate])
        return th.from_numpy(np.clip(shares, -1.0, 1.0).astype(np.float32))

    def _view(self, numbers: np.ndarray) -> LocalView:
        columns = self._columns
        points = numbers[:, columns.laser, None] * self._beams
        target = numbers[:, columns.target]
        if columns.distance is not None:
            target = numbers[:, columns.distance, None] * target
        return LocalView(points, target, numbers[:, columns.speed], numbers[:, columns.turn])


class _Columns:
    """Columns of the latest frame of an observation.

    Attributes:
        laser, target: Of the beams; of x and y, or of cosine and sine if there is a `distance`.
        distance, speed, turn: One column each.
    """

    def __init__(self, space: spaces.Space, agent: str) -> None:
        self._names: Sequence[str] = getattr(space, "names", ())
        self._first = len(self._names) - len(self._names) // getattr(space, "frame_stack", 1)
        waypoint, direction, distance = map(self._of, ("waypoint", "goal direction", "goal distance"))
        speed, turn = self._of("forward speed"), self._of("turn rate")
        if not (waypoint or (direction and distance)):
            raise InputError(f"{agent} needs to know where to go, as task navigate says by itself; or observe waypoint")
        if not speed or not turn:
            raise InputError(f"{agent} needs to know how fast it is; add twist to task.observe")
        self.laser, self.target = self._of("laser"), waypoint or direction
        self.distance = None if waypoint else distance[0]
        self.speed, self.turn = speed[0], turn[0]
        if len(self.laser) < 2:
            raise InputError(f"{agent} needs a laser of at least 2 beams, got {len(self.laser)}")

    def _of(self, sensor: str) -> list[int]:
        return [column for column, name in enumerate(self._names) if name == sensor and column >= self._first]


# ---- geometry of one robot; `points`, `target`, `speed` and `turn` are a row of `LocalView`


@njit(cache=True, **UNCOUNTED)
def rotation_side(points, target, speed, turn, radius, gap):
    """The side to which a stuck robot rotates: 1 left, -1 right, 0 not at all.

    The rotate-away mode of the dynamic window approach. A robot that rotates already keeps its side, because the laser
    does not see behind and the planner has no memory: else it would turn to and fro. `radius`, `gap`: see
    `free_distance`.
    """
    turning = abs(turn) > TURNING
    if abs(speed) > STANDING or free_distance(points, 0.0, radius, gap, FREE) >= (FREE if turning else STUCK):
        return 0.0
    side = math.copysign(1.0, turn if turning else target[1])
    if not turning:
        for step in range(1, int(math.pi / _STEP)):
            for towards in (side, -side):
                if _free_straight(points, towards * step * _STEP, radius + gap) >= FREE:
                    return towards
    return side


@njit(cache=True, **UNCOUNTED)
def free_distance(points, curvature, radius, gap, enough):
    """The distance along an arc to the first touch [m]; inf: more than `enough`.

    The obstacle distance of the dynamic window approach (Fox, Burgard & Thrun 1997).

    Args:
        points: Shape (beams, 2).
        curvature: Of the arc, positive to the left [1/m].
        radius: Of the robot [m].
        gap: Added to the radius [m], except for points that are nearer already.
        enough: Largest distance of interest [m].
    """
    free = math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        square = x * x + y * y
        if square <= (enough + radius + gap) ** 2:
            near = square < (radius + gap) ** 2
            free = min(free, _distance_to_touch(x, y, curvature, radius if near else radius + gap))
    return free


@njit(cache=True, **UNCOUNTED)
def _free_straight(points, direction, radius):
    """The distance to the first touch straight in a direction [rad]."""
    cos, sin, free = math.cos(direction), math.sin(direction), math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        free = min(free, _distance_to_touch(cos * x + sin * y, cos * y - sin * x, 0.0, radius))
    return free


@njit(cache=True, **UNCOUNTED)
def _distance_to_touch(x, y, curvature, radius):
    """The distance along an arc until a circle touches the point x, y [m]; 0 if the point is ahead within it."""
    if x * x + y * y <= radius * radius:
        return 0.0 if x > 0.0 else math.inf
    if abs(curvature) < STRAIGHT:
        return x - math.sqrt(radius * radius - y * y) if x > 0.0 and abs(y) < radius else math.inf
    bend = 1.0 / abs(curvature)  # the arc's radius; x and `inward` count from its centre
    inward = bend - math.copysign(y, y * curvature)
    square = x * x + inward * inward
    if not (bend - radius) ** 2 < square < (bend + radius) ** 2:
        return math.inf
    before = math.acos((bend * bend + square - radius * radius) / (2.0 * bend * math.sqrt(square)))
    angle = math.atan2(x, inward) - before  # around the centre: the point's, less that to the touching circle
    return bend * (angle if angle >= 0.0 else angle + math.tau)
