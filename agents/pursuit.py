"""Pure pursuit of a planned path: the arc to the lookahead point (Coulter 1992).

R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01. The path is the
task's. Speeds near obstacles are those of regulated pure pursuit (Macenski et al. 2023).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import TURTLEBOT2, LocalPlanner, LocalView, free_distance, rotation_side
from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.pursuit:Pursuit", observation="raw", only=True)

_BEND = 0.25  # [1/m] between the arcs that are tried
_FAR = 1.0  # [m] farther obstacles along the arc do not matter


class Pursuit(LocalPlanner):
    """Drives along the arc to the target, slowly on sharp arcs and towards obstacles.

    Coulter's follower ignores obstacles, but the arc to a waypoint behind a corner may hit that corner. So it takes the
    arc most like Coulter's that is free for the distance `look`; with `bends=0` only Coulter's.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        behind: Bearing from which it turns on the spot to a target [rad].
        braking: Assumed deceleration [m/s^2].
        look: Free distance that an arc should have [m].
        bends: Number of arcs to try on either side, each of 0.25 / m more curvature.
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

    def plan(self, view: LocalView) -> np.ndarray:
        (x, y), sides = view.target.T, np.empty(len(view.target))
        _rotation_sides(view.points, view.target, view.speed, view.turn, self.radius, self.gap, sides)
        v, w = self._along_arcs(view.points, x, y)
        bearing = np.arctan2(y, x)
        on_the_spot = [sides != 0.0, np.abs(bearing) > self.behind]
        v = np.select(on_the_spot, [0.0, 0.0], v)
        w = np.select(on_the_spot, [sides * self.turn_rate, self.gain * bearing], w)
        return np.column_stack([v, np.clip(w, -self.turn_rate, self.turn_rate)])

    def _along_arcs(self, points: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The speeds v [m/s] and w [rad/s] along free arcs to targets x, y that let it stop before obstacles."""
        square, free = np.maximum(x**2 + y**2, 1e-6), np.empty(len(x))
        curvature, look = 2.0 * y / square, np.minimum(np.sqrt(square), self.look)
        _bend_arcs(points, look, self.bends, self.radius, self.gap, curvature, free)
        late = self.braking * self.period  # it begins to brake a period later
        v = np.sqrt(late**2 + 2.0 * self.braking * free) - late
        v = np.minimum(v, self.turn_rate / np.maximum(np.abs(curvature), 1e-6))
        v = np.minimum(v, self.max_speed)
        return v, v * curvature


@njit(cache=True, **UNCOUNTED)
def _bend_arcs(points, look, bends, radius, gap, curvatures, free):
    """Bend arcs until they are free.

    Args:
        points: See `LocalView`.
        look: Free distances that they should have [m], shape (num_envs,).
        bends, radius, gap: See `Pursuit`.
        curvatures: Of the arcs to the targets [1/m], shape (num_envs,); changed in place.
        free: Output: free distances of the arcs [m], shape (num_envs,).
    """
    for robot in range(points.shape[0]):
        wanted, free[robot] = curvatures[robot], -1.0
        for step in range(2 * bends + 1):
            bend = (step + 1) // 2 * _BEND
            curvature = wanted + (bend if step % 2 else -bend)
            distance = free_distance(points[robot], curvature, radius, gap, _FAR)
            if distance > free[robot]:
                curvatures[robot], free[robot] = curvature, distance
            if distance >= look[robot]:
                break


@njit(cache=True, **UNCOUNTED)
def _rotation_sides(points, targets, speeds, turns, radius, gap, sides):
    """Write `rotation_side` of each robot into `sides`."""
    for robot in range(points.shape[0]):
        sides[robot] = rotation_side(points[robot], targets[robot], speeds[robot], turns[robot], radius, gap)
