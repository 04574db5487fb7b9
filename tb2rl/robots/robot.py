"""A robot with two driven wheels, a laser scanner and a camera.

Frames and units follow REP 103: x forward, y left, angles counter-clockwise; metres, radians, seconds. The origin of
the robot's frame is on the floor under the middle of the axle.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import StrictFloat, StrictInt

from tb2rl.core import InputError, find_plugin, unknown
from tb2rl.core.values import build, checked
from tb2rl.robots.robot_file import robot_setting, split_base

Positive = Annotated[StrictFloat, Gt(0)]  # strict, because `_check` discards converted values


CHANGEABLE = ("max_speed", "max_turn_rate", "laser")  # fields that a robot file can change
_URDF_TOLERANCE = 0.01  # allowed relative difference between a robot's parameters and its URDF file


@dataclass(frozen=True)
class Laser:
    """A planar laser scanner above the middle of the axle.

    The beams go from right to left, with one at each end of the field of view; a single beam looks ahead. On a full
    circle the beams have equal gaps and one looks ahead; if their number is even, the first looks back.
    """

    beams: Annotated[StrictInt, Ge(1)] = 720  # number of beams
    indices: tuple[int, ...] | None = None  # indices of the selected beams, from right to left; None: all
    noise: Annotated[StrictFloat, Ge(0)] = 0.0  # [m] standard deviation of the Gaussian noise on finite ranges
    field_of_view: Annotated[Positive, Le(math.tau)] = math.pi  # [rad] angle from the first beam to the last
    min_range: Annotated[StrictFloat, Ge(0)] = 0.1  # [m] shortest measured range
    max_range: Positive = 30.0  # [m] longest measured range; without a hit the range is inf (REP 117)

    @cached_property
    def angles(self) -> np.ndarray:
        """Directions of the selected beams in the robot's frame [rad], shape (selected beams,), ascending."""
        if self.field_of_view == math.tau or self.beams == 1:  # one of the beams looks ahead
            angles = (np.arange(self.beams) - self.beams // 2) * self.field_of_view / self.beams
        else:
            angles = np.linspace(-self.field_of_view / 2, self.field_of_view / 2, self.beams)
        return angles if self.indices is None else angles[list(self.indices)]


@dataclass(frozen=True)
class Camera:
    """A colour and depth camera that looks along x."""

    position: tuple[StrictFloat, StrictFloat, StrictFloat]  # [m] in the robot's frame
    field_of_view: Annotated[Positive, Lt(math.pi)]  # [rad] vertical
    range: tuple[Positive, Positive]  # [m] least and largest depth


@dataclass(frozen=True)
class Robot:
    """A differential drive.

    The kinematic simulator uses only the numbers, physics also the URDF file, so the two must agree.
    """

    name: str
    urdf: Path  # file whose base link has the robot's frame
    wheel_joints: tuple[str, str]  # names of the left and the right joint in the URDF file
    radius: Positive  # [m] of the round base, which touches obstacles
    wheel_radius: Positive  # [m] radius of the wheels
    wheel_separation: Positive  # [m] distance between the wheels
    wheel_torque: Positive  # [N m] largest torque of a wheel's motor
    max_speed: Positive  # [m/s] largest speed
    max_turn_rate: Positive  # [rad/s] largest turn rate
    # Measured in PyBullet, or MuJoCo, by `tb2rl.simulation.motors.measure_motors`:
    wheel_acceleration: Positive  # [m/s^2] acceleration of a wheel's rim by its own motor
    wheel_coupling: StrictFloat  # [m/s^2] added if the other motor pushes the same way, subtracted if the opposite way
    laser: Laser
    camera: Camera
    gyro: bool = True  # whether odometry has a gyro's heading; an encoder heading drifts ten times as fast
    # Defaults of this robot for fields of `tb2rl.tasks.Task`; explicit settings override them:
    task_settings: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def clip_commands(self, commands: np.ndarray) -> np.ndarray:
        """Commands v [m/s] and w [rad/s], shape (..., 2), clipped to the robot's limits."""
        limits = np.array([self.max_speed, self.max_turn_rate])
        return np.clip(commands, -limits, limits)

    def check_wheels(self, left: Sequence[float], right: Sequence[float]) -> None:
        """Compare the wheels in the URDF file with the parameters, which the kinematic simulator uses.

        Args:
            left, right: Centre of each wheel in the robot's frame: x, y, z [m]. The origin of the frame is on the
                floor, so the height of the centre is the radius of the wheel.

        Raises:
            InputError: If the wheels are exchanged, or differ from the parameters by more than 1 %.
        """
        (_, left_y, height), (_, right_y, other_height) = left, right
        if not left_y > 0.0 > right_y:
            first, second = self.wheel_joints
            found = f"{first!r} is at y = {left_y:.4g} m, {second!r} at y = {right_y:.4g} m"
            rule = "wheel_joints must be the left wheel (y > 0) and the right wheel"
            raise InputError(f"robot {self.name}: {rule}; {found}")
        in_urdf = ("wheel_separation", left_y - right_y), ("wheel_radius", height), ("wheel_radius", other_height)
        for name, urdf_value in in_urdf:
            value = getattr(self, name)
            if abs(value - urdf_value) > _URDF_TOLERANCE * abs(urdf_value):
                raise InputError(f"robot {self.name}: {name} is {value:.4g} m, but {urdf_value:.4g} m in {self.urdf}")


def find_robot(name: str | Mapping[str, Any]) -> Robot:
    """Find a robot by its name, "module:ROBOT", the path of a robot file, or the changes in one.

    Raises:
        InputError: If there is no such robot, or one of its numbers is invalid.
    """
    name = robot_setting(name)
    if isinstance(name, Mapping):
        return _changed(*split_base(name))
    found = find_plugin("robot", name)
    if not isinstance(found, Robot):
        raise InputError(f"robot {name!r} is not a tb2rl.robots.Robot")
    _check(found)
    return found


def _changed(base: str, changes: Mapping[str, Any]) -> Robot:
    """A copy of a robot with changed numbers, and a changed laser."""
    robot, laser = find_robot(base), changes.get("laser", {})
    for key in [key for key in changes if key not in CHANGEABLE]:
        raise unknown("key of a robot file's robot:", key, ["base", *CHANGEABLE])
    if laser:
        laser = {
            "laser": build(Laser, {**asdict(robot.laser), **laser} if isinstance(laser, Mapping) else laser, "laser")
        }
    numbers = {key: checked(Positive, value, f"robot.{key}") for key, value in changes.items() if key != "laser"}
    changed = replace(robot, **numbers, **(laser or {}))
    _check(changed)
    return changed


@cache  # because a check takes a fifth of the time in which an environment opens
def _check(robot: Robot) -> None:
    build(type(robot), asdict(robot), f"robot {robot.name}")  # only checks the values; the copy is not used
    laser = robot.laser
    for name, (low, high) in {"laser": (laser.min_range, laser.max_range), "camera": robot.camera.range}.items():
        if low >= high:
            raise InputError(f"robot {robot.name}.{name}: the minimum must be below the maximum, got {low}, {high}")
