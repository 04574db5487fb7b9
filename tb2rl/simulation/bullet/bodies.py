"""Bodies in a PyBullet client (floor, walls and robot), and images of them by PyBullet's software renderer."""

import math
import os
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.robots import Camera, Robot
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.worlds.world import WALL_HEIGHT, World

GRAVITY = 9.81  # [m/s^2]
FLOOR_FRICTION = 1.0  # friction coefficient of rubber on a dry floor
WHEEL_FRICTION = 1.0  # PyBullet multiplies the coefficients of wheel and floor
WALL_COLOUR = (0.66, 0.36, 0.27, 1.0)  # brick
CONTACT = 1.0e-3  # [m] bodies with a smaller gap touch, because Bullet keeps touching bodies slightly apart
WALL_GROUP = 2  # collision group of walls and dynamic obstacles, which collide with robots only
ROBOT_GROUP = 1  # PyBullet's default collision group of bodies with mass; here, robots
_MAX_SHAPES = 16  # maximum number of shapes of a body; PyBullet ignores others without a message
Images = tuple[np.ndarray, np.ndarray]  # colours and depth, see `take_picture`
_CFM = 1.0e-6  # constraint force mixing; with 0, the matrix of the direct solver is singular


def connect() -> int:
    """Connect to a new PyBullet client, and `clear` it."""
    client = pybullet.connect(pybullet.DIRECT)
    clear(client)
    return client


def disconnector(owner: object, client: int) -> weakref.finalize:
    """Make a finalizer that disconnects a client when it is called, or when its owner is garbage-collected.

    A client that is never disconnected keeps tens of MB of memory.
    """

    def disconnect(process: int) -> None:
        if process == os.getpid():  # a forked process does not own the client
            pybullet.disconnect(client)

    finalizer = weakref.finalize(owner, disconnect, os.getpid())
    finalizer.atexit = False  # the process ends anyway
    return finalizer


def clear(client: int) -> None:
    """Remove all bodies from a client, and set gravity and the solver.

    The direct solver (Dantzig's algorithm for the linear complementarity problem) reaches the target speeds of the
    wheels, which PyBullet's default iterative solver does not, and takes a fifth of the time.
    """
    pybullet.resetSimulation(physicsClientId=client)
    pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(
        constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG, globalCFM=_CFM, physicsClientId=client
    )


def add_floor(client: int) -> int:
    """Add an endless floor; return the number of its body."""
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    floor = pybullet.createMultiBody(0.0, plane, physicsClientId=client)
    pybullet.changeDynamics(floor, -1, lateralFriction=FLOOR_FRICTION, physicsClientId=client)
    return floor


def add_walls(client: int, world: World) -> tuple[int, ...]:
    """Add all walls and posts of a world; return the numbers of the bodies.

    Each body has neighbouring shapes, so that most bodies are far from the robot, where they take no time.
    """
    box, post, quaternion = pybullet.GEOM_BOX, pybullet.GEOM_CYLINDER, pybullet.getQuaternionFromEuler
    half_height, upright = WALL_HEIGHT / 2, quaternion((0.0, 0.0, 0.0))
    shapes = [  # type, half sizes, radius, position, orientation
        (box, (*half_sizes, half_height), 0.0, (x, y, half_height), quaternion((0.0, 0.0, math.atan2(sin, cos))))
        for x, y, *half_sizes, cos, sin in world.boxes.tolist()
    ]
    shapes += [(post, (0.0,) * 3, radius, (x, y, half_height), upright) for x, y, radius in world.posts.tolist()]
    centres, bodies = np.array([shape[3] for shape in shapes]), []
    for group in _group_neighbours(centres, np.arange(len(centres))):
        # `createCollisionShapeArray` and `createVisualShapeArray` crash with tuples.
        types, half_sizes, radii, positions, orientations = map(list, zip(*(shapes[k] for k in group), strict=True))
        lengths, colours = [WALL_HEIGHT] * len(group), [WALL_COLOUR] * len(group)
        sizes = {"halfExtents": half_sizes, "radii": radii, "lengths": lengths, "physicsClientId": client}
        collision = pybullet.createCollisionShapeArray(
            types, collisionFramePositions=positions, collisionFrameOrientations=orientations, **sizes
        )
        frames = {"visualFramePositions": positions, "visualFrameOrientations": orientations}
        visual = pybullet.createVisualShapeArray(types, rgbaColors=colours, **frames, **sizes)
        # With maximal coordinates, PyBullet makes a static body, which takes no time in a physics step.
        body = pybullet.createMultiBody(0.0, collision, visual, useMaximalCoordinates=True, physicsClientId=client)
        bodies.append(body)
        pybullet.setCollisionFilterGroupMask(body, -1, WALL_GROUP, ROBOT_GROUP, physicsClientId=client)
    return tuple(bodies)


