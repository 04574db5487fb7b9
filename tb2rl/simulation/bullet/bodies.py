"""Bodies in a PyBullet client: floor, walls and robot."""

from __future__ import annotations

import math
import os
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.robots import Robot
from tb2rl.simulation import check_display
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.worlds.world import WALL_HEIGHT, World

GRAVITY = 9.81  # [m/s^2]
FLOOR_FRICTION = 1.0  # rubber on a dry floor
WHEEL_FRICTION = 1.0  # times that of the floor
WALL_COLOUR = (0.66, 0.36, 0.27, 1.0)  # brick
WALL_GROUP = 2  # of collisions, for laser rays
TOUCH = 1.0e-3  # [m] a gap below this is contact: Bullet keeps bodies apart by less
MOVING_GROUP = 1  # PyBullet's own of bodies that move; walls collide with these alone, not with the floor
_MAX_SHAPES = 16  # of a body; PyBullet drops more without a message
_TOLERANCE = 0.01  # relative, between a robot's numbers and those of its URDF file
_SOFTNESS = 1.0e-6  # constraint force mixing; 0 makes the direct solver's matrix singular


def connect(window: bool) -> int:
    """Connect to a new PyBullet client, with or without its window, and `clear` it.

    Raises:
        InputError: If there is no display for a window.
    """
    if window:
        check_display()
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    clear(client)
    return client


def disconnects(owner: object, client: int) -> weakref.finalize:
    """A finalizer that disconnects a client when it is called, or when its owner is garbage-collected.

    PyBullet keeps a client, tens of MB, until it is disconnected. A forked process must not disconnect it, because the
    client belongs to the process that connected it.
    """
    finalizer = weakref.finalize(owner, _disconnect, client, os.getpid())
    finalizer.atexit = False  # the process ends anyway
    return finalizer


def _disconnect(client: int, process: int) -> None:
    if process == os.getpid():
        pybullet.disconnect(client)


def clear(client: int) -> None:
    """Remove all bodies from a client, and set gravity and the solver.

    The direct solver (Dantzig's, for the exact linear complementarity problem) holds the wheel speeds that the usual
    iterative one misses, at a fifth of its cost.
    """
    pybullet.resetSimulation(physicsClientId=client)
    pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(
        constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG, globalCFM=_SOFTNESS, physicsClientId=client
    )


def add_floor(client: int) -> int:
    """Add an endless floor; returns the number of its body."""
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    floor = pybullet.createMultiBody(0.0, plane, physicsClientId=client)
    pybullet.changeDynamics(floor, -1, lateralFriction=FLOOR_FRICTION, physicsClientId=client)
    return floor


def add_walls(client: int, world: World) -> tuple[int, ...]:
    """Add all walls and posts of a world, as few bodies, each of neighbours, because distant bodies cost no time.

    Returns:
        The bodies' numbers.
    """
    boxes, posts = world.boxes.tolist(), world.posts.tolist()
    kinds = [pybullet.GEOM_BOX] * len(boxes) + [pybullet.GEOM_CYLINDER] * len(posts)
    halves = [(length, width, WALL_HEIGHT / 2) for _, _, length, width, _, _ in boxes] + [(0.0, 0.0, 0.0)] * len(posts)
    radii = [0.0] * len(boxes) + [radius for _, _, radius in posts]
    yaws = [math.atan2(sin, cos) for *_, cos, sin in boxes] + [0.0] * len(posts)
    places = [(x, y, WALL_HEIGHT / 2) for x, y, *_ in [*boxes, *posts]]
    turns = [pybullet.getQuaternionFromEuler((0.0, 0.0, yaw)) for yaw in yaws]
    bodies = []
    for group in _neighbours(np.array(places).reshape(-1, 3), np.arange(len(places))):
        kind, half, radius, place, turn = (
            [column[k] for k in group] for column in (kinds, halves, radii, places, turns)
        )
        sizes = {"halfExtents": half, "radii": radius, "lengths": [WALL_HEIGHT] * len(group), "physicsClientId": client}
        collision = pybullet.createCollisionShapeArray(
            kind, collisionFramePositions=place, collisionFrameOrientations=turn, **sizes
        )
        visual = pybullet.createVisualShapeArray(
            kind,
            visualFramePositions=place,
            visualFrameOrientations=turn,
            rgbaColors=[WALL_COLOUR] * len(group),
            **sizes,
        )
        # With maximal coordinates it is a plain static body, which no step of the physics visits.
        body = pybullet.createMultiBody(0.0, collision, visual, useMaximalCoordinates=True, physicsClientId=client)
        bodies.append(body)
        pybullet.setCollisionFilterGroupMask(body, -1, WALL_GROUP, MOVING_GROUP, physicsClientId=client)
    return tuple(bodies)


