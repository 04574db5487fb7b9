"""A robot in its world, seen from above, with its beams and its path."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.rendering.canvas import Canvas
from tb2rl.rendering.colours import BEAM, BODY, GOAL, MOVER, NOSE, PATH, ROUTE, WHEEL
from tb2rl.robots import Laser, Robot
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.world import box_polygons

GOAL_RADIUS = 0.2  # [m] of what marks a goal
_NOSE = ((150 / 178, 0.0), (50 / 178, 60 / 178), (50 / 178, -60 / 178))  # in the robot's frame, shares of its radius


class WorldPicture:
    """A world and a robot, to draw many pictures of: what stands still is drawn only once.

    Args:
        world: Its walls.
        robot: Its size and its wheels.
        laser: The directions of its beams.
        goal: x, y [m]; None or NaN: there is none.
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
        """The robot with its beams and its path, and what moves beside it.

        Args:
            pose: x [m], y [m], yaw [rad], shape (3,).
            ranges: Along the laser's beams [m], shape (beams,).
            path: Where it was since the reset, poses (3,) or points (2,).
            dynamic_obstacles: Their outlines, a robot's block of `RobotState.dynamic_obstacles`, shape (movers, 6);
            None: nothing moves.

        Returns:
            Shape (height, width, 3), uint8.
        """
        canvas = self._empty.copy()
        x, y, yaw = pose
        for angle, distance in zip(self._laser.angles + yaw, ranges, strict=True):
            reach = min(distance, self._laser.max_range)
            canvas.line([(x, y), (x + reach * math.cos(angle), y + reach * math.sin(angle))], BEAM, 0.015)
        if len(path) > 1:
            canvas.line(path, PATH, 0.04)
        draw_movers(canvas, dynamic_obstacles)
        draw_robot(canvas, self._robot, x, y, yaw)
        return canvas.array()


def draw_goal(canvas: Canvas, goal: Sequence[float] | np.ndarray | None) -> None:
    """A ring around a goal x, y [m]; nothing for None or NaN."""
    if goal is not None and np.isfinite(goal).all():
        canvas.disc(goal[0], goal[1], GOAL_RADIUS, None, outline=GOAL)


def draw_movers(canvas: Canvas, dynamic_obstacles: np.ndarray | None) -> None:
    """What moves, by outlines (movers, 6) as in `RobotState.dynamic_obstacles`; nothing for None."""
    for row in np.empty((0, 6)) if dynamic_obstacles is None else dynamic_obstacles:
        x, y, cos, sin, length, width = row.tolist()
        if width > 0.0:
            (box,) = box_polygons(np.array([[x, y, length, width, cos, sin]]))
            canvas.polygon(box.exterior.coords, MOVER)
        elif length > 0.0:
            canvas.disc(x, y, length, MOVER)


def draw_routes(canvas: Canvas, groups: Sequence[DynamicObstacles]) -> None:
    """The paths that movers follow, faint."""
    for group in groups:
        if group.path is not None:
            canvas.line(group.route, ROUTE, 0.04)


def draw_robot(canvas: Canvas, robot: Robot, x: float, y: float, yaw: float) -> None:
    """A robot at a pose [m, m, rad]."""
    cos, sin = math.cos(yaw), math.sin(yaw)

    def at(forward: float, left: float) -> tuple[float, float]:
        return x + forward * cos - left * sin, y + forward * sin + left * cos

    canvas.disc(x, y, robot.radius, BODY)
    for side in (robot.wheel_separation / 2, -robot.wheel_separation / 2):
        canvas.line([at(-robot.wheel_radius, side), at(robot.wheel_radius, side)], WHEEL, 0.03)
    canvas.polygon([at(forward * robot.radius, left * robot.radius) for forward, left in _NOSE], NOSE)