def _group_neighbours(centres: np.ndarray, indices: np.ndarray) -> list[np.ndarray]:
    """Divide indices of centres (n, 3) into groups of at most `_MAX_SHAPES` neighbours."""
    if len(indices) <= _MAX_SHAPES:
        return [indices] if len(indices) else []
    axis = np.ptp(centres[indices], axis=0).argmax()
    indices = indices[np.argsort(centres[indices, axis], kind="stable")]
    halves = np.split(indices, [len(indices) // 2])
    return [group for half in halves for group in _group_neighbours(centres, half)]


@dataclass(frozen=True)
class RobotBody:
    """A robot in a PyBullet client."""

    client: int  # PyBullet's number of the client
    body: int  # PyBullet's number of the body
    wheels: tuple[int, int]  # PyBullet's numbers of the joints of the left and the right wheel
    centre: tuple[float, float]  # [m] x and z of the centre of mass in the robot's frame; PyBullet's poses refer to it
    inertia: tuple[float, tuple[float, float, float]]  # nominal mass [kg] and moments of inertia [kg m^2] of the base
    _dynamics: list[float] = field(default_factory=lambda: [1.0, 1.0])  # last arguments of `set_dynamics`

    def frame_at(self, x: float, y: float, yaw: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position of the centre of mass [m] and orientation (quaternion) for a pose of the robot."""
        position = (x + self.centre[0] * math.cos(yaw), y + self.centre[0] * math.sin(yaw), self.centre[1])
        return position, (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def set_dynamics(self, mass: float, friction: float) -> None:
        """Set the mass of the base and the friction of the wheels, as multiples of the nominal values."""
        if self._dynamics == [mass, friction]:
            return
        self._dynamics[:] = mass, friction
        nominal_mass, moments, client = *self.inertia, self.client
        inertia = {"mass": mass * nominal_mass, "localInertiaDiagonal": [mass * moment for moment in moments]}
        pybullet.changeDynamics(self.body, -1, **inertia, physicsClientId=client)
        for wheel in self.wheels:
            pybullet.changeDynamics(self.body, wheel, lateralFriction=friction * WHEEL_FRICTION, physicsClientId=client)

    def set_wheel_rates(self, rates: list[float], torque: float) -> None:
        """Set the target rates [rad/s] and the maximum torque [N m] of the wheels' motors."""
        targets = {"targetVelocities": rates, "forces": [torque, torque], "physicsClientId": self.client}
        pybullet.setJointMotorControlArray(self.body, self.wheels, pybullet.VELOCITY_CONTROL, **targets)

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose (3,)."""
        pybullet.resetBasePositionAndOrientation(self.body, *self.frame_at(*map(float, pose)), self.client)

    def teleport(self, position: Any, orientation: Any, velocity: Any, wheels: Any) -> None:
        """Restore the result of `motion`, and clear the contacts at the former position."""
        pybullet.resetBasePositionAndOrientation(self.body, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0, 1.0), self.client)
        pybullet.performCollisionDetection(self.client)  # clears the contacts
        pybullet.resetBasePositionAndOrientation(self.body, position, orientation, self.client)
        pybullet.resetBaseVelocity(self.body, *velocity, self.client)
        for wheel, (angle, rate) in zip(self.wheels, wheels, strict=True):
            pybullet.resetJointState(self.body, wheel, angle, rate, self.client)

    def motion(self) -> dict[str, Any]:
        """Arguments for `teleport`: PyBullet's position, orientation and velocity of the base, and `wheel_states`."""
        position, orientation = pybullet.getBasePositionAndOrientation(self.body, self.client)
        motion = {"velocity": pybullet.getBaseVelocity(self.body, self.client), "wheels": self.wheel_states()}
        return {"position": position, "orientation": orientation, **motion}

    def wheel_states(self) -> tuple[tuple[float, float], ...]:
        """Angle [rad] and rate [rad/s] of the left and the right wheel."""
        return tuple(joint[:2] for joint in pybullet.getJointStates(self.body, self.wheels, self.client))

    def touches(self, bodies: Sequence[int]) -> bool:
        """Whether the robot is in contact with any of these bodies."""
        contacts = pybullet.getContactPoints(self.body, physicsClientId=self.client)
        return any(contact[2] in bodies and contact[8] < CONTACT for contact in contacts)  # [2] body, [8] distance

    def pose(self) -> tuple[float, float, float]:
        """X [m], y [m], yaw [rad]."""
        (px, py, _), (_, _, qz, qw) = pybullet.getBasePositionAndOrientation(self.body, self.client)
        yaw = math.remainder(2.0 * math.atan2(qz, qw), math.tau)  # the robot stays upright
        return px - self.centre[0] * math.cos(yaw), py - self.centre[0] * math.sin(yaw), yaw


def add_robot(client: int, robot: Robot) -> RobotBody:
    """Add a robot from its URDF file.

    Raises:
        InputError: If PyBullet cannot load the file, the file lacks the joints of the wheels, or its wheels differ from
            the parameters of the robot.
    """
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MERGE_FIXED_LINKS
    try:
        body = pybullet.loadURDF(str(robot.urdf), flags=flags, physicsClientId=client)
    except pybullet.error as error:
        raise InputError(f"robot {robot.name}: PyBullet cannot load {robot.urdf}: {error}") from None
    joints = range(pybullet.getNumJoints(body, client))
    joint_numbers = {pybullet.getJointInfo(body, joint, client)[1].decode(): joint for joint in joints}
    missing = [name for name in robot.wheel_joints if name not in joint_numbers]
    if missing:
        known = ", ".join(joint_numbers)
        raise InputError(f"robot {robot.name}: {robot.urdf} has no joint {missing[0]!r}; it has {known}")
    wheels = joint_numbers[robot.wheel_joints[0]], joint_numbers[robot.wheel_joints[1]]
    robot.check_wheels(*(pybullet.getLinkState(body, wheel, physicsClientId=client)[4] for wheel in wheels))
    # The casters are merged into the base, which has no friction, because casters roll.
    undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "physicsClientId": client}
    pybullet.changeDynamics(body, -1, lateralFriction=0.0, **undamped)
    for wheel in wheels:
        pybullet.changeDynamics(body, wheel, lateralFriction=WHEEL_FRICTION, **undamped)
    mass, _, moments, (centre_x, _, centre_z), *_ = pybullet.getDynamicsInfo(body, -1, client)
    return RobotBody(client, body, wheels, (centre_x, centre_z), (mass, moments))


def camera_image(client: int, pose: np.ndarray, camera: Camera, width: int, height: int) -> Images:
    """Image from the camera of a robot at a pose (3,), see `take_picture`."""
    x, y, yaw = pose.tolist()
    ahead, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    forward, sideways, up = camera.position
    position = np.array([x, y, up]) + forward * ahead + sideways * left
    return take_picture(client, position, position + ahead, camera, width, height)


def take_picture(client: int, lens: np.ndarray, target: np.ndarray, camera: Camera, width: int, height: int) -> Images:
    """Render an image.

    Args:
        client: The PyBullet client.
        lens, target: x, y, z [m] of the lens, and of a point in the middle of the image, shape (3,).
        camera: Camera whose field of view and range apply.
        width, height: Size of the image [px].

    Returns:
        Colours, shape (height, width, 3), uint8; depth along the optical axis [m], inf beyond the range, shape (height,
        width), float32.
    """
    near, far = camera.range
    view = pybullet.computeViewMatrix(lens, target, (0.0, 0.0, 1.0))
    projection = pybullet.computeProjectionMatrixFOV(math.degrees(camera.field_of_view), width / height, near, far)
    _, _, rgba, buffer, _ = pybullet.getCameraImage(
        width, height, view, projection, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
    colours = np.reshape(rgba, (height, width, 4))[..., :3].astype(np.uint8)
    z = np.reshape(buffer, (height, width)).astype(np.float64)
    depth = far * near / (far - (far - near) * z)  # OpenGL's depth buffer
    return colours, np.where(z < 1.0, depth, np.inf).astype(np.float32)
