"""The reference physics: a TurtleBot2 driven by its wheels in PyBullet. The only module that imports pybullet.

The direct solver (Dantzig's, for the exact linear complementarity problem) holds the wheel speeds that the usual
iterative one misses, at a fifth of its cost.
"""

from __future__ import annotations

import ctypes
import math
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl import robot
from tb2rl.errors import InputError
from tb2rl.laser import cast_one, limit_ranges
from tb2rl.maze import WALL_HEIGHT, Maze
from tb2rl.simulation import PHYSICS_RATE, Reading


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep from the user what PyBullet's C code prints during the block: its build time, its solver."""
    streams = {1: sys.stdout, 2: sys.stderr}
    kept = {descriptor: os.dup(descriptor) for descriptor in streams}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor, stream in streams.items():
            stream.flush()
            os.dup2(nowhere, descriptor)
        yield
    finally:
        if sys.platform != "win32":
            ctypes.CDLL(None).fflush(None)  # C's own buffers
        for descriptor, copy in kept.items():
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(nowhere)


with _quiet():
    import pybullet

URDF = Path(__file__).parent.parent / "assets" / "turtlebot2.urdf"
GRAVITY = 9.81  # [m/s^2]
FLOOR_FRICTION = 1.0  # rubber on a dry floor
_MARGIN = 0.02  # [m] for a robot that moves faster than it is told, thrown back from a wall
TOUCH = 1.0e-3  # [m] a gap below this is contact: Bullet keeps bodies apart by less
_SOFTNESS = 1.0e-6  # constraint force mixing; 0 makes the direct solver's matrix singular
_GOAL_COLOUR = (0.42, 0.75, 0.29, 1.0)
_FLOOR_COLOUR = np.array((244, 241, 234), dtype=np.float32)
_SKY_COLOUR = (255, 255, 255)
_TILE_CONTRAST = 34.0  # of 255
_CHASE_EYE, _CHASE_TARGET = (-1.4, 0.0, 1.3), (0.5, 0.0, 0.1)  # [m] in the robot's frame
_CHASE_FIELD_OF_VIEW = math.radians(55.0)  # [rad] vertical
_CHASE_RANGE = (0.05, 30.0)  # [m]


@dataclass(frozen=True)
class BulletState:
    """Base and wheels of the robot, and what the sensors remember."""

    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    velocity: tuple[tuple[float, float, float], tuple[float, float, float]]
    wheels: tuple[tuple[float, float], ...]  # angle [rad] and rate [rad/s] of each
    odometry: tuple[float, float, float]
    rng: Mapping[str, Any]  # of the generator of the laser's noise


