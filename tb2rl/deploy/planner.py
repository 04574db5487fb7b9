"""A planner on a world that is known, for policies that follow a plan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy.portable.policy_contract import Point, Pose
from tb2rl.envs.worlds import find_worlds
from tb2rl.worlds import World
from tb2rl.worlds.goal_paths import OWN, GoalPaths, shortest_path_length


class WorldPlanner:
    """Knows the shortest way from anywhere in a world to a goal, as task `navigate` does with `map: known`.

    The way to a new goal is found when it is first asked for, which takes from milliseconds to seconds in a large map.

    Args:
        world: The world, or what `task.world` takes: a name, a map of ROS, ...; of several the first.
        radius: Of the robot [m].
        origin: Where the odometry frame is in the world: where the robot was in it when its odometry began.

    Raises:
        InputError: If there is no such world.
    """

    def __init__(self, world: World | Any, radius: float, origin: Pose = (0.0, 0.0, 0.0)) -> None:
        self._world = world if isinstance(world, World) else find_worlds(world)[0]
        self._radius, self.origin = radius, origin
        self._goal: Point | None = None
        self._paths: GoalPaths | None = None  # to that goal; None: there is none

    def lookahead_point(self, pose: Pose, goal: Point, lookahead: float) -> Point | None:
        """See `tb2rl.deploy.Planner`."""
        there = self._in_world((*goal, 0.0))[:2]
        here = self._in_world(pose)
        if there != self._goal:
            self._goal, self._paths = there, self._ways_to(there, here)
        if self._paths is None:
            return None
        only = np.zeros(1, dtype=int)
        return self._in_odometry(self._paths.lookahead_point(only, only + OWN, np.array([here]), lookahead)[0])

    def _ways_to(self, goal: Point, here: Pose) -> GoalPaths | None:
        try:
            world = self._world.with_places(here, (*goal, 0.0))
            found = shortest_path_length(world, self._radius) < math.inf
        except InputError:  # the goal is outside of the world, or inside an obstacle
            return None
        return GoalPaths((world,), self._radius) if found else None

    def _in_world(self, pose: Pose) -> Pose:
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return x + cos * pose[0] - sin * pose[1], y + sin * pose[0] + cos * pose[1], yaw + pose[2]

    def _in_odometry(self, point: np.ndarray) -> Point:
        x, y, yaw = self.origin
        east, north = point[0] - x, point[1] - y
        cos, sin = math.cos(yaw), math.sin(yaw)
        return float(cos * east + sin * north), float(cos * north - sin * east)
