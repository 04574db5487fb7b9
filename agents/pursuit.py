"""A planned way and pure pursuit: the arc that leads to the waypoint (Coulter 1992).

R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01. The way is the task's, by
fast marching as A* finds it on a grid. Speeds by what stands ahead are those of regulated pure pursuit (Macenski et al.
2023).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._guided import TURTLEBOT2, Guided, Seen, free_way, way_out
from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.pursuit:Pursuit", observation="raw", only=True)

_BEND = 0.25  # [1/m] from one arc to the next that is tried
_FAR = 1.0  # [m] what stands farther along the arc does not matter


class Pursuit(Guided):
    """Drives along the arc to the target, slowly where it bends or something stands ahead.

    Coulter's follower knows no obstacles and trusts the way. Here the arc of a waypoint that lies behind a corner may
    lead into that corner. So of all arcs it takes the one most like Coulter's that is free for as far as `look`; with
    `bends=0` only his own.

    Args:
        observation_space: As of `tb2rl.agents._guided.Guided`, as are the next two.
        action_space: See there.
        vehicle: See there.
        gap: To keep to what the laser sees [m].
        behind: It turns on the spot to a target in a direction beyond this [rad].
        braking: How fast it counts on becoming slower [m/s^2].
        look: How far an arc should be free [m].
        bends: How many arcs to either side it tries, each bent by 0.25 / m more.
        gain: Turn rate to a target behind, for each radian [1/s].
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        vehicle: Vehicle = TURTLEBOT2,
        gap: NonNegative = 0.02,
        behind: Positive = 2.0,
        braking: Positive = 0.5,
        look: Positive = 0.6,
        bends: Annotated[int, Ge(0), Le(100)] = 16,
        gain: Positive = 2.0,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, vehicle, **kwargs)
        self.gap, self.behind, self.braking = gap, behind, braking
        self.look, self.bends, self.gain = look, bends, gain

    def drive(self, seen: Seen) -> np.ndarray:
        (x, y), sides = seen.target.T, np.empty(len(seen.target))
        _find_ways_out(seen.points, seen.target, seen.speed, seen.turn, self.radius, self.gap, sides)
        v, w = self._along_arcs(seen.points, x, y)
        bearing = np.arctan2(y, x)
        on_the_spot = [sides != 0.0, np.abs(bearing) > self.behind]
        v = np.select(on_the_spot, [0.0, 0.0], v)
        w = np.select(on_the_spot, [sides * self.turn_rate, self.gain * bearing], w)
        return np.column_stack([v, np.clip(w, -self.turn_rate, self.turn_rate)])

    def _along_arcs(self, points: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The speeds v [m/s] and w [rad/s] along free arcs to targets x, y, so that it stops before what is ahead."""
        square, free = np.maximum(x**2 + y**2, 1e-6), np.empty(len(x))
        curvature, look = 2.0 * y / square, np.minimum(np.sqrt(square), self.look)
        _take_arcs(points, look, self.bends, self.radius, self.gap, curvature, free)
        late = self.braking * self.period  # it begins to brake a period from now
        v = np.sqrt(late**2 + 2.0 * self.braking * free) - late
        v = np.minimum(v, self.turn_rate / np.maximum(np.abs(curvature), 1e-6))
        v = np.minimum(v, self.max_speed)
        return v, v * curvature


@njit(cache=True, **UNCOUNTED)
def _take_arcs(points, look, bends, radius, gap, curvatures, free):
    """Bend arcs until they are free, and say how far they are.

    Args:
        points: See `tb2rl.agents._guided.Seen`.
        look: How far they should be free [m], shape (num_envs,).
        bends, radius, gap: See `Pursuit`.
        curvatures: Of the arcs to the targets [1/m], shape (num_envs,); changed in place.
        free: Written: their free ways [m], shape (num_envs,).
    """
    for robot in range(points.shape[0]):
        wanted, free[robot] = curvatures[robot], -1.0
        for step in range(2 * bends + 1):
            bend = (step + 1) // 2 * _BEND
            curvature = wanted + (bend if step % 2 else -bend)
            way = free_way(points[robot], curvature, radius, gap, _FAR)
            if way > free[robot]:
                curvatures[robot], free[robot] = curvature, way
            if way >= look[robot]:
                break


@njit(cache=True, **UNCOUNTED)
def _find_ways_out(points, targets, speeds, turns, radius, gap, sides):
    """Write to which side each robot turns until it can leave, see `way_out`."""
    for robot in range(points.shape[0]):
        sides[robot] = way_out(points[robot], targets[robot], speeds[robot], turns[robot], radius, gap)
