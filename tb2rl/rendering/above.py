"""A robot in its world from above, with its laser beams and its path."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.rendering.canvas import Canvas
from tb2rl.rendering.colours import BEAM, BODY, DYNAMIC_OBSTACLE, GOAL, NOSE, PATH, ROUTE, WHEEL
from tb2rl.robots import Laser, Robot
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.world import box_polygons

GOAL_RADIUS = 0.2  # [m] of a goal's mark
_NOSE = ((150 / 178, 0.0), (50 / 178, 60 / 178), (50 / 178, -60 / 178))  # in the robot's frame, by its radius


class WorldPicture:
    """Pictures of a robot in one world. The static parts are drawn once.

    Args:
        goal: x, y [m]; None or NaN: there is no goal.
    """

    def __init__(
        self, world: World, robot: Robot, laser: Laser, goal: Sequence[float] | np.ndarray | None = None
    ) -> None:
        self._robot, self._laser = robot, laser
        self._empty = Canvas(world)
        draw_goal(self._empty, goal)

    def draw(
        self,
        pose: np.ndarray,
        ranges: np.ndarray,
        path: Sequence[np.ndarray],
        dynamic_obstacles: np.ndarray | None = None,
    ) -> np.ndarray:
        """Draw the robot, its beams, its path and the dynamic obstacles.

        Args:
            pose: x [m], y [m], yaw [rad], shape (3,).
            ranges: Along the laser's beams [m], shape (beams,).
            path: Poses (3,) or points (2,) since the reset.
            dynamic_obstacles: One environment's block of `RobotState.dynamic_obstacles`, shape (obstacles, 6).

        Returns:
            Shape (height, width, 3), uint8.
        """
        canvas = self._empty.copy()
        x, y, yaw = pose
        for angle, distance in zip(self._laser.angles + yaw, ranges, strict=True):
            length = min(distance, self._laser.max_range)
            canvas.line([(x, y), (x + length * math.cos(angle), y + length * math.sin(angle))], BEAM, 0.015)
        if len(path) > 1:
            canvas.line(path, PATH, 0.04)
        if dynamic_obstacles is not None:
            _draw_dynamic_obstacles(canvas, dynamic_obstacles)
        draw_robot(canvas, self._robot, x, y, yaw)
        return canvas.array()


def draw_goal(canvas: Canvas, goal: Sequence[float] | np.ndarray | None) -> None:
    """Draw a ring around a goal x, y [m]; nothing for None or NaN."""
    if goal is not None and np.isfinite(goal).all():
        canvas.disc(goal[0], goal[1], GOAL_RADIUS, None, outline=GOAL)


def draw_routes(canvas: Canvas, groups: Sequence[DynamicObstacles]) -> None:
    """Draw the paths that dynamic obstacles follow."""
    for group in groups:
        if group.path is not None:
            canvas.line(group.route, ROUTE, 0.04)


def draw_robot(canvas: Canvas, robot: Robot, x: float, y: float, yaw: float) -> None:
    cos, sin = math.cos(yaw), math.sin(yaw)

    def at(forward: float, left: float) -> tuple[float, float]:
        return x + forward * cos - left * sin, y + forward * sin + left * cos

    canvas.disc(x, y, robot.radius, BODY)
    for side in (robot.wheel_separation / 2, -robot.wheel_separation / 2):
        canvas.line([at(-robot.wheel_radius, side), at(robot.wheel_radius, side)], WHEEL, 0.03)
    canvas.polygon([at(forward * robot.radius, left * robot.radius) for forward, left in _NOSE], NOSE)


def _draw_dynamic_obstacles(canvas: Canvas, outlines: np.ndarray) -> None:
    for x, y, cos, sin, length, width in outlines.tolist():
        if width > 0.0:
            (box,) = box_polygons(np.array([[x, y, length, width, cos, sin]]))
            canvas.polygon(box.exterior.coords, DYNAMIC_OBSTACLE)
        elif length > 0.0:
            canvas.disc(x, y, length, DYNAMIC_OBSTACLE)
