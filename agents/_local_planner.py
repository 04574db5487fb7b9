"""Base class of the classical local planners, and the geometry that they share."""

import math
from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.errors import InputError
from tb2rl.robots.vehicle import Vehicle

STANDING_SPEED = 0.05  # [m/s] slower robots are standing
TURNING_RATE = 0.5  # [rad/s] robots with a larger turn rate are turning
_MAX_STRAIGHT_CURVATURE = 1e-3  # [1/m] arcs of smaller curvature are straight lines
_BLOCKED_DISTANCE = 0.15  # [m] a standing robot with less free distance ahead starts to rotate away from the obstacle
_CLEAR_DISTANCE = 0.5  # [m] free distance ahead that ends the rotation
_DIRECTION_STEP = math.radians(5.0)  # [rad] between the directions that a blocked robot compares
_INPUTS = ("laser", "waypoint", "goal direction", "goal distance", "forward speed", "turn rate")
TURTLEBOT2 = Vehicle()


class LocalView(NamedTuple):
    """The surroundings of each robot in its own frame: x ahead, y to the left."""

    points: np.ndarray  # laser hits, x, y [m], shape (num_envs, beams, 2)
    target: np.ndarray  # x, y [m], shape (num_envs, 2)
    speed: np.ndarray  # forward [m/s], shape (num_envs,)
    turn_rate: np.ndarray  # positive to the left [rad/s], shape (num_envs,)


class LocalPlanner(BasePolicy):
    """Drives to the target of its task, guided by laser and speeds, without a map. Subclasses implement `plan`.

    The target is the waypoint of the plan (`guide: plan`) or the goal (`guide: goal`).

    Args:
        observation_space: `tb2rl.envs.encodings.SensorBox` of task `navigate`.
        action_space: v and w, from -1 to 1; v = -1 is standstill.
        vehicle: The robot.

    Raises:
        InputError: If the laser, the target or the speeds are not observed, the actions are not v and w, or the number
            of beams is below 2 or differs from that of the vehicle's directions.
    """

    def __init__(
        self, observation_space: spaces.Space, action_space: spaces.Space, vehicle: Vehicle, **kwargs: Any
    ) -> None:
        super().__init__(observation_space, action_space, **kwargs)
        names, frames = np.array(getattr(observation_space, "names", ())), getattr(observation_space, "frame_stack", 1)
        self._frame_size = len(names) // frames
        latest = names[len(names) - self._frame_size :]
        self._columns = {name: np.flatnonzero(latest == name) for name in _INPUTS}
        planner, observed = type(self).__name__.lower(), {*latest} & {*_INPUTS}
        has_target = "waypoint" in observed or observed >= {"goal direction", "goal distance"}
        if not (has_target and observed >= {"laser", "forward speed", "turn rate"}):
            needed = "a laser, the robot's speeds and a goal or a waypoint, as in task navigate"
            found = ", ".join(sorted(observed)) or "none of them"
            raise InputError(f"{planner} needs {needed} (task.observe: laser, twist, waypoint), got {found}")
        if not isinstance(action_space, spaces.Box):
            raise InputError(f"{planner} sets speeds, so it needs task.named_actions=false")
        beams, directions = len(self._columns["laser"]), vehicle.directions
        angles = np.linspace(-math.pi / 2, math.pi / 2, beams) if directions is None else np.asarray(directions)
        if beams < 2 or len(angles) != beams:
            raise InputError(f"{planner} needs 2 beams or more, each with a direction, got {beams} and {len(angles)}")
        self._beam_directions = np.column_stack([np.cos(angles), np.sin(angles)])
        self.vehicle = vehicle

    @abstractmethod
    def plan(self, view: LocalView) -> np.ndarray:
        """The speeds v [m/s] and w [rad/s], shape (num_envs, 2); `_predict` limits them to the vehicle's."""

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        v, w = self.plan(self._view(observation.cpu().numpy().astype(float))).T
        actions = np.column_stack([2.0 * v / self.vehicle.max_speed - 1.0, w / self.vehicle.max_turn_rate])
        return th.from_numpy(np.clip(actions, -1.0, 1.0).astype(np.float32))

    def _view(self, observations: np.ndarray) -> LocalView:
        latest = observations[:, -self._frame_size :]
        laser, waypoint, direction, distance, speed, turn_rate = (latest[:, self._columns[name]] for name in _INPUTS)
        target = waypoint if waypoint.size else distance * direction
        return LocalView(laser[..., None] * self._beam_directions, target, speed[:, 0], turn_rate[:, 0])


