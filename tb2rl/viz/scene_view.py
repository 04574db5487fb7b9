"""A world and a robot in PyBullet, for display only: nothing moves unless it is placed.

This module imports neither torch nor Stable-Baselines3, so that the window's process starts within a second.
"""

from __future__ import annotations

import math
import signal
from contextlib import closing, suppress
from functools import lru_cache
from multiprocessing.connection import Connection

import numpy as np

from tb2rl.rendering.above import GOAL_RADIUS
from tb2rl.simulation import SimulationSpec
from tb2rl.simulation.bullet.bodies import RobotBody, add_floor, add_robot, add_walls, connect
from tb2rl.simulation.bullet.camera import take_picture
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import ObstacleBodies

_CAMERA, _TARGET = (-1.4, 0.0, 1.3), (0.5, 0.0, 0.1)  # [m] of the chase camera, in the robot's frame
_FIELD_OF_VIEW = math.radians(55.0)  # [rad] vertical
_FLOOR_COLOUR = np.array((244, 241, 234), dtype=np.float32)
_SKY_COLOUR = (255, 255, 255)
_TILE_CONTRAST = 34.0  # of 255
_CLIPPING = (0.05, 30.0)  # [m] nearest and farthest depth of the chase camera
_GOAL_COLOUR = (0.42, 0.75, 0.29, 1.0)
_INVISIBLE = (0.0, 0.0, 0.0, 0.0)


class SceneView:
    """One world at a time, the robot, the dynamic obstacles, and a disc on the floor for the goal.

    Args:
        spec: The robot and the worlds.
        window: Open PyBullet's window; without it, `chase_picture` renders.

    Raises:
        InputError: If there is no display for a window.
    """

    def __init__(self, spec: SimulationSpec, window: bool = False) -> None:
        self._worlds, self._world = spec.worlds, 0
        self._goal, self._disc = np.full(2, np.nan), -1
        with quiet():
            self._client = connect(window)
            floor = add_floor(self._client)
            self._walls = add_walls(self._client, self._worlds[0])
            self._robot = add_robot(self._client, spec.robot)
            self._dynamic_obstacles = ObstacleBodies(self._client)
        self._coloured_robot = -1
        if window:
            self._coloured_robot = _add_coloured_robot(self._client, self._robot)
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)
            x0, y0, x1, y1 = spec.worlds[0].bounds
            centre, distance = ((x0 + x1) / 2, (y0 + y1) / 2, 0.0), 0.8 * max(x1 - x0, y1 - y0)
            pybullet.resetDebugVisualizerCamera(distance, 0.0, -60.0, centre, physicsClientId=self._client)
        else:  # because rendering the floor takes most of the time; `draw_floor` needs a tenth of it
            pybullet.changeVisualShape(floor, -1, rgbaColor=_INVISIBLE, physicsClientId=self._client)

    @property
    def is_open(self) -> bool:
        """False once the user has closed the window."""
        return bool(pybullet.isConnected(self._client))

    def show_world(self, index: int, goal: np.ndarray) -> None:
        """Show a world, and a disc at a goal x, y [m], shape (2,); NaN: no goal."""
        if index != self._world:
            for body in self._walls:
                pybullet.removeBody(body, self._client)
            self._walls, self._world = add_walls(self._client, self._worlds[index]), index
        if not np.array_equal(goal, self._goal, equal_nan=True):
            if self._disc >= 0:
                pybullet.removeBody(self._disc, self._client)
            self._goal, self._disc = goal, -1 if np.isnan(goal).any() else self._add_disc(goal)

    def place(self, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> None:
        """Place the robot at a pose (3,), and dynamic obstacles by their outlines (obstacles, 6)."""
        self._robot.place(pose)
        if self._coloured_robot >= 0:
            x, y, yaw = map(float, pose)
            orientation = pybullet.getQuaternionFromEuler((0.0, 0.0, yaw))
            pybullet.resetBasePositionAndOrientation(self._coloured_robot, (x, y, 0.0), orientation, self._client)
        self._dynamic_obstacles.place(np.empty((0, 6)) if dynamic_obstacles is None else dynamic_obstacles)

    def follow(self) -> None:
        """Turn the window's camera to look over the robot's shoulder."""
        x, y, yaw = self._robot.pose()
        distance = math.dist(_CAMERA, _TARGET)
        pitch = math.degrees(math.asin((_TARGET[2] - _CAMERA[2]) / distance))
        target = x + _TARGET[0] * math.cos(yaw), y + _TARGET[0] * math.sin(yaw), _TARGET[2]
        heading = math.degrees(yaw) - 90.0
        pybullet.resetDebugVisualizerCamera(distance, heading, pitch, target, physicsClientId=self._client)

    def chase_picture(self, width: int, height: int) -> np.ndarray:
        """The view over the robot's shoulder, shape (height, width, 3), uint8."""
        x, y, yaw = pose = self._robot.pose()
        cos, sin = math.cos(yaw), math.sin(yaw)
        rotation = np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])
        position, target = (np.array([x, y, 0.0]) + rotation @ point for point in (_CAMERA, _TARGET))
        colours, depth = take_picture(self._client, position, target, _FIELD_OF_VIEW, _CLIPPING, width, height)
        return np.where(np.isfinite(depth)[..., None], colours, draw_floor(pose, width, height))

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def _add_disc(self, goal: np.ndarray) -> int:
        looks = {"radius": GOAL_RADIUS, "length": 0.01, "rgbaColor": _GOAL_COLOUR}
        disc = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, **looks, physicsClientId=self._client)
        place = {"baseVisualShapeIndex": disc, "basePosition": (*goal, 0.005)}
        return pybullet.createMultiBody(0.0, **place, physicsClientId=self._client)