def _neighbours(places: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Group `some` indices of places (n, 3) so that each group fits into a body."""
    if not len(some):
        return []
    if len(some) <= _MAX_SHAPES:
        return [some]
    axis = np.ptp(places[some], axis=0).argmax()
    some = some[np.argsort(places[some, axis], kind="stable")]
    middle = len(some) // 2
    return _neighbours(places, some[:middle]) + _neighbours(places, some[middle:])


@dataclass(frozen=True)
class RobotBody:
    """A robot in a client.

    Attributes:
        client: The client's number.
        body: The body's number.
        wheels: The numbers of the left and the right wheel's joint.
        centre: x and z of the centre of mass in the robot's frame [m], because PyBullet's poses are those of it.
        inertia: Mass [kg] and moments of inertia [kg m^2] of the base.
    """

    client: int
    body: int
    wheels: tuple[int, int]
    centre: tuple[float, float]
    inertia: tuple[float, tuple[float, float, float]]
    _dynamics: list[float] = field(default_factory=lambda: [1.0, 1.0])  # those of `set_dynamics`

    def frame_at(self, x: float, y: float, yaw: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position of the centre of mass [m] and orientation (quaternion) at a pose."""
        position = (x + self.centre[0] * math.cos(yaw), y + self.centre[0] * math.sin(yaw), self.centre[1])
        return position, (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def set_dynamics(self, mass: float, friction: float) -> None:
        """Set the base's mass and the wheels' friction, as multiples of the robot's own."""
        if self._dynamics == [mass, friction]:
            return
        self._dynamics[:] = mass, friction
        own, moments = self.inertia
        pybullet.changeDynamics(
            self.body,
            -1,
            mass=mass * own,
            localInertiaDiagonal=[mass * moment for moment in moments],
            physicsClientId=self.client,
        )
        for wheel in self.wheels:
            pybullet.changeDynamics(
                self.body, wheel, lateralFriction=friction * WHEEL_FRICTION, physicsClientId=self.client
            )

    def turn_wheels(self, rates: Sequence[float], torque: float) -> None:
        """Set the target rates [rad/s] and the largest torque [N m] of the wheels' motors."""
        for wheel, rate in zip(self.wheels, rates, strict=True):
            pybullet.setJointMotorControl2(
                self.body,
                wheel,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=rate,
                force=torque,
                physicsClientId=self.client,
            )

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose (3,)."""
        pybullet.resetBasePositionAndOrientation(self.body, *self.frame_at(*map(float, pose)), self.client)

    def teleport(self, position: Any, orientation: Any, velocity: Any, wheels: Any) -> None:
        """Restore a `motion`, without contacts of the former place."""
        pybullet.resetBasePositionAndOrientation(self.body, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0, 1.0), self.client)
        pybullet.performCollisionDetection(self.client)  # forgets the contacts
        pybullet.resetBasePositionAndOrientation(self.body, position, orientation, self.client)
        pybullet.resetBaseVelocity(self.body, *velocity, self.client)
        for wheel, (angle, rate) in zip(self.wheels, wheels, strict=True):
            pybullet.resetJointState(self.body, wheel, angle, rate, self.client)

    def motion(self) -> dict[str, Any]:
        """Position, orientation and velocity of the base in PyBullet's terms, and the `wheel_states`."""
        position, orientation = pybullet.getBasePositionAndOrientation(self.body, self.client)
        velocity = pybullet.getBaseVelocity(self.body, self.client)
        wheels = self.wheel_states()
        return {"position": position, "orientation": orientation, "velocity": velocity, "wheels": wheels}

    def wheel_states(self) -> tuple[tuple[float, float], ...]:
        """Angle [rad] and rate [rad/s] of the left and the right wheel."""
        return tuple(joint[:2] for joint in pybullet.getJointStates(self.body, self.wheels, self.client))

    def touches(self, bodies: Sequence[int]) -> bool:
        """Whether the robot is in contact with one of some bodies."""
        contacts = pybullet.getContactPoints(self.body, physicsClientId=self.client)
        return any(contact[2] in bodies and contact[8] < TOUCH for contact in contacts)  # other body; distance

    def pose(self) -> tuple[float, float, float]:
        """X [m], y [m], yaw [rad]."""
        (px, py, _), (_, _, qz, qw) = pybullet.getBasePositionAndOrientation(self.body, self.client)
        yaw = math.remainder(2.0 * math.atan2(qz, qw), math.tau)  # the robot stays upright
        return px - self.centre[0] * math.cos(yaw), py - self.centre[0] * math.sin(yaw), yaw


def add_robot(client: int, robot: Robot) -> RobotBody:
    """Add a robot from its URDF file.

    Raises:
        InputError: If PyBullet cannot load it, it lacks the wheels' joints, or its wheels are not those of the robot.
    """
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MERGE_FIXED_LINKS
    try:
        body = pybullet.loadURDF(str(robot.urdf), flags=flags, physicsClientId=client)
    except pybullet.error as error:
        raise InputError(f"robot {robot.name}: PyBullet cannot load {robot.urdf}: {error}") from None
    joints = range(pybullet.getNumJoints(body, client))
    names = {pybullet.getJointInfo(body, joint, client)[1].decode(): joint for joint in joints}
    missing = [name for name in robot.wheel_joints if name not in names]
    if missing:
        raise InputError(f"robot {robot.name}: {robot.urdf} has no joint {missing[0]!r}; it has {', '.join(names)}")
    wheels = names[robot.wheel_joints[0]], names[robot.wheel_joints[1]]
    _check_wheels(client, body, wheels, robot)
    # Casters roll: merged into the base, they and it are free of friction. The wheels grip.
    undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "physicsClientId": client}
    pybullet.changeDynamics(body, -1, lateralFriction=0.0, **undamped)
    for wheel in wheels:
        pybullet.changeDynamics(body, wheel, lateralFriction=WHEEL_FRICTION, **undamped)
    mass, _, moments, (centre_x, _, centre_z), *_ = pybullet.getDynamicsInfo(body, -1, client)
    return RobotBody(client, body, wheels, (centre_x, centre_z), (mass, moments))


def _check_wheels(client: int, body: int, wheels: tuple[int, int], robot: Robot) -> None:
    """Compare the wheels of a loaded body with the robot's numbers, which the kinematic simulator uses."""
    left, right = (pybullet.getLinkState(body, wheel, physicsClientId=client)[4][1] for wheel in wheels)
    if not left > 0.0 > right:
        raise InputError(
            f"robot {robot.name}: wheel_joints names the left wheel (y > 0) and then the right one; "
            f"{robot.wheel_joints[0]!r} is at y = {left:.4g} m, {robot.wheel_joints[1]!r} at y = {right:.4g} m"
        )
    found: list[tuple[str, float, float | None]] = [("wheel_separation", robot.wheel_separation, left - right)]
    found += [("wheel_radius", robot.wheel_radius, _wheel_radius(client, body, wheel)) for wheel in wheels]
    for name, said, has in found:
        if has is not None and abs(said - has) > _TOLERANCE * has:
            raise InputError(f"robot {robot.name}: {name} is {said:.4g} m, but {has:.4g} m in {robot.urdf}")


def _wheel_radius(client: int, body: int, wheel: int) -> float | None:
    """The radius of a wheel that collides as a sphere or a cylinder [m]; None for other shapes."""
    shapes = pybullet.getCollisionShapeData(body, wheel, client)
    if len(shapes) != 1:
        return None
    _, _, kind, sizes, file, *_ = shapes[0]
    if kind == pybullet.GEOM_SPHERE:
        return sizes[0]
    if kind == pybullet.GEOM_MESH and file == b"unknown_file":  # what PyBullet makes of a URDF file's cylinder
        axis = pybullet.getJointInfo(body, wheel, client)[13]
        corners = np.array(pybullet.getMeshData(body, wheel, physicsClientId=client)[1])
        return float(np.linalg.norm(np.cross(corners, axis), axis=1).max())
    return None
