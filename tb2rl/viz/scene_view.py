"""Pictures of a world and a robot in PyBullet, without physics."""

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.rendering.above import GOAL_RADIUS
from tb2rl.robots import Camera
from tb2rl.simulation import SimulationSpec
from tb2rl.simulation.bullet.bodies import add_robot, add_walls, connect, take_picture
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import ObstacleBodies

_CHASE_CAMERA = Camera(position=(-1.4, 0.0, 1.3), field_of_view=math.radians(55.0), range=(0.05, 30.0))
_CHASE_TARGET = (0.5, 0.0, 0.1)  # [m] point in the robot's frame at which the chase camera looks
_FLOOR_COLOUR, _SKY_COLOUR = np.array((244, 241, 234)), (255, 255, 255)  # RGB, from 0 to 255
_TILE_CONTRAST = 34.0  # difference between light and dark tiles, of 255
_GOAL_COLOUR = (0.42, 0.75, 0.29, 1.0)  # RGBA
_HIDDEN_POSITION = (0.0, 0.0, -100.0)  # [m] position of the goal's disc if there is no goal


class SceneView:
    """Shows one world at a time, the robot, the dynamic obstacles, and the goal as a disc on the floor.

    Args:
        spec: The robot and the worlds.
    """

    def __init__(self, spec: SimulationSpec) -> None:
        self._worlds, self._world = spec.worlds, 0
        with quiet():
            self._client = connect()
            self._walls = add_walls(self._client, self._worlds[0])
            self._robot = add_robot(self._client, spec.robot)
            self._dynamic_obstacles = ObstacleBodies(self._client)
            appearance = {"radius": GOAL_RADIUS, "length": 0.01, "rgbaColor": _GOAL_COLOUR}
            disc = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, **appearance, physicsClientId=self._client)
            self._goal = pybullet.createMultiBody(0.0, -1, disc, _HIDDEN_POSITION, physicsClientId=self._client)

    def show(self, world: int, goal: np.ndarray, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> None:
        """Show a world by its index, a goal (2,) unless it is NaN, the robot's pose (3,), outlines (obstacles, 6)."""
        if world != self._world:
            for body in self._walls:
                pybullet.removeBody(body, self._client)
            self._walls, self._world = add_walls(self._client, self._worlds[world]), world
        goal_position = (*goal, 0.005) if np.isfinite(goal).all() else _HIDDEN_POSITION
        pybullet.resetBasePositionAndOrientation(self._goal, goal_position, (0.0, 0.0, 0.0, 1.0), self._client)
        self._robot.place(pose)
        self._dynamic_obstacles.place(np.empty((0, 6)) if dynamic_obstacles is None else dynamic_obstacles)

    def chase_picture(self, width: int, height: int) -> np.ndarray:
        """The picture of the chase camera behind the robot, shape (height, width, 3), uint8."""
        pose = self._robot.pose()
        colours, depth = take_picture(self._client, *_chase_camera_pose(pose), _CHASE_CAMERA, width, height)
        return np.where(np.isfinite(depth)[..., None], colours, draw_floor(pose, width, height))

    def close(self) -> None:
        pybullet.disconnect(self._client)


def _chase_camera_pose(pose: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Position and target x, y, z [m] of the chase camera behind a robot at a pose, each of shape (3,)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    rotation = np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])
    return rotation @ _CHASE_CAMERA.position + (*pose[:2], 0.0), rotation @ _CHASE_TARGET + (*pose[:2], 0.0)


def draw_floor(pose: Sequence[float], width: int, height: int) -> np.ndarray:
    """Draw the tiled floor and the sky that the chase camera of a robot at a pose sees, shape (height, width, 3).

    This is the ray casting of a plane, with one ray for each pixel.
    """
    position, target = _chase_camera_pose(pose)
    forward = (target - position) / math.dist(position, target)
    right = np.array([math.sin(pose[2]), -math.cos(pose[2]), 0.0])
    columns, rows = np.arange(width) - (width - 1) / 2, (height - 1) / 2 - np.arange(height)
    pixel_side = 2 * math.tan(_CHASE_CAMERA.field_of_view / 2) / height  # [m] at a distance of 1 m
    rays = forward + pixel_side * rows[:, None] * np.cross(right, forward)  # of the middle column, shape (height, 3)
    distance = position[2] / np.maximum(-rays[:, 2:], 1e-3)
    x, y = (position[i] + distance * (rays[:, [i]] + pixel_side * columns * right[i]) for i in (0, 1))
    contrast = _TILE_CONTRAST / (1 + (distance / 5) ** 2)  # distant tiles are smaller than a pixel and would flicker
    darkness = (np.floor(x) + np.floor(y)) % 2 * contrast
    colours = (_FLOOR_COLOUR - darkness[..., None]).astype(np.uint8)
    colours[rays[:, 2] > -1e-3] = _SKY_COLOUR
    return colours
