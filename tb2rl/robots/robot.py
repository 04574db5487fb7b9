"""A robot with two driven wheels, a laser scanner and a camera, as plain numbers.

Frames follow REP 103: x forward, y left, angles counter-clockwise, metres, radians and seconds throughout. The origin
of the robot's frame lies on the floor under the middle of the axle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import Strict

from tb2rl.core.errors import InputError
from tb2rl.core.values import build

# The columns of a robot's parameters, which the compiled kernels read: one row for each robot.
RADIUS, WHEEL_SEPARATION, MAX_SPEED, MAX_TURN_RATE, WHEEL_ACCELERATION, WHEEL_COUPLING = range(6)

Number = Annotated[float, Strict()]  # and no string that reads like one: the kernels take it as it is
Above0 = Annotated[Number, Gt(0)]


@dataclass(frozen=True)
class Laser:
    """A planar laser scanner above the middle of the axle; its beams sweep from right to left, both ends included.

    Of a full circle both ends are one beam: an even number of beams begins with the one that looks back.
    """

    beams: Annotated[int, Strict(), Ge(1)] = 720
    indices: tuple[int, ...] | None = None  # the beams that are read, counted from the right; None: all
    noise: Annotated[Number, Ge(0)] = 0.0  # [m] standard deviation of the Gaussian on every finite reading
    field_of_view: Annotated[Above0, Le(math.tau)] = math.pi  # [rad]
    min_range: Annotated[Number, Ge(0)] = 0.1  # [m]
    max_range: Above0 = 30.0  # [m] nothing within: the reading is inf (REP 117)

    @cached_property
    def angles(self) -> np.ndarray:
        """Directions of the beams that are read, in the robot's frame [rad], shape (beams,), ascending."""
        half = self.field_of_view / 2
        if self.field_of_view == math.tau or self.beams == 1:  # one beam looks ahead, the others lie around it
            angles = (np.arange(self.beams) - self.beams // 2) * self.field_of_view / self.beams
        else:
            angles = np.linspace(-half, half, self.beams)
        return angles if self.indices is None else angles[list(self.indices)]


@dataclass(frozen=True)
class Camera:
    """A colour and depth camera that looks along x."""

    position: tuple[Number, Number, Number]  # [m] in the robot's frame
    field_of_view: Annotated[Above0, Lt(math.pi)]  # [rad] vertical
    range: tuple[Above0, Above0]  # [m] nearest and farthest depth


@dataclass(frozen=True)
class Robot:
    """A differential drive.

    Both simulations drive it: PyBullet by its URDF file, the fast twin by the numbers alone. So the numbers must be
    those of the file.

    Attributes:
        name: What it is called.
        urdf: Its description for the physics; the base link's frame is the robot's frame.
        wheel_joints: The names of the left and the right wheel's joint in the file.
        radius: Of the round base [m]; what counts as touching a wall.
        wheel_radius: [m]
        wheel_separation: Between the wheels' middles, across the robot [m].
        wheel_torque: Largest torque of a wheel's motor [N m].
        max_speed: Fastest forward speed [m/s].
        max_turn_rate: Fastest turn [rad/s].
        wheel_acceleration: Of a wheel's rim whose motor pushes alone [m/s^2]; `tb2rl.simulation.motors.measure_motors`
            measures this and the next one in PyBullet.
        wheel_coupling: What a rim gains where both motors push the same way, and loses where they push against each
            other [m/s^2].
        laser: Its laser scanner.
        camera: Its camera.
        gyro: Whether its odometry turns as a gyro says, and not as its wheels count, which drift ten times as far.
        task_settings: What suits it in any task, fields of `tb2rl.tasks.Task` by name: they come along where a setting
            names the robot, before what is set beside it.
    """

    name: str
    urdf: Path
    wheel_joints: tuple[str, str]
    radius: Above0
    wheel_radius: Above0
    wheel_separation: Above0
    wheel_torque: Above0
    max_speed: Above0
    max_turn_rate: Above0
    wheel_acceleration: Above0
    wheel_coupling: Number
    laser: Laser
    camera: Camera
    gyro: bool = True
    task_settings: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @cached_property
    def parameters(self) -> np.ndarray:
        """The numbers that the compiled kernels need, in the order of the columns named above, shape (6,)."""
        speeds = (self.max_speed, self.max_turn_rate, self.wheel_acceleration, self.wheel_coupling)
        return np.array([self.radius, self.wheel_separation, *speeds])

    def within_limits(self, commands: np.ndarray) -> np.ndarray:
        """Commands (v [m/s], w [rad/s]) cut to what the base can do, shape (..., 2)."""
        fastest = (self.max_speed, self.max_turn_rate)
        return np.clip(commands, np.negative(fastest), fastest)


@cache  # it takes a fifth as long as to open an environment
def check_robot(robot: Robot) -> None:
    """Hold a robot against the types of its fields.

    Raises:
        InputError: If a number is a string, not finite, or too small or too large to be one of a robot.
    """
    build(type(robot), asdict(robot), f"robot {robot.name}")
    for name, (nearest, farthest) in {
        "laser.min_range and max_range": (robot.laser.min_range, robot.laser.max_range),
        "camera.range": robot.camera.range,
    }.items():
        if not nearest < farthest:
            raise InputError(
                f"robot {robot.name}.{name}: the first must be below the second, got {nearest}, {farthest}"
            )
