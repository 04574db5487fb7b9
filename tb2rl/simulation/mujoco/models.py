"""MuJoCo models of a robot in a world: the robot from its URDF file, walls, posts, dynamic obstacles and a camera.

The robot stays upright: its base has joints along x, y and z and about z. A free joint would let it tilt by 9 degrees,
because casters have no contacts. The base touches walls as a sphere, because MuJoCo's contacts between a cylinder and a
box miss the edges of the box.
"""

import math
from functools import cache
from typing import Any

import mujoco
import numpy as np
from mujoco import MjModel, MjSpec, mjtBias, mjtCone, mjtDisableBit, mjtGain, mjtGeom, mjtJacobian, mjtJoint, mjtTrn

from tb2rl.core.errors import InputError, one_line
from tb2rl.robots import Robot
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT, World

WALL_COLOUR, OBSTACLE_COLOUR, FLOOR_COLOUR = (0.66, 0.36, 0.27, 1.0), (0.49, 0.31, 0.63, 1.0), (0.93, 0.93, 0.91, 1.0)
WHEEL_FRICTION = 1.0  # friction coefficient of the wheels on the floor, as in PyBullet
BASE = ("base_x", "base_y", "base_z", "base_yaw")  # names of the joints of the base
# Time steps of the fine model in one of the coarse model. With 4, a base enters walls by less than 2 mm; with 1, a
# TurtleBot2 would enter them by 8 mm, the way that it drives in a time step.
FINE_STEPS = 4
_FLOOR_GROUP, _WALL_GROUP = 1, 2  # collision groups: wheels touch the floor, the base touches walls and obstacles
_HIDDEN = 3  # group of shapes that MuJoCo does not draw
_MARGIN = 0.2e-3  # [m] gap to a wall at which the wall begins to stop the base
_MAX_HOP = 5.0e-3  # [m] limit of the base's vertical motion; MuJoCo's convex friction cones lift wheels that slip
_CASTER_GAP = 5.0e-5  # [m] a caster that is nearer to the floor carries a part of the weight
_SHORTEST = 1.0e-4  # [s] time constant of contacts; MuJoCo raises it to the shortest stable one, two time steps
# Settings of shapes that stop the base, without friction.
_HARD: dict[str, Any] = {
    "contype": _WALL_GROUP,
    "conaffinity": 0,
    "condim": 1,
    "priority": 1,
    "solref": (_SHORTEST, 3.0),  # a damping ratio of 1 would let the base rebound
    "solimp": (0.99, 0.99, 0.001, 0.5, 2.0),
}
_MEMORY = 1 << 20  # [bytes] for the contacts of a model; MuJoCo's default is 13 times as much


def make_model(spec: SimulationSpec, world: int, obstacle_sizes: np.ndarray) -> MjModel:
    """Compile the model of a world, without a time step.

    Args:
        spec: The robot and the worlds.
        world: Index of the world in `spec.worlds`.
        obstacle_sizes: Half length and half width of each dynamic obstacle, or radius and 0 [m], shape (obstacles, 2).

    Raises:
        InputError: If MuJoCo cannot load the robot's URDF file, or the file does not fit the robot's parameters.
    """
    model = _load_robot(spec.robot)
    option = model.option
    option.cone, option.jacobian = mjtCone.mjCONE_ELLIPTIC, mjtJacobian.mjJAC_DENSE
    option.disableflags = mjtDisableBit.mjDSBL_ISLAND | mjtDisableBit.mjDSBL_SENSOR  # take time without any effect
    model.memory = _MEMORY
    _add_motors(model, spec.robot)
    _add_world(model, spec.worlds[world])
    for length, width in obstacle_sizes[obstacle_sizes[:, 0] > 0.0].tolist():
        _add_obstacle(model, length, width)
    return model.compile()


def set_time_step(model: MjModel, robot: Robot, time_step: float) -> None:
    """Set the time step [s], and the highest gain of the motors that does not let the wheels oscillate."""
    model.opt.timestep = time_step
    gain = robot.wheel_torque * robot.wheel_radius / (robot.wheel_acceleration * time_step)  # [N m s / rad]
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 2] = gain, -gain


def vary_model(
    varied: MjModel, model: MjModel, robot: Robot, mass: float, friction: float, acceleration: float
) -> None:
    """Set mass of the base, friction of the wheels and torque in a copy of a model, as multiples of its values."""
    base, wheels = model.joint(BASE[0]).bodyid[0], [model.joint(name).bodyid[0] for name in robot.wheel_joints]
    varied.body_mass[base], varied.body_inertia[base] = mass * model.body_mass[base], mass * model.body_inertia[base]
    shapes = np.isin(model.geom_bodyid, wheels)
    varied.geom_friction[shapes, 0] = friction * model.geom_friction[shapes, 0]
    varied.actuator_forcerange[:] = acceleration * model.actuator_forcerange


