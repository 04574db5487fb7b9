"""Pure pursuit of a planned path: the arc to the lookahead point (Coulter 1992).

R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01. The task plans the path.
The speed near obstacles follows regulated pure pursuit (Macenski et al. 2023).
"""

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import TURTLEBOT2, LocalPlanner, LocalView, free_distance, rotation_side
from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.pursuit:Pursuit", fixed_obs_mode=True)

_CURVATURE_STEP = 0.25  # [1/m] curvature difference of neighbouring candidate arcs
_MAX_DISTANCE = 1.0  # [m] obstacles farther from the robot are ignored


class Pursuit(LocalPlanner):
    """Drives along the arc to the target, slowly on sharp arcs and towards obstacles.

    Coulter's algorithm ignores obstacles, but the arc to a waypoint behind a corner may hit that corner. This planner
    selects, among arcs of similar curvature that are free for the distance `look`, the arc nearest to Coulter's; if
    there is none, the freest arc. `bends=0` always selects Coulter's arc.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        behind: Bearing of the target, to either side, above which the robot turns on the spot [rad].
        braking: Assumed deceleration [m/s^2].
        look: Free distance that an arc should have [m]; shrinks to the distance of a nearer target.
        bends: Number of candidate arcs on either side of Coulter's, in curvature steps of 0.25 / m.
        gain: Turn rate on the spot per radian of bearing [1/s].
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
        (x, y), sides, free = view.target.T, np.empty(len(view.target)), np.empty(len(view.target))
        square = np.maximum(x**2 + y**2, 1e-6)
        curvature, look = 2.0 * y / square, np.minimum(np.sqrt(square), self.look)
        _choose_arcs(view, look, self.bends, self.vehicle.radius, self.gap, curvature, free, sides)
        drop = self.braking * self.vehicle.period  # [m/s] lost by braking for a period
        v = np.sqrt(drop**2 + 2.0 * self.braking * free) - drop  # stops within `free`; braking begins a period late
        v = np.minimum(v, self.vehicle.max_turn_rate / np.maximum(np.abs(curvature), 1e-6))
        v = np.minimum(v, self.vehicle.max_speed)
        bearing = np.arctan2(y, x)
        on_the_spot = [sides != 0.0, np.abs(bearing) > self.behind]
        w = np.select(on_the_spot, [sides * self.vehicle.max_turn_rate, self.gain * bearing], v * curvature)
        v = np.select(on_the_spot, [0.0, 0.0], v)
        return np.column_stack([v, w])


@njit(cache=True, **NO_REFCOUNT)
def _choose_arcs(view, look, bends, radius, gap, curvatures, free, sides):
    """Change each arc to the nearest one that is free as far as required, else to the freest; also find `sides`.

    Args:
        view: `LocalView`.
        look: Required free distances [m], shape (num_envs,).
        bends, radius, gap: See `Pursuit`.
        curvatures: Curvatures of the arcs to the targets [1/m], shape (num_envs,); changed in place.
        free: Output: free distances of the changed arcs [m], shape (num_envs,).
        sides: Output: `rotation_side` of each robot, shape (num_envs,).
    """
    for robot in range(free.shape[0]):
        sides[robot] = rotation_side(view, robot, radius, gap)
        target_curvature, free[robot] = curvatures[robot], -1.0
        for step in range(2 * bends + 1):
            change = (step + 1) // 2 * _CURVATURE_STEP
            curvature = target_curvature + (change if step % 2 else -change)
            distance = free_distance(view.points[robot], curvature, radius, gap, _MAX_DISTANCE)
            if distance > free[robot]:
                curvatures[robot], free[robot] = curvature, distance
            if distance >= look[robot]:
                break