class BulletSimulation:
    """One TurtleBot2 in one maze.

    Args:
        maze: Its walls are fixed bodies of their full height.
        laser: Cast exactly (`tb2rl.laser`), not by PyBullet.
        window: Open PyBullet's window; needs a display.
    """

    robots = 1
    state_type = BulletState

    def __init__(self, maze: Maze, laser: robot.Laser, window: bool = False) -> None:
        self.maze, self.laser = maze, laser
        if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise InputError("render_mode 'human' opens a window, and there is no display; use 'rgb_array'")
        with _quiet():
            self._client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
            self._set_physics()
            self._build_floor()
            self._walls = self._build_walls()
            self._load_robot()
        self._cos_beams, self._sin_beams = np.cos(laser.angles), np.sin(laser.angles)
        self._scratch = np.empty((2, len(laser.angles)))
        self._rng = np.random.default_rng()
        self._duration, self._steps = 0.0, 0

    # ---- the robot's life

    def reset(self, poses: np.ndarray, rng: np.random.Generator) -> Reading:
        x, y, yaw = map(float, poses[0])
        turn = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        position = (x + self._centre_x * math.cos(yaw), y + self._centre_x * math.sin(yaw), self._centre_z)
        rest = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        self._rng = rng
        self._put(BulletState(position, turn, rest, ((0.0, 0.0), (0.0, 0.0)), (x, y, yaw), {}))
        return self._read(bumped=False)

    def step(self, commands: np.ndarray, duration: float) -> Reading:
        self._set_duration(duration)
        self.drive(commands)
        bumped = False
        if self.maze.clearance(*self._place) > robot.BASE_RADIUS + robot.MAX_SPEED * duration + _MARGIN:
            self.advance()
        else:  # near a wall: a touch may be shorter than a control step
            for _ in range(self._steps):
                pybullet.stepSimulation(self._client)
                bumped = bumped or self._touches_a_wall()
        return self._read(bumped)

    def drive(self, commands: np.ndarray) -> None:
        """Tell the wheel motors the speeds for `commands` (1, 2)."""
        v, w = commands[0].tolist()
        v = min(max(v, -robot.MAX_SPEED), robot.MAX_SPEED)
        reach = min(max(w, -robot.MAX_TURN_RATE), robot.MAX_TURN_RATE) * robot.WHEEL_SEPARATION / 2
        for wheel, speed in zip(self._wheels, (v - reach, v + reach), strict=True):
            pybullet.setJointMotorControl2(
                self._robot,
                wheel,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=speed / robot.WHEEL_RADIUS,
                force=robot.WHEEL_TORQUE,
                physicsClientId=self._client,
            )

    def advance(self) -> None:
        """Run the physics for the duration last set: the bare stepping that `benchmark` compares `step` with."""
        client, step = self._client, pybullet.stepSimulation
        for _ in range(self._steps):
            step(client)

    def state(self) -> BulletState:
        position, orientation = pybullet.getBasePositionAndOrientation(self._robot, self._client)
        velocity = pybullet.getBaseVelocity(self._robot, self._client)
        wheels = tuple(joint[:2] for joint in self._joint_states())
        state = BulletState(position, orientation, velocity, wheels, self._odometry, self._rng.bit_generator.state)
        self._put(state)  # PyBullet rounds what it is given, so that a restored robot would differ from this one
        return state

    def restore(self, state: BulletState) -> Reading:
        self._put(state)
        reading = self._read(bumped=False)
        self._rng.bit_generator.state = dict(state.rng)
        return reading

    def _put(self, state: BulletState) -> None:
        pybullet.resetBasePositionAndOrientation(self._robot, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0, 1.0), self._client)
        pybullet.performCollisionDetection(self._client)  # forgets the contacts of where it was
        pybullet.resetBasePositionAndOrientation(self._robot, state.position, state.orientation, self._client)
        pybullet.resetBaseVelocity(self._robot, *state.velocity, self._client)
        for wheel, (angle, rate) in zip(self._wheels, state.wheels, strict=True):
            pybullet.resetJointState(self._robot, wheel, angle, rate, self._client)
        self._angles = tuple(angle for angle, _ in state.wheels)
        self._odometry = state.odometry

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    # ---- sensors

    def _read(self, bumped: bool) -> Reading:
        (vx, vy, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self._robot, self._client)
        x, y, yaw = self._pose()
        cos, sin = math.cos(yaw), math.sin(yaw)
        self._place = x, y
        ranges = np.empty((1, self._cos_beams.size))
        cast_one(
            x, y, yaw, self._cos_beams, self._sin_beams, self.maze.boxes, self.maze.posts, self._scratch, ranges[0]
        )
        if self.laser.noise:
            ranges += self.laser.noise * self._rng.standard_normal(ranges.shape)
        limit_ranges(ranges[0], self.laser.min_range, self.laser.max_range)
        return Reading(
            pose=np.array([[x, y, yaw]]),
            twist=np.array([[vx * cos + vy * sin, turn_rate]]),
            odometry=np.array([self._count_wheels()]),
            ranges=ranges,
            bumped=np.array([bumped]),
        )

    def _pose(self) -> tuple[float, float, float]:
        (px, py, _), (_, _, qz, qw) = pybullet.getBasePositionAndOrientation(self._robot, self._client)
        yaw = math.remainder(2.0 * math.atan2(qz, qw), math.tau)  # the robot stays upright
        return px - self._centre_x * math.cos(yaw), py - self._centre_x * math.sin(yaw), yaw

    def _count_wheels(self) -> tuple[float, float, float]:
        """Odometry: arcs of the wheels' encoders since the last call, added to the pose they give."""
        left, right = (joint[0] for joint in self._joint_states())
        step_left = (left - self._angles[0]) * robot.WHEEL_RADIUS
        step_right = (right - self._angles[1]) * robot.WHEEL_RADIUS
        self._angles = (left, right)
        x, y, yaw = self._odometry
        length, turn = (step_left + step_right) / 2, (step_right - step_left) / robot.WHEEL_SEPARATION
        if turn:
            length *= math.sin(turn / 2) / (turn / 2)  # the chord of the arc
        heading = yaw + turn / 2
        yaw = math.remainder(yaw + turn, math.tau)
        self._odometry = (x + length * math.cos(heading), y + length * math.sin(heading), yaw)
        return self._odometry

    def _joint_states(self) -> tuple:
        return pybullet.getJointStates(self._robot, self._wheels, self._client)

    def _touches_a_wall(self) -> bool:
        contacts = pybullet.getContactPoints(self._robot, self._walls, physicsClientId=self._client)
        return any(contact[8] < TOUCH for contact in contacts)  # 8: distance

    def ray_ranges(self, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """PyBullet's own ranges [m] from `pose` (3,) along `angles` (beams,), to hold the exact laser against."""
        x, y, yaw = pose
        reach = self.laser.max_range
        ends = [(x + reach * math.cos(yaw + a), y + reach * math.sin(yaw + a), WALL_HEIGHT / 2) for a in angles]
        hits = pybullet.rayTestBatch(
            [(x, y, WALL_HEIGHT / 2)] * len(ends), ends, collisionFilterMask=_WALL_GROUP, physicsClientId=self._client
        )
        return np.array([hit[2] * reach if hit[0] >= 0 else np.inf for hit in hits])

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """What the RGB-D camera on the front sees, drawn by PyBullet's software renderer.

        Returns:
            Colours, shape (height, width, 3), uint8; depth along the optical axis [m], shape (height, width), float32,
            inf beyond the sensor's range.
        """
        x, y, yaw = self._pose()
        ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        eye = np.array([x, y, 0.0]) + robot.CAMERA_POSITION[0] * ahead + (0.0, 0.0, robot.CAMERA_POSITION[2])
        return self._picture(eye, eye + ahead, robot.CAMERA_FIELD_OF_VIEW, robot.CAMERA_RANGE, width, height)

    def _picture(
        self,
        eye: np.ndarray,
        target: np.ndarray,
        field_of_view: float,
        reach: tuple[float, float],
        width: int,
        height: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is seen from `eye` (3,) towards `target` (3,), from `reach[0]` to `reach[1]` [m]; see `camera`."""
        near, far = reach
        view = pybullet.computeViewMatrix(eye, target, (0.0, 0.0, 1.0))
        projection = pybullet.computeProjectionMatrixFOV(math.degrees(field_of_view), width / height, near, far)
        _, _, rgba, buffer, _ = pybullet.getCameraImage(
            width, height, view, projection, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self._client
        )
        rgb = np.reshape(rgba, (height, width, 4))[..., :3].astype(np.uint8)
        z = np.reshape(buffer, (height, width)).astype(np.float64)
        depth = far * near / (far - (far - near) * z)  # OpenGL's depth buffer
        return rgb, np.where(z < 1.0, depth, np.inf).astype(np.float32)

    # ---- building

    def _set_physics(self) -> None:
        pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG,
            globalCFM=_SOFTNESS,
            physicsClientId=self._client,
        )

    def _set_duration(self, duration: float) -> None:
        if duration != self._duration:
            self._duration = duration
            self._steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
            pybullet.setPhysicsEngineParameter(fixedTimeStep=duration / self._steps, physicsClientId=self._client)

    def _build_floor(self) -> None:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        self._floor = pybullet.createMultiBody(0.0, plane, physicsClientId=self._client)
        pybullet.changeDynamics(self._floor, -1, lateralFriction=FLOOR_FRICTION, physicsClientId=self._client)

    def _build_walls(self) -> int:
        """All walls as one body: a fixed base without a shape, and a fixed link for each box and post."""
        client = self._client
        collisions, visuals, places, turns = [], [], [], []

        def add(x: float, y: float, yaw: float, shape: int, collision: dict, visual: dict) -> None:
            collisions.append(pybullet.createCollisionShape(shape, **collision, physicsClientId=client))
            visuals.append(pybullet.createVisualShape(shape, **visual, rgbaColor=WALL_COLOUR, physicsClientId=client))
            places.append((x, y, WALL_HEIGHT / 2))
            turns.append(pybullet.getQuaternionFromEuler((0.0, 0.0, yaw)))

        for x, y, half_length, half_width, cos, sin in self.maze.boxes:
            size = {"halfExtents": (half_length, half_width, WALL_HEIGHT / 2)}
            add(x, y, math.atan2(sin, cos), pybullet.GEOM_BOX, size, size)
        for x, y, radius in self.maze.posts:
            sizes = {"radius": radius, "height": WALL_HEIGHT}, {"radius": radius, "length": WALL_HEIGHT}
            add(x, y, 0.0, pybullet.GEOM_CYLINDER, *sizes)
        count = len(places)
        walls = pybullet.createMultiBody(
            baseMass=0.0,
            linkMasses=[0.0] * count,
            linkCollisionShapeIndices=collisions,
            linkVisualShapeIndices=visuals,
            linkPositions=places,
            linkOrientations=turns,
            linkInertialFramePositions=[(0.0, 0.0, 0.0)] * count,
            linkInertialFrameOrientations=[(0.0, 0.0, 0.0, 1.0)] * count,
            linkParentIndices=[0] * count,
            linkJointTypes=[pybullet.JOINT_FIXED] * count,
            linkJointAxis=[(0.0, 0.0, 1.0)] * count,
            physicsClientId=client,
        )
        for link in range(count):
            pybullet.setCollisionFilterGroupMask(walls, link, _WALL_GROUP, _EVERYTHING, physicsClientId=client)
        return walls

    def _load_robot(self) -> None:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MERGE_FIXED_LINKS
        self._robot = pybullet.loadURDF(str(URDF), flags=flags, physicsClientId=self._client)
        joints = range(pybullet.getNumJoints(self._robot, self._client))
        names = {pybullet.getJointInfo(self._robot, joint, self._client)[1].decode(): joint for joint in joints}
        self._wheels = (names["wheel_left"], names["wheel_right"])
        # Casters roll: merged into the base, they and it are free of friction. The wheels grip.
        undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "physicsClientId": self._client}
        pybullet.changeDynamics(self._robot, -1, lateralFriction=0.0, **undamped)
        for wheel in self._wheels:
            pybullet.changeDynamics(self._robot, wheel, lateralFriction=1.0, **undamped)
        # PyBullet speaks of the centre of mass, we of the middle of the axle on the floor.
        self._centre_x, _, self._centre_z = pybullet.getDynamicsInfo(self._robot, -1, self._client)[3]


class Stage(BulletSimulation):
    """A maze and a robot to look at, not to drive: what is filmed or shown stays undisturbed.

    Args:
        maze: As in `BulletSimulation`.
        goal: x and y [m] of a disc on the floor.
        window: As in `BulletSimulation`; without it, `chase` takes the pictures.
    """

    def __init__(self, maze: Maze, goal: tuple[float, float] | None = None, window: bool = False) -> None:
        super().__init__(maze, robot.Laser(beams=1), window)
        if goal is not None:
            self._build_disc(goal)
        if window:
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self._client)
            self._look_at_all()
        else:  # the renderer spends most of its time on a floor; `_tiles` takes a tenth of it
            pybullet.changeVisualShape(self._floor, -1, rgbaColor=(0.0, 0.0, 0.0, 0.0), physicsClientId=self._client)

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose (3,)."""
        x, y, yaw = map(float, pose)
        position = (x + self._centre_x * math.cos(yaw), y + self._centre_x * math.sin(yaw), self._centre_z)
        turn = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        pybullet.resetBasePositionAndOrientation(self._robot, position, turn, self._client)

    def follow(self) -> None:
        """Turn the window's view to look over the robot's shoulder."""
        x, y, yaw = self._pose()
        distance = math.dist(_CHASE_EYE, _CHASE_TARGET)
        slope = math.degrees(math.asin((_CHASE_TARGET[2] - _CHASE_EYE[2]) / distance))
        target = (x + _CHASE_TARGET[0] * math.cos(yaw), y + _CHASE_TARGET[0] * math.sin(yaw), _CHASE_TARGET[2])
        pybullet.resetDebugVisualizerCamera(
            distance, math.degrees(yaw) - 90.0, slope, target, physicsClientId=self._client
        )

    def chase(self, width: int, height: int) -> np.ndarray:
        """The robot and what lies ahead of it, from behind and above, shape (height, width, 3), uint8."""
        x, y, yaw = self._pose()
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])
        here = np.array([x, y, 0.0])
        eye, target = here + turn @ _CHASE_EYE, here + turn @ _CHASE_TARGET
        colours, depth = self._picture(eye, target, _CHASE_FIELD_OF_VIEW, _CHASE_RANGE, width, height)
        return np.where(np.isfinite(depth)[..., None], colours, _tiles(x, y, cos, sin, width, height))

    def _look_at_all(self) -> None:
        x0, y0, x1, y1 = self.maze.bounds
        middle, distance = ((x0 + x1) / 2, (y0 + y1) / 2, 0.0), 0.8 * max(x1 - x0, y1 - y0)
        pybullet.resetDebugVisualizerCamera(distance, 0.0, -60.0, middle, physicsClientId=self._client)

    def _build_disc(self, place: tuple[float, float]) -> None:
        disc = pybullet.createVisualShape(
            pybullet.GEOM_CYLINDER, radius=0.2, length=0.01, rgbaColor=_GOAL_COLOUR, physicsClientId=self._client
        )
        pybullet.createMultiBody(
            0.0, baseVisualShapeIndex=disc, basePosition=(*place, 0.005), physicsClientId=self._client
        )