@cache
def check_robot(robot: Robot) -> None:
    """Check a robot's URDF file.

    Raises:
        InputError: If MuJoCo cannot load the file, the file lacks the joints of the wheels, or its wheels differ from
            the parameters of the robot.
    """
    model = _load_robot(robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    robot.check_wheels(*(data.joint(name).xanchor for name in robot.wheel_joints))


def _load_robot(robot: Robot) -> MjSpec:
    """The robot on joints of its base, with wheels that collide with the floor and a base that collides with walls."""
    try:
        model = MjSpec.from_file(str(robot.urdf))
    except (ValueError, OSError) as error:
        raise InputError(one_line(f"robot {robot.name}: MuJoCo cannot load {robot.urdf}: {error}")) from None
    wheels = [_wheel_body(model, robot, name) for name in robot.wheel_joints]
    for joint in list(model.joints):
        if joint.name not in robot.wheel_joints:
            model.delete(joint)
    base, load_on_wheels = model.worldbody.first_body(), _load_on_wheels(robot)
    for body in model.bodies[1:]:  # the first is the world
        for shape in list(body.geoms):
            if body.name not in wheels:
                model.delete(shape)
                continue
            shape.contype, shape.conaffinity, shape.condim, shape.group = 0, _FLOOR_GROUP, 3, _HIDDEN
            shape.friction, shape.priority = (WHEEL_FRICTION * load_on_wheels, 0.0, 0.0), 1
            shape.solref, shape.solimp = (_SHORTEST, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)  # grips, and hardly sinks
    slide, hinge = mjtJoint.mjJNT_SLIDE, mjtJoint.mjJNT_HINGE
    joints = zip(BASE, (slide, slide, slide, hinge), ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 1)), strict=True)
    for name, joint_type, axis in joints:
        base.add_joint(name=name, type=joint_type, axis=axis)
    model.joint("base_z").limited, model.joint("base_z").range = True, (-_MAX_HOP, _MAX_HOP)
    ball = {"type": mjtGeom.mjGEOM_SPHERE, "size": (robot.radius, 0.0, 0.0), "pos": (0.0, 0.0, WALL_HEIGHT / 2)}
    base.add_geom(**ball, contype=0, conaffinity=_WALL_GROUP, condim=1, mass=0.0, group=_HIDDEN)
    camera, visual = robot.camera, model.visual
    orientation = {"quat": (0.5, 0.5, -0.5, -0.5), "fovy": math.degrees(camera.field_of_view)}  # it looks along x
    base.add_camera(name="camera", pos=camera.position, **orientation)
    model.stat.extent = 1.0  # so that the range of the camera is in metres
    visual.map.znear, visual.map.zfar, visual.quality.offsamples = *camera.range, 0  # no depth is a mean of samples
    light = visual.headlight
    light.ambient, light.diffuse, light.specular = (0.8, 0.8, 0.8), (0.2, 0.2, 0.2), (0.0, 0.0, 0.0)
    return model


@cache
def _load_on_wheels(robot: Robot) -> float:
    """Share of the robot's weight on its two wheels, if the wheels and each caster on the floor carry the same.

    In PyBullet it is 49 % for the TurtleBots. It scales the friction of the wheels, because MuJoCo would put the whole
    weight on the wheels as soon as they need grip, with casters too.
    """
    model = MjSpec.from_file(str(robot.urdf))
    floor = model.worldbody.add_geom(type=mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 1.0), name="floor")
    compiled = model.compile()
    data, wheels = mujoco.MjData(compiled), [compiled.joint(name).bodyid[0] for name in robot.wheel_joints]
    mujoco.mj_kinematics(compiled, data)
    casters = [
        shape
        for shape in range(compiled.ngeom)
        if shape != floor.id
        and compiled.geom_bodyid[shape] not in wheels
        and mujoco.mj_geomDistance(compiled, data, shape, floor.id, 1.0, None) < _CASTER_GAP
    ]
    return 2.0 / (2 + len(casters))


def _wheel_body(model: MjSpec, robot: Robot, joint_name: str) -> str:
    """Name of the body at a wheel's joint, whose damping and torque limit are removed."""
    joint = model.joint(joint_name)
    if joint is None:
        known = ", ".join(joint.name for joint in model.joints)
        raise InputError(f"robot {robot.name}: {robot.urdf} has no joint {joint_name!r}; it has {known}")
    joint.actfrclimited, joint.frictionloss, joint.damping = False, 0.0, np.zeros_like(joint.damping)
    return joint.parent.name


def _add_motors(model: MjSpec, robot: Robot) -> None:
    """Add velocity motors, for `set_time_step`."""
    for name in robot.wheel_joints:
        motor = model.add_actuator(name=name, target=name, trntype=mjtTrn.mjTRN_JOINT)
        motor.gaintype, motor.biastype = mjtGain.mjGAIN_FIXED, mjtBias.mjBIAS_AFFINE
        motor.forcelimited, motor.forcerange = True, (-robot.wheel_torque, robot.wheel_torque)


def _add_world(model: MjSpec, world: World) -> None:
    floor = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.0, 0.0, 1.0), "rgba": FLOOR_COLOUR}
    model.worldbody.add_geom(**floor, contype=_FLOOR_GROUP, conaffinity=0)
    half_height, wall = WALL_HEIGHT / 2, {**_HARD, "rgba": WALL_COLOUR, "margin": _MARGIN}
    for x, y, half_length, half_width, cos, sin in world.boxes.tolist():
        box = {"type": mjtGeom.mjGEOM_BOX, "size": (half_length, half_width, half_height), "quat": quaternion(cos, sin)}
        model.worldbody.add_geom(**box, pos=(x, y, half_height), **wall)
    for x, y, radius in world.posts.tolist():
        post = {"type": mjtGeom.mjGEOM_CYLINDER, "size": (radius, half_height, 0.0)}
        model.worldbody.add_geom(**post, pos=(x, y, half_height), **wall)


def _add_obstacle(model: MjSpec, length: float, width: float) -> None:
    shape, size = mjtGeom.mjGEOM_BOX, (length, width, WALL_HEIGHT / 2)
    if width == 0.0:
        shape, size = mjtGeom.mjGEOM_CYLINDER, (length, WALL_HEIGHT / 2, 0.0)
    model.worldbody.add_body(mocap=True).add_geom(type=shape, size=size, **_HARD, rgba=OBSTACLE_COLOUR)


def quaternion(cos: float, sin: float) -> tuple[float, float, float, float]:
    """MuJoCo's quaternion w, x, y, z of a yaw, given by its cosine and sine."""
    half_yaw = math.atan2(sin, cos) / 2
    return math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)