# ---- geometry of one robot


@njit(cache=True, **NO_REFCOUNT)
def rotation_side(view, robot, radius, gap):
    """The side to which the robot with index `robot` rotates: 1 left, -1 right, 0 if the robot is not blocked.

    This is the rotate-away mode of the dynamic window approach. A turning robot keeps its side. Otherwise it could turn
    to and fro, because the laser does not see behind and the planner has no memory. Arguments: see `free_distance`.
    """
    points, turning = view.points[robot], abs(view.turn_rate[robot]) > TURNING_RATE
    needed = _CLEAR_DISTANCE if turning else _BLOCKED_DISTANCE
    if abs(view.speed[robot]) > STANDING_SPEED or free_distance(points, 0.0, radius, gap, _CLEAR_DISTANCE) >= needed:
        return 0.0
    side = math.copysign(1.0, view.turn_rate[robot] if turning else view.target[robot, 1])
    if not turning:
        for step in range(1, int(math.pi / _DIRECTION_STEP)):
            for candidate in (side, -side):
                if _free_distance_straight(points, candidate * step * _DIRECTION_STEP, radius + gap) >= _CLEAR_DISTANCE:
                    return candidate
    return side


@njit(cache=True, **NO_REFCOUNT)
def free_distance(points, curvature, radius, gap, max_distance):
    """The distance along an arc to the first contact [m]; inf without a contact.

    The obstacle distance of the dynamic window approach (Fox, Burgard & Thrun 1997).

    Args:
        points: Laser hits, shape (beams, 2).
        curvature: Curvature of the arc, positive to the left [1/m].
        radius: Radius of the robot [m].
        gap: Distance to keep from obstacles [m]; for points that are already closer, the gap is 0.
        max_distance: Points farther than max_distance + radius + gap from the robot's centre are ignored [m].
    """
    free = math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        square = x * x + y * y
        if square <= (max_distance + radius + gap) ** 2:
            is_near = square < (radius + gap) ** 2
            free = min(free, _contact_distance(x, y, curvature, radius if is_near else radius + gap))
    return free


@njit(cache=True, **NO_REFCOUNT)
def _free_distance_straight(points, direction, radius):
    """The distance [m] to the first contact of a disc that moves straight in a direction [rad]."""
    cos, sin, free = math.cos(direction), math.sin(direction), math.inf
    for beam in range(points.shape[0]):
        x, y = points[beam, 0], points[beam, 1]
        free = min(free, _contact_distance(cos * x + sin * y, cos * y - sin * x, 0.0, radius))
    return free


@njit(cache=True, **NO_REFCOUNT)
def _contact_distance(x, y, curvature, radius):
    """The distance along an arc until a disc touches the point x, y [m].

    For a point inside the disc: 0 if the point is ahead of the centre, else inf.
    """
    if x * x + y * y <= radius * radius:
        return 0.0 if x > 0.0 else math.inf
    if abs(curvature) < _MAX_STRAIGHT_CURVATURE:
        return x - math.sqrt(radius * radius - y * y) if x > 0.0 and abs(y) < radius else math.inf
    arc_radius = 1.0 / abs(curvature)
    # Seen from the arc's centre (0, 1 / curvature), the point is x ahead and `outward` towards the robot.
    outward = arc_radius - math.copysign(y, y * curvature)
    square = x * x + outward * outward
    if not (arc_radius - radius) ** 2 < square < (arc_radius + radius) ** 2:
        return math.inf
    # Law of cosines: the angle at the arc's centre between the point and the disc's centre at contact.
    contact = math.acos((arc_radius * arc_radius + square - radius * radius) / (2.0 * arc_radius * math.sqrt(square)))
    angle = math.atan2(x, outward) - contact
    return arc_radius * (angle if angle >= 0.0 else angle + math.tau)