def _tiles(x: float, y: float, cos: float, sin: float, width: int, height: int) -> np.ndarray:
    """The floor and the sky as the chase camera sees them, behind all else, shape (height, width, 3), uint8."""
    ahead, left, contrast, sky = _seen_floor(width, height)
    east, north = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    dark = (np.floor(east) + np.floor(north)) % 2 * contrast
    colours = (_FLOOR_COLOUR - dark[..., None] * _TILE_CONTRAST).astype(np.uint8)
    colours[:sky] = _SKY_COLOUR
    return colours


@lru_cache(maxsize=4)
def _seen_floor(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Where in the robot's frame the chase camera's pixels see the floor.

    Returns:
        Metres ahead and to the left, and the contrast of the tiles there, each of shape (height, width), float32;
        the number of rows above the horizon.
    """
    eye, target = np.array(_CHASE_EYE), np.array(_CHASE_TARGET)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.array([0.0, -1.0, 0.0])
    up = np.cross(right, forward)
    reach = math.tan(_CHASE_FIELD_OF_VIEW / 2)
    across = (np.arange(width) + 0.5 - width / 2) * 2 * reach / height
    upward = (height / 2 - np.arange(height) - 0.5) * 2 * reach / height
    rays = forward + upward[:, None, None] * up + across[None, :, None] * right
    sky = int((rays[:, 0, 2] > -1e-3).sum())
    distance = eye[2] / np.maximum(-rays[..., 2], 1e-3)
    ahead, left = eye[0] + distance * rays[..., 0], distance * rays[..., 1]
    contrast = 1.0 / (1.0 + (distance / 5.0) ** 2)  # tiles far away are smaller than a pixel and would flicker
    return ahead.astype(np.float32), left.astype(np.float32), contrast.astype(np.float32), sky


def show(connection: Connection, maze: Maze, goal: tuple[float, float] | None, follow: bool) -> None:
    """Show a `Stage` in a window: the body of a process of its own, which ends with the window.

    PyBullet ends its whole process where a window cannot be opened, and where one is closed.

    Args:
        connection: Sends True once the window is open, then receives poses (3,), and None to close it.
        maze: As in `Stage`.
        goal: As in `Stage`.
        follow: Look over the robot's shoulder instead of at the whole maze.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that opened this decides
    with _quiet(), suppress(EOFError, OSError, pybullet.error), closing(Stage(maze, goal, window=True)) as stage:
        connection.send(True)
        pose = connection.recv()
        while pose is not None and pybullet.isConnected(stage._client):
            stage.place(pose)
            if follow:
                stage.follow()
            pose = connection.recv()
            while connection.poll() and pose is not None:  # the window may be slower than what it shows
                pose = connection.recv()


WALL_COLOUR = (0.66, 0.36, 0.27, 1.0)  # brick
_WALL_GROUP = 2
_EVERYTHING = -1
