"""VFH+, the vector field histogram for a robot of some width (Ulrich & Borenstein 1998).

I. Ulrich and J. Borenstein, "VFH+: reliable obstacle avoidance for fast mobile robots".
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import STANDING, TURNING, TURTLEBOT2, LocalPlanner, LocalView
from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.vfh:VFH", observation="raw", only=True)

SECTORS = 72  # of the histogram: all around, the first one backwards
_WIDTH = math.tau / SECTORS  # [rad] of each
_LEAST = 0.05  # [m] a direction of less free distance is blocked, however near the target is
_ASIDE = math.radians(10.0)  # up to this to the other side counts as straight ahead


class _Costs(NamedTuple):
    """Costs of a candidate for each radian off the target, off straight ahead, and off the previous direction."""

    target: float
    heading: float
    previous: float


class VFH(LocalPlanner):
    """Turns to the best free direction, and drives as fast as the free distance ahead allows.

    The histogram holds the free distance of the robot, with its width, in each direction. A direction of less than
    `window` is blocked: VFH+'s threshold without its grid of past scans. Unseen directions count as free. Candidates
    keep half of `valley` from both edges of a wide valley, or the middle of a narrow one; the target's own direction
    may be one. A robot that turns on the spot keeps its side, because it does not see the other one: else it would turn
    to and fro. The observed turn rate stands for the previous direction.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        window: Free distance of an open direction, or that to a nearer target [m].
        valley: Sectors of 5 degrees in a wide valley.
        to_target: Cost of a radian off the target; more than the next two together, or it may never get there.
        to_heading: Cost of a radian off straight ahead.
        to_previous: Cost of a radian off the previous direction.
        gain: Turn rate for a direction one radian to the left [1/s].
        braking: Assumed deceleration [m/s^2].
        spin: Direction from which it turns on the spot [rad].
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        vehicle: Vehicle = TURTLEBOT2,
        gap: NonNegative = 0.02,
        window: Positive = 1.0,
        valley: Annotated[int, Ge(1), Le(SECTORS)] = 10,
        to_target: NonNegative = 5.0,
        to_heading: NonNegative = 2.0,
        to_previous: NonNegative = 2.0,
        gain: Positive = 3.0,
        braking: Positive = 0.5,
        spin: Positive = 1.0,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, vehicle, **kwargs)
        self.room, self.window, self.valley = self.radius + gap, window, valley
        self.gain, self.braking, self.spin = gain, braking, spin
        self._costs = _Costs(to_target, to_heading, to_previous)

    def plan(self, view: LocalView) -> np.ndarray:
        free = np.full((len(view.points), SECTORS), math.inf)
        _measure(view.points, self.room, free)
        direction = self._directions(free, view)
        v = np.minimum(np.sqrt(2.0 * self.braking * free[:, SECTORS // 2]), self.max_speed)
        v *= np.clip(1.0 - np.abs(direction) / self.spin, 0.0, 1.0)
        return np.column_stack([v, np.clip(self.gain * direction, -self.turn_rate, self.turn_rate)])

    def _directions(self, free: np.ndarray, view: LocalView) -> np.ndarray:
        """Directions to take [rad], shape (num_envs,), by free distances [m], shape (num_envs, SECTORS)."""
        away = np.hypot(*view.target.T) - self.room
        is_open = free >= np.clip(away, _LEAST, max(self.window, _LEAST))[:, None]
        on_the_spot = (np.abs(view.speed) < STANDING) & (np.abs(view.turn) > TURNING)
        side = np.where(on_the_spot, np.sign(view.turn), 0.0)
        target, directions = np.arctan2(view.target[:, 1], view.target[:, 0]), np.empty(len(free))
        _choose(is_open, self.valley, target, view.turn / self.gain, side, self._costs, directions)
        return directions


@njit(cache=True, **UNCOUNTED)
def _measure(points, room, free):
    """Shorten free distances [m], shape (num_envs, SECTORS), to where a circle touches points (num_envs, beams, 2).

    `room` is the circle's radius [m]; a point within it blocks all directions towards it.
    """
    for robot in range(points.shape[0]):
        for beam in range(points.shape[1]):
            x, y = points[robot, beam, 0], points[robot, beam, 1]
            far, bearing = math.hypot(x, y), math.atan2(y, x)
            aside = math.asin(room / far) if far > room else math.pi / 2.0
            for sector in range(math.ceil((bearing - aside) / _WIDTH), math.floor((bearing + aside) / _WIDTH) + 1):
                off = sector * _WIDTH - bearing
                before = math.sqrt(max(room**2 - (far * math.sin(off)) ** 2, 0.0))
                distance = max(far * math.cos(off) - before, 0.0) if far > room else 0.0
                column = (sector + SECTORS // 2) % SECTORS
                free[robot, column] = min(free[robot, column], distance)


@njit(cache=True, **UNCOUNTED)
def _choose(is_open, valley, targets, previous, sides, costs, directions):
    """Write the cheapest candidate of each robot into `directions` [rad]; without one, a turn on the spot.

    Args:
        is_open: Shape (num_envs, SECTORS).
        valley: Sectors of a wide valley.
        targets, previous: Directions of the target, and the previous ones [rad], shape (num_envs,).
        sides: 1 or -1: only candidates to the left or right; 0: all; shape (num_envs,).
    """
    for robot in range(is_open.shape[0]):
        target, best = targets[robot], math.inf
        directions[robot] = math.copysign(math.pi / 2.0, sides[robot] if sides[robot] else target)
        for sector in range(SECTORS):
            direction = (sector - SECTORS // 2) * _WIDTH
            if _between(direction, target) <= _WIDTH / 2.0:
                direction = target
            if not _is_candidate(is_open[robot], sector, valley) or sides[robot] * direction < -_ASIDE:
                continue
            cost = costs.target * _between(direction, target) + costs.heading * abs(direction)
            cost += costs.previous * _between(direction, previous[robot])
            if cost < best:
                best, directions[robot] = cost, direction


@njit(cache=True, **UNCOUNTED)
def _is_candidate(is_open, sector, valley):
    """Whether a sector lies far enough within a wide valley, or in the middle of a narrow one."""
    right = left = 0
    while right < valley and is_open[(sector - right - 1) % SECTORS]:
        right += 1
    while left < valley and is_open[(sector + left + 1) % SECTORS]:
        left += 1
    return is_open[sector] and min(left, right) >= min(valley // 2, (left + right) // 2)


@njit(cache=True, **UNCOUNTED)
def _between(one, other):
    """The angle between two directions [rad], from 0 to pi."""
    return abs((one - other + math.pi) % math.tau - math.pi)
