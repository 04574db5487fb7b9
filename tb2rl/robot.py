"""What a TurtleBot2 is: its dimensions, its limits and its laser.

Dimensions follow the public `kobuki_description` and `turtlebot_description` packages; `assets/turtlebot2.urdf`
states the same numbers for the physics (a test holds the two together). Frames follow REP 103: x forward, y left,
angles counter-clockwise, metres, radians and seconds throughout.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

BASE_RADIUS = 0.178  # [m] kobuki_description, collision cylinder of the base
WHEEL_RADIUS = 0.035  # [m] kobuki_description
WHEEL_SEPARATION = 0.230  # [m] kobuki_description, wheel joints
WHEEL_TORQUE = 1.0  # [N m] kobuki_description, limit of the drive
MAX_SPEED = 0.65  # [m/s] turtlebot_description (the bare base: 0.70)
MAX_TURN_RATE = math.pi  # [rad/s] Kobuki user guide: 180 deg/s
LASER_NOISE = 0.01  # [m] standard deviation of a small Hokuyo, a realistic value for a task's `noise`
CAMERA_FIELD_OF_VIEW = math.radians(45.0)  # [rad] vertical, of the RGB-D sensor on the front
CAMERA_POSITION = (0.05, 0.0, 0.30)  # [m] in the base frame, looking along x
CAMERA_RANGE = (0.05, 8.0)  # [m] of the RGB-D sensor


@dataclass(frozen=True)
class Laser:
    """A planar laser scanner above the middle of the axle.

    Beams sweep from right to left and include both ends; the full scanner is the tutorial's: 720 beams, 180 degrees.
    """

    beams: int = 720
    kept: tuple[int, ...] | None = None  # indices of the beams that are read; None: all
    noise: float = 0.0  # [m] standard deviation of the Gaussian on every finite reading
    field_of_view: float = math.pi  # [rad]
    min_range: float = 0.1  # [m]
    max_range: float = 30.0  # [m] nothing within: the reading is inf (REP 117)

    @cached_property
    def angles(self) -> np.ndarray:
        """Directions of the kept beams in the base frame [rad], shape (kept beams,), ascending from the right."""
        half = self.field_of_view / 2
        angles = np.linspace(-half, half, self.beams) if self.beams > 1 else np.zeros(1)
        return angles if self.kept is None else angles[list(self.kept)]


def within_limits(commands: np.ndarray) -> np.ndarray:
    """Commands (v [m/s], w [rad/s]) cut to what the base can do, shape (..., 2)."""
    return np.clip(commands, (-MAX_SPEED, -MAX_TURN_RATE), (MAX_SPEED, MAX_TURN_RATE))


def wheel_rates(commands: np.ndarray) -> np.ndarray:
    """Wheel speeds (left, right) [rad/s] of a differential drive for commands (v, w), both shape (..., 2)."""
    v, w = commands[..., 0], commands[..., 1]
    reach = w * WHEEL_SEPARATION / 2
    return np.stack([v - reach, v + reach], axis=-1) / WHEEL_RADIUS
