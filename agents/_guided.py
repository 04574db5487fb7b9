"""What classical navigators share: what they see, the ways that are free, and from speeds to actions."""

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

STRAIGHT = 1e-3  # [1/m] arcs that bend less count as straight
STANDING = 0.05  # [m/s] slower than this a robot stands
TURNING = 0.5  # [rad/s] faster than this it turns
STUCK = 0.15  # [m] a robot that stands turns away from what is nearer ahead than this,
OUT = 0.5  # [m] until so much is free ahead
_STEP = math.radians(5.0)  # between the directions in which it looks for a way out


TURTLEBOT2 = Vehicle()


@dataclass(frozen=True)
class Seen:
    """What the robots observe now; x is ahead and y to the left.

    Attributes:
        points: What the beams have hit, x, y [m], shape (num_envs, beams, 2).
        target: Where to get to, x, y [m], shape (num_envs, 2).
        speed: Forward [m/s], shape (num_envs,).
        turn: To the left [rad/s], shape (num_envs,).
    """

    points: np.ndarray
    target: np.ndarray
    speed: np.ndarray
    turn: np.ndarray


class Guided(BasePolicy):
    """Drives to where its task says, by what it observes alone: the laser, its speeds and the target; it has no map.

    The target is the waypoint of the plan (guide: plan), or the goal itself (guide: goal). `drive` says how.

    Args:
        observation_space: `tb2rl.envs.encodings.SensorBox` of task `navigate`.
        action_space: v and w, from -1 to 1.
        vehicle: What drives; action -1 means to stand.

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
    def drive(self, seen: Seen) -> np.ndarray:
        """The speeds v [m/s] and w [rad/s], shape (num_envs, 2)."""

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        commands = self.drive(self._seen(observation.cpu().numpy().astype(float)))
        shares = np.column_stack([2.0 * commands[:, 0] / self.max_speed - 1.0, commands[:, 1] / self.turn_rate])
        return th.from_numpy(np.clip(shares, -1.0, 1.0).astype(np.float32))

    def _seen(self, numbers: np.ndarray) -> Seen:
        columns = self._columns
        points = numbers[:, columns.laser, None] * self._beams
        target = numbers[:, columns.target]
        if columns.distance is not None:
            target = numbers[:, columns.distance, None] * target
        return Seen(points, target, numbers[:, columns.speed], numbers[:, columns.turn])


class _Columns:
    """Which numbers of an observation say what, in the latest frame.

    Attributes:
        laser, target: Columns of the beams; of x and y, or of cosine and sine where there is a `distance`.
        distance, speed, turn: A column each.
    """

    def __init__(self, space: spaces.Space, who: str) -> None:
        self._names: Sequence[str] = getattr(space, "names", ())
        self._first = len(self._names) - len(self._names) // getattr(space, "frame_stack", 1)
        waypoint, direction, distance = map(self._of, ("waypoint", "goal direction", "goal distance"))
        speed, turn = self._of("forward speed"), self._of("turn rate")
        if not (waypoint or (direction and distance)):
            raise InputError(f"{who} needs to know where to go, as task navigate says by itself; or observe waypoint")
        if not speed or not turn:
            raise InputError(f"{who} needs to know how fast it is; add twist to task.observe")
        self.laser, self.target = self._of("laser"), waypoint or direction
        self.distance = None if waypoint else distance[0]
        self.speed, self.turn = speed[0], turn[0]
        if len(self.laser) < 2:
            raise InputError(f"{who} needs a laser of at least 2 beams, got {len(self.laser)}")

    def _of(self, sensor: str) -> list[int]:
        return [column for column, name in enumerate(self._names) if name == sensor and column >= self._first]


@njit(cache=True, **UNCOUNTED)
def way_out(points, target, speed, turn, radius, gap):
    """To which side a robot turns on the spot until it can leave: 1 to the left, -1 to the right, 0 where it need not.

    The rotate-away mode of the dynamic window approach. A robot that turns already goes on to the same side, for the
    laser does not see what lies behind, and what was there is not remembered: else it would turn to and fro.

    Args:
        points: Of one robot, see `Seen`, as are the next three.
        target: Preferred of two sides that are alike.
        speed: One that drives needs no way out.
        turn: See above.
        radius, gap: As of `free_way`.
    """
    turning = abs(turn) > TURNING
    if abs(speed) > STANDING or free_way(points, 0.0, radius, gap, OUT) >= (OUT if turning else STUCK):
        return 0.0
    side = math.copysign(1.0, turn if turning else target[1])
    if not turning:
        for step in range(1, int(math.pi / _STEP)):
            for towards in (side, -side):
                if _straight(points, towards * step * _STEP, radius + gap) >= OUT:
                    return towards
    return side


@njit(cache=True, **UNCOUNTED)
def free_way(points, curvature, radius, gap, enough):
    """How far a robot drives along an arc until it touches something that is seen [m]; inf: farther than `enough`.

    The obstacle distance of the dynamic window approach (Fox, Burgard & Thrun 1997).

    Args:
        points: Of one robot, see `Seen`, shape (beams, 2).
        curvature: Of the arc, 1 over its radius, to the left [1/m].
        radius: Of the robot [m].
        gap: By how much wider it counts on every side [m], but where it is nearer already.
        enough: What is farther does not matter [m].
    """
    way = math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        square = x * x + y * y
        if square <= (enough + radius + gap) ** 2:
            near = square < (radius + gap) ** 2
            way = min(way, _until_touch(x, y, curvature, radius if near else radius + gap))
    return way


@njit(cache=True, **UNCOUNTED)
def _straight(points, direction, radius):
    """How far a circle gets straight on in a direction [rad]."""
    cos, sin, way = math.cos(direction), math.sin(direction), math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        way = min(way, _until_touch(cos * x + sin * y, cos * y - sin * x, 0.0, radius))
    return way


@njit(cache=True, **UNCOUNTED)
def _until_touch(x, y, curvature, radius):
    """How far a circle drives along an arc until it touches the point x, y [m]; one within it stops what nears it."""
    if x * x + y * y <= radius * radius:
        return 0.0 if x > 0.0 else math.inf
    if abs(curvature) < STRAIGHT:
        return x - math.sqrt(radius * radius - y * y) if x > 0.0 and abs(y) < radius else math.inf
    bend = 1.0 / abs(curvature)  # the arc's radius; x and `inward` count from its middle
    inward = bend - math.copysign(y, y * curvature)
    square = x * x + inward * inward
    if not (bend - radius) ** 2 < square < (bend + radius) ** 2:
        return math.inf
    before = math.acos((bend * bend + square - radius * radius) / (2.0 * bend * math.sqrt(square)))
    angle = math.atan2(x, inward) - before  # around the middle: the point's, and from the touching circle to it
    return bend * (angle if angle >= 0.0 else angle + math.tau)
