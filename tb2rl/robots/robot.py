"""A robot with two driven wheels, a laser scanner and a camera.

Frames and units follow REP 103: x forward, y left, angles counter-clockwise; metres, radians, seconds. The origin of
the robot's frame is on the floor under the middle of the axle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import StrictFloat, StrictInt

# Columns of `Robot.parameters`, for compiled code.
RADIUS, WHEEL_SEPARATION, MAX_SPEED, MAX_TURN_RATE, WHEEL_ACCELERATION, WHEEL_COUPLING = range(6)

Positive = Annotated[StrictFloat, Gt(0)]  # strict: compiled code takes no numeric strings


@dataclass(frozen=True)
class Laser:
    """A planar laser scanner above the middle of the axle.

    Its beams go from right to left, both ends included. On a full circle the ends are one beam, and an even number of
    beams starts with the one that looks back.
    """

    beams: Annotated[StrictInt, Ge(1)] = 720
    indices: tuple[int, ...] | None = None  # of the selected beams, from the right; None: all
    noise: Annotated[StrictFloat, Ge(0)] = 0.0  # [m] standard deviation of the Gaussian noise on finite ranges
    field_of_view: Annotated[Positive, Le(math.tau)] = math.pi  # [rad]
    min_range: Annotated[StrictFloat, Ge(0)] = 0.1  # [m]
    max_range: Positive = 30.0  # [m]; without a hit the range is inf (REP 117)

    @cached_property
    def angles(self) -> np.ndarray:
        """Directions of the selected beams in the robot's frame [rad], shape (beams,), ascending."""
        if self.field_of_view == math.tau or self.beams == 1:  # one beam looks ahead
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

    PyBullet reads the URDF file, the kinematic simulator the numbers alone, so both must agree.
    """

    name: str
    urdf: Path  # its base link has the robot's frame
    wheel_joints: tuple[str, str]  # of the left and the right wheel in the file
    radius: Positive  # [m] of the round base, which makes contact
    wheel_radius: Positive  # [m]
    wheel_separation: Positive  # [m] between the middles of the wheels
    wheel_torque: Positive  # [N m] largest torque of a wheel's motor
    max_speed: Positive  # [m/s]
    max_turn_rate: Positive  # [rad/s]
    # Measured in PyBullet by `tb2rl.simulation.bullet.motors.measure_motors`:
    wheel_acceleration: Positive  # [m/s^2] of a wheel's rim by its motor alone
    wheel_coupling: StrictFloat  # [m/s^2] added if the other motor pushes the same way, subtracted if the opposite way
    laser: Laser
    camera: Camera
    gyro: bool = True  # whether a gyro gives the heading of the odometry; encoders drift ten times as fast
    # Defaults of tasks with this robot, fields of `tb2rl.tasks.Task` by name; explicit settings override them:
    task_settings: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @cached_property
    def parameters(self) -> np.ndarray:
        """Parameters for compiled code, in the order of the columns named above, shape (6,)."""
        motors = self.max_speed, self.max_turn_rate, self.wheel_acceleration, self.wheel_coupling
        return np.array([self.radius, self.wheel_separation, *motors])

    def within_limits(self, commands: np.ndarray) -> np.ndarray:
        """Commands v [m/s] and w [rad/s], shape (..., 2), clipped to the robot's limits."""
        limits = np.array([self.max_speed, self.max_turn_rate])
        return np.clip(commands, -limits, limits)