def _add_coloured_robot(client: int, robot: RobotBody) -> int:
    """Add a body with one link for each visual shape of the robot, and hide the robot.

    PyBullet's window gives all shapes of a link the colour of the last one, and the robot's fixed links are merged.

    Returns:
        The body; -1 if the robot has other shapes, such as meshes. Then the robot itself stays visible.
    """
    robot.place(np.zeros(3))
    shapes, positions, orientations = [], [], []
    for _, link, kind, sizes, _, position, orientation, colour, *_ in pybullet.getVisualShapeData(
        robot.body, physicsClientId=client
    ):
        dimensions = {
            pybullet.GEOM_BOX: {"halfExtents": [side / 2 for side in sizes]},
            pybullet.GEOM_CYLINDER: {"length": sizes[0], "radius": sizes[1]},
            pybullet.GEOM_SPHERE: {"radius": sizes[0]},
        }
        if kind not in dimensions:
            return -1
        if link >= 0:
            frame = pybullet.getLinkState(robot.body, link, physicsClientId=client)[4:6]
            position, orientation = pybullet.multiplyTransforms(*frame, position, orientation)
        shapes.append(pybullet.createVisualShape(kind, rgbaColor=colour, physicsClientId=client, **dimensions[kind]))
        positions.append(position)
        orientations.append(orientation)
    for link in range(-1, pybullet.getNumJoints(robot.body, client)):
        pybullet.changeVisualShape(robot.body, link, rgbaColor=_INVISIBLE, physicsClientId=client)
    count = len(shapes)
    return pybullet.createMultiBody(
        linkMasses=[0.0] * count,
        linkCollisionShapeIndices=[-1] * count,
        linkVisualShapeIndices=shapes,
        linkPositions=positions,
        linkOrientations=orientations,
        linkInertialFramePositions=[(0.0, 0.0, 0.0)] * count,
        linkInertialFrameOrientations=[(0.0, 0.0, 0.0, 1.0)] * count,
        linkParentIndices=[0] * count,
        linkJointTypes=[pybullet.JOINT_FIXED] * count,
        linkJointAxis=[(0.0, 0.0, 1.0)] * count,
        physicsClientId=client,
    )


def draw_floor(pose: tuple[float, float, float], width: int, height: int) -> np.ndarray:
    """The tiled floor and the sky behind the robot at a pose (x [m], y [m], yaw [rad]), shape (height, width, 3)."""
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    ahead, left, contrast, sky = _visible_floor(width, height)
    world_x, world_y = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    dark = (np.floor(world_x) + np.floor(world_y)) % 2 * contrast
    colours = (_FLOOR_COLOUR - dark[..., None] * _TILE_CONTRAST).astype(np.uint8)
    colours[:sky] = _SKY_COLOUR
    return colours


@lru_cache(maxsize=4)
def _visible_floor(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Floor points of the camera's pixels in the robot's frame.

    Returns:
        Metres ahead, metres to the left and contrast of the tiles, each of shape (height, width), float32; the number
        of rows above the horizon.
    """
    position, target = np.array(_CAMERA), np.array(_TARGET)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.array([0.0, -1.0, 0.0])
    up = np.cross(right, forward)
    half_height = math.tan(_FIELD_OF_VIEW / 2)
    across = (np.arange(width) + 0.5 - width / 2) * 2 * half_height / height
    upward = (height / 2 - np.arange(height) - 0.5) * 2 * half_height / height
    rays = forward + upward[:, None, None] * up + across[None, :, None] * right
    sky = int((rays[:, 0, 2] > -1e-3).sum())
    distance = position[2] / np.maximum(-rays[..., 2], 1e-3)
    ahead, left = position[0] + distance * rays[..., 0], distance * rays[..., 1]
    contrast = 1.0 / (1.0 + (distance / 5.0) ** 2)  # because distant tiles are smaller than a pixel and would flicker
    return ahead.astype(np.float32), left.astype(np.float32), contrast.astype(np.float32), sky


def run_window(connection: Connection, spec: SimulationSpec, follow: bool) -> None:
    """Show a `SceneView` in a window: the main function of the window's process.

    PyBullet ends its whole process if a window cannot be opened, and when a window is closed.

    Args:
        connection: Sends True once the window is open. Receives tuples of the world's index, the goal (2,), the pose
            (3,) and the outlines of dynamic obstacles, and None to close the window.
        spec: The robot and the worlds.
        follow: Look over the robot's shoulder instead of at the whole world.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # because Ctrl-C reaches every process; the parent decides
    with quiet(), suppress(EOFError, OSError, pybullet.error), closing(SceneView(spec, window=True)) as view:
        connection.send(True)
        message = connection.recv()
        while message is not None and view.is_open:
            world, goal, pose, dynamic_obstacles = message
            view.show_world(world, goal)
            view.place(pose, dynamic_obstacles)
            if follow:
                view.follow()
            message = connection.recv()
            while connection.poll() and message is not None:  # skip poses, because the window may be slower
                message = connection.recv()
