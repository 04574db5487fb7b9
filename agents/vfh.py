"""VFH+, the vector field histogram that allows for the width of the robot (Ulrich & Borenstein 1998).

I. Ulrich and J. Borenstein, "VFH+: reliable obstacle avoidance for fast mobile robots".
"""

import math
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import STANDING_SPEED, TURNING_RATE, TURTLEBOT2, LocalPlanner, LocalView
from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.vfh:VFH", fixed_obs_mode=True)

NUM_SECTORS = 72  # number of sectors of the histogram, over 360 degrees; sector 0 points backwards
_SECTOR_WIDTH = math.tau / NUM_SECTORS  # [rad]
_MIN_WINDOW = 0.05  # [m] the window never becomes shorter, however near the target is
_SIDE_TOLERANCE = math.radians(10.0)  # a turning robot may still choose a direction this far to the other side


class VFH(LocalPlanner):
    """Turns to the best open direction, and drives as fast as the free distance ahead allows.

    The histogram holds how far the whole width of the robot can drive in each direction. A direction is open if
    this distance is at least `window`. The original VFH+ applies a threshold to a grid of past scans instead.
    Directions without a scan are open. A valley is a range of open directions. Candidates are at least half of
    `valley` from the edges of a wide valley, or in the middle of a narrow one; the direction of the target replaces
    that of its sector. A robot that turns on the spot keeps turning to the same side. Otherwise it could turn to and
    fro, because it does not see behind. The previous direction is estimated from the turn rate, because the planner
    has no memory.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        window: Free distance that makes a direction open [m]; shrinks to the distance of a nearer target.
        valley: Least width of a wide valley [sectors of 5 degrees].
        to_target: Cost per radian of difference to the target's direction. It should exceed the sum of the other two
            costs, or the robot may never arrive.
        to_heading: Cost per radian of difference to straight ahead.
        to_previous: Cost per radian of difference to the previous direction.
        gain: Turn rate per radian of direction [1/s].
        braking: Assumed deceleration [m/s^2].
        spin: Angle between the chosen direction and straight ahead above which the robot turns on the spot [rad].
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        vehicle: Vehicle = TURTLEBOT2,
        gap: NonNegative = 0.02,
        window: Positive = 1.0,
        valley: Annotated[int, Ge(1), Le(NUM_SECTORS)] = 10,
        to_target: NonNegative = 5.0,
        to_heading: NonNegative = 2.0,
        to_previous: NonNegative = 2.0,
        gain: Positive = 3.0,
        braking: Positive = 0.5,
        spin: Positive = 1.0,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, vehicle, **kwargs)
        self.inflated_radius, self.window, self.valley = vehicle.radius + gap, window, valley
        self.gain, self.braking, self.spin = gain, braking, spin
        self._costs = to_target, to_heading, to_previous

    def plan(self, view: LocalView) -> np.ndarray:
        free, direction = np.full((len(view.points), NUM_SECTORS), math.inf), np.empty(len(view.points))
        _shorten_free_distances(free, view.points, self.inflated_radius)
        target_distance = np.hypot(*view.target.T) - self.inflated_radius
        is_open = free >= np.clip(target_distance, _MIN_WINDOW, max(self.window, _MIN_WINDOW))[:, None]
        on_the_spot = (np.abs(view.speed) < STANDING_SPEED) & (np.abs(view.turn_rate) > TURNING_RATE)
        side = np.where(on_the_spot, np.sign(view.turn_rate), 0.0)
        bearing = np.arctan2(view.target[:, 1], view.target[:, 0])
        _choose_directions(is_open, self.valley, bearing, view.turn_rate / self.gain, side, self._costs, direction)
        v = np.minimum(np.sqrt(2.0 * self.braking * free[:, NUM_SECTORS // 2]), self.vehicle.max_speed)
        v *= np.clip(1.0 - np.abs(direction) / self.spin, 0.0, 1.0)
        return np.column_stack([v, self.gain * direction])


@njit(cache=True, **NO_REFCOUNT)
def _shorten_free_distances(free, points, radius):
    """Shorten the free distances to where a disc would touch a point.

    Args:
        free: Free distances [m], shape (num_envs, NUM_SECTORS); changed in place.
        points: See `LocalView`.
        radius: Radius of the disc [m]; a point inside the disc blocks all directions up to 90 degrees from it.
    """
    for robot in range(points.shape[0]):
        for beam in range(points.shape[1]):
            x, y = points[robot, beam, 0], points[robot, beam, 1]
            distance, bearing = math.hypot(x, y), math.atan2(y, x)
            half_angle = math.asin(radius / distance) if distance > radius else math.pi / 2.0
            first_step = math.ceil((bearing - half_angle) / _SECTOR_WIDTH)  # counted from straight ahead
            for step in range(first_step, math.floor((bearing + half_angle) / _SECTOR_WIDTH) + 1):
                angle = step * _SECTOR_WIDTH - bearing
                half_chord = math.sqrt(max(radius**2 - (distance * math.sin(angle)) ** 2, 0.0))
                contact = max(distance * math.cos(angle) - half_chord, 0.0) if distance > radius else 0.0
                sector = (step + NUM_SECTORS // 2) % NUM_SECTORS
                free[robot, sector] = min(free[robot, sector], contact)


@njit(cache=True, **NO_REFCOUNT)
def _choose_directions(is_open, valley, bearings, previous, sides, costs, directions):
    """Write the cheapest candidate of each robot into `directions` [rad]; without candidates 90 degrees to one side.

    Args:
        is_open: Shape (num_envs, NUM_SECTORS).
        valley: Least width of a wide valley [sectors].
        bearings: Directions of the targets [rad], shape (num_envs,).
        previous: Previous directions [rad], shape (num_envs,).
        sides: Allowed candidates, shape (num_envs,): 1 on the left, -1 on the right, 0 on both sides.
        costs: Costs per radian to_target, to_heading, to_previous, see `VFH`.
        directions: Output, shape (num_envs,).
    """
    to_target, to_heading, to_previous = costs
    for robot in range(is_open.shape[0]):
        bearing, best = bearings[robot], math.inf
        directions[robot] = math.copysign(math.pi / 2.0, sides[robot] if sides[robot] else bearing)
        for sector in range(NUM_SECTORS):
            direction = (sector - NUM_SECTORS // 2) * _SECTOR_WIDTH
            if _angle_between(direction, bearing) <= _SECTOR_WIDTH / 2.0:
                direction = bearing
            if not _is_candidate(is_open[robot], sector, valley) or sides[robot] * direction < -_SIDE_TOLERANCE:
                continue
            cost = to_target * _angle_between(direction, bearing) + to_heading * abs(direction)
            cost += to_previous * _angle_between(direction, previous[robot])
            if cost < best:
                best, directions[robot] = cost, direction


@njit(cache=True, **NO_REFCOUNT)
def _is_candidate(is_open, sector, valley):
    """Whether a sector is far enough from the edges of a wide valley, or in the middle of a narrow one."""
    right = left = 0
    while right < valley and is_open[(sector - right - 1) % NUM_SECTORS]:
        right += 1
    while left < valley and is_open[(sector + left + 1) % NUM_SECTORS]:
        left += 1
    return is_open[sector] and min(left, right) >= min(valley // 2, (left + right) // 2)


@njit(cache=True, **NO_REFCOUNT)
def _angle_between(first, second):
    """The angle between two directions [rad], from 0 to pi."""
    return abs((first - second + math.pi) % math.tau - math.pi)
