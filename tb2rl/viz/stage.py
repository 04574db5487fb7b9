"""A world and a robot to look at, not to drive: what is filmed or shown in the window stays undisturbed.

This module imports neither torch nor Stable-Baselines3, so that the window's process starts within a second.
"""

from __future__ import annotations

import math
import signal
from contextlib import closing, suppress
from multiprocessing.connection import Connection

import numpy as np

from tb2rl.rendering.above import GOAL_RADIUS
from tb2rl.simulation import SimulationSpec
from tb2rl.simulation.bullet.bodies import RobotBody, add_floor, add_robot, add_walls, connect
from tb2rl.simulation.bullet.camera import take_picture
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import MoverBodies
from tb2rl.viz.floor import EYE, FIELD_OF_VIEW, TARGET, draw_floor

_REACH = (0.05, 30.0)  # [m] nearest and farthest that the chase camera sees
_GOAL_COLOUR = (0.42, 0.75, 0.29, 1.0)


class Stage:
    """One world at a time, the robot, what moves, and a disc on the floor for the goal.

    Args:
        spec: The robot and the worlds.
        window: Open PyBullet's window; without it, `chase` takes the pictures.

    Raises:
        InputError: If there is no display for a window.
    """

    def __init__(self, spec: SimulationSpec, window: bool = False) -> None:
        self._worlds, self._shown = spec.worlds, 0
        self._goal, self._disc = np.full(2, np.nan), -1
        with quiet():
            self._client = connect(window)
            floor = add_floor(self._client)
            self._walls = add_walls(self._client, self._worlds[0])
            self._robot = add_robot(self._client, spec.robot)
            self._dynamic_obstacles = MoverBodies(self._client)
        self._shell = -1
        if window:
            self._shell = _coloured_shell(self._client, self._robot)
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)
            self._look_at_all(spec.worlds[0].bounds)
        else:  # the renderer spends most of its time on a floor; `draw_floor` takes a tenth of it
            pybullet.changeVisualShape(floor, -1, rgbaColor=(0.0, 0.0, 0.0, 0.0), physicsClientId=self._client)

    @property
    def is_open(self) -> bool:
        """Whether PyBullet is still there: the user may have closed the window."""
        return bool(pybullet.isConnected(self._client))

    def begin(self, world: int, goal: np.ndarray) -> None:
        """Show the world with this index, and a disc at a goal x, y [m], shape (2,); NaN: no goal."""
        if world != self._shown:
            for body in self._walls:
                pybullet.removeBody(body, self._client)
            self._walls, self._shown = add_walls(self._client, self._worlds[world]), world
        if not np.array_equal(goal, self._goal, equal_nan=True):
            if self._disc >= 0:
                pybullet.removeBody(self._disc, self._client)
            self._goal, self._disc = goal, -1 if np.isnan(goal).any() else self._add_disc(goal)

    def place(self, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> None:
        """Put the robot at a pose (3,), and movers where their outlines are, see `RobotState.dynamic_obstacles`,
        (movers, 6).
        """
        self._robot.place(pose)
        if self._shell >= 0:
            x, y, yaw = map(float, pose)
            turned = pybullet.getQuaternionFromEuler((0.0, 0.0, yaw))
            pybullet.resetBasePositionAndOrientation(self._shell, (x, y, 0.0), turned, self._client)
        self._dynamic_obstacles.place(np.empty((0, 6)) if dynamic_obstacles is None else dynamic_obstacles)

    def follow(self) -> None:
        """Turn the window's view to look over the robot's shoulder."""
        x, y, yaw = self._robot.pose()
        distance = math.dist(EYE, TARGET)
        slope = math.degrees(math.asin((TARGET[2] - EYE[2]) / distance))
        target = (x + TARGET[0] * math.cos(yaw), y + TARGET[0] * math.sin(yaw), TARGET[2])
        pybullet.resetDebugVisualizerCamera(
            distance, math.degrees(yaw) - 90.0, slope, target, physicsClientId=self._client
        )

    def chase(self, width: int, height: int) -> np.ndarray:
        """The robot and what lies ahead of it, from behind and above, shape (height, width, 3), uint8."""
        x, y, yaw = pose = self._robot.pose()
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])
        here = np.array([x, y, 0.0])
        camera, target = here + turn @ EYE, here + turn @ TARGET
        colours, depth = take_picture(self._client, camera, target, FIELD_OF_VIEW, _REACH, width, height)
        return np.where(np.isfinite(depth)[..., None], colours, draw_floor(pose, width, height))

    def close(self) -> None:
        """End PyBullet."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def _look_at_all(self, bounds: tuple[float, float, float, float]) -> None:
        x0, y0, x1, y1 = bounds
        middle, distance = ((x0 + x1) / 2, (y0 + y1) / 2, 0.0), 0.8 * max(x1 - x0, y1 - y0)
        pybullet.resetDebugVisualizerCamera(distance, 0.0, -60.0, middle, physicsClientId=self._client)

    def _add_disc(self, goal: np.ndarray) -> int:
        disc = pybullet.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=GOAL_RADIUS,
            length=0.01,
            rgbaColor=_GOAL_COLOUR,
            physicsClientId=self._client,
        )
        return pybullet.createMultiBody(
            0.0, baseVisualShapeIndex=disc, basePosition=(*goal, 0.005), physicsClientId=self._client
        )


def _coloured_shell(client: int, robot: RobotBody) -> int:
    """A body that looks like the robot, with a link for each visual shape, and hides the robot itself.

    PyBullet's window gives all shapes of a link one colour, that of the last one; a robot's fixed links are merged.
    -1: the robot has shapes of other kinds, such as meshes, and shows itself.
    """
    robot.place(np.zeros(3))
    shapes, places, turns = [], [], []
    for _, link, kind, sizes, _, place, turn, colour, *_ in pybullet.getVisualShapeData(
        robot.body, physicsClientId=client
    ):
        sides = {
            pybullet.GEOM_BOX: {"halfExtents": [side / 2 for side in sizes]},
            pybullet.GEOM_CYLINDER: {"length": sizes[0], "radius": sizes[1]},
            pybullet.GEOM_SPHERE: {"radius": sizes[0]},
        }
        if kind not in sides:
            return -1
        if link >= 0:
            frame = pybullet.getLinkState(robot.body, link, physicsClientId=client)[4:6]
            place, turn = pybullet.multiplyTransforms(*frame, place, turn)
        shapes.append(pybullet.createVisualShape(kind, rgbaColor=colour, physicsClientId=client, **sides[kind]))
        places.append(place)
        turns.append(turn)
    for link in range(-1, pybullet.getNumJoints(robot.body, client)):
        pybullet.changeVisualShape(robot.body, link, rgbaColor=(0.0, 0.0, 0.0, 0.0), physicsClientId=client)
    count = len(shapes)
    return pybullet.createMultiBody(
        linkMasses=[0.0] * count,
        linkCollisionShapeIndices=[-1] * count,
        linkVisualShapeIndices=shapes,
        linkPositions=places,
        linkOrientations=turns,
        linkInertialFramePositions=[(0.0, 0.0, 0.0)] * count,
        linkInertialFrameOrientations=[(0.0, 0.0, 0.0, 1.0)] * count,
        linkParentIndices=[0] * count,
        linkJointTypes=[pybullet.JOINT_FIXED] * count,
        linkJointAxis=[(0.0, 0.0, 1.0)] * count,
        physicsClientId=client,
    )


def show(connection: Connection, spec: SimulationSpec, follow: bool) -> None:
    """Show a `Stage` in a window: the body of a process of its own, which ends with the window.

    PyBullet ends its whole process where a window cannot be opened, and where one is closed.

    Args:
        connection: Sends True once the window is open, then receives what `Stage.begin` and `Stage.place` take, as
            tuples of the world's index, the goal (2,), the pose (3,) and the movers, and None to close the window.
        spec: The robot and the worlds.
        follow: Look over the robot's shoulder instead of at the whole world.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that opened this decides
    with quiet(), suppress(EOFError, OSError, pybullet.error), closing(Stage(spec, window=True)) as stage:
        connection.send(True)
        shown = connection.recv()
        while shown is not None and stage.is_open:
            world, goal, pose, dynamic_obstacles = shown
            stage.begin(world, goal)
            stage.place(pose, dynamic_obstacles)
            if follow:
                stage.follow()
            shown = connection.recv()
            while connection.poll() and shown is not None:  # the window may be slower than what it shows
                shown = connection.recv()
