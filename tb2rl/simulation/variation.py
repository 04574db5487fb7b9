"""How robots differ from the one that their numbers describe: in each episode, and each robot in its own way.

Domain randomisation (Peng et al. 2018, "Sim-to-real transfer of robotic control with dynamics randomization"): what
drives well with all of these robots, is more likely to drive well with a real one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.errors import InputError, unknown
from tb2rl.core.values import ASCENDING, PAIR, Fraction, NonNegative, build
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.random_streams import Draws

# Each is a range that a number is drawn from, evenly; a number alone stands for itself.
_Share = Annotated[float, Ge(0.5), Le(2)]
_Length = Annotated[float, Ge(-0.5), Le(0.5)]
_Angle = Annotated[float, Ge(-math.pi), Le(math.pi)]
_Steps = Annotated[int, Ge(0), Le(10)]
Shares = Annotated[tuple[_Share, _Share], PAIR, ASCENDING]
Weights = Annotated[tuple[Annotated[float, Ge(0.1), Le(10)], Annotated[float, Ge(0.1), Le(10)]], PAIR, ASCENDING]
Lengths = Annotated[tuple[_Length, _Length], PAIR, ASCENDING]
Angles = Annotated[tuple[_Angle, _Angle], PAIR, ASCENDING]
Fractions = Annotated[tuple[Fraction, Fraction], PAIR, ASCENDING]
Deviations = Annotated[tuple[NonNegative, NonNegative], PAIR, ASCENDING]
Latency = Annotated[tuple[_Steps, _Steps], PAIR, ASCENDING]


@dataclass(frozen=True)
class Variation:
    """The ranges that an episode's robot is drawn from; without arguments it is always the same robot.

    Wheels that are not what they should be make the robot drive otherwise than it is told, and its odometry, which
    does not know of it, say otherwise than it drove; see `tb2rl.simulation.odometry`.
    """

    wheel_radius: Shares = (1.0, 1.0)  # times the robot's own
    wheel_separation: Shares = (1.0, 1.0)  # times its own
    odometry: Shares = (1.0, 1.0)  # way that an encoder counts over the true one, drawn for each wheel
    acceleration: Shares = (1.0, 1.0)  # of the motors, times its own
    mass: Weights = (1.0, 1.0)  # times its own; in PyBullet alone
    friction: Weights = (1.0, 1.0)  # of the wheels on the floor, times its own; in PyBullet alone
    laser_noise: Deviations | None = None  # [m] standard deviation of the laser; None: the task's `laser_noise`
    bias: Lengths = (0.0, 0.0)  # [m] added to all ranges
    dropped: Fractions = (0.0, 0.0)  # share of beams that come back empty: inf, as if nothing was there
    mount_x: Lengths = (0.0, 0.0)  # [m] how far the laser is ahead of where it should be
    mount_y: Lengths = (0.0, 0.0)  # [m] to the left
    mount_yaw: Angles = (0.0, 0.0)  # [rad] turned to the left
    latency: Latency = (0, 0)  # [control steps] until a command is obeyed
    observation_latency: Latency = (0, 0)  # [control steps] until a reading is observed
    gyro: Shares = (1.0, 1.0)  # turn that it counts over the true one, of a robot that has one

    def vary(self, initial_state: InitialState, draws: Draws) -> None:
        """Write what differs into the start of some robots' episodes: in place, and nothing is drawn for nothing.

        As many numbers are drawn whatever varies: so a changed range changes no other number.
        """
        if self == NONE:
            return
        rows, numbers = initial_state.rows, iter(draws.uniform(len(fields(self)) + 1).T)  # two for odometry
        rows["wheel_radius"] = _between(self.wheel_radius, next(numbers))
        separation = _between(self.wheel_separation, next(numbers))
        rows["wheel_separation"] *= separation
        rows["assumed_separation"] = 1.0 / separation
        for encoder in ("left_encoder", "right_encoder"):
            rows[encoder] = _between(self.odometry, next(numbers))
        acceleration = _between(self.acceleration, next(numbers))
        rows["wheel_acceleration"] *= acceleration
        rows["wheel_coupling"] *= acceleration
        for name in ("mass", "friction", "laser_noise", "bias", "dropped", "mount_x", "mount_y", "mount_yaw"):
            drawn, limits = next(numbers), getattr(self, name)
            if limits is not None:
                rows[name] = _between(limits, drawn)
        for name, (low, high) in (("command_latency", self.latency), ("observation_latency", self.observation_latency)):
            rows[name] = np.floor(low + (high + 1 - low) * next(numbers))
        rows["gyro"] *= _between(self.gyro, next(numbers))


NONE = Variation()
# Where the numbers come from: see tb2rl/robots/README.md.
PRESETS = {
    "none": NONE,
    "mild": Variation(
        wheel_radius=(0.99, 1.01),
        wheel_separation=(0.99, 1.01),
        odometry=(0.998, 1.002),
        acceleration=(0.9, 1.1),
        mass=(0.9, 1.1),
        friction=(0.8, 1.0),
        laser_noise=(0.0, 0.01),
        bias=(-0.01, 0.01),
        dropped=(0.0, 0.01),
        mount_x=(-0.005, 0.005),
        mount_y=(-0.005, 0.005),
        mount_yaw=(-0.02, 0.02),
        latency=(0, 1),
        gyro=(0.998, 1.002),
    ),
    "strong": Variation(
        wheel_radius=(0.97, 1.03),
        wheel_separation=(0.95, 1.05),
        odometry=(0.99, 1.01),
        acceleration=(0.8, 1.2),
        mass=(0.9, 1.8),
        friction=(0.4, 1.0),
        laser_noise=(0.0, 0.03),
        bias=(-0.03, 0.03),
        dropped=(0.0, 0.05),
        mount_x=(-0.02, 0.02),
        mount_y=(-0.02, 0.02),
        mount_yaw=(-0.05, 0.05),
        latency=(0, 1),
        observation_latency=(0, 1),
        gyro=(0.99, 1.01),
    ),
}


def find_variation(setting: Any) -> Variation:
    """What `task.variation` means: a preset's name, or what is to be otherwise than in one ("preset", else "none").

    Raises:
        InputError: For an unknown preset or key, or a range that does not fit.
    """
    changes = setting if isinstance(setting, Mapping) else {"preset": setting}
    preset = changes.get("preset", "none")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise unknown("preset of task.variation:", preset, PRESETS)
    others = {key: value for key, value in changes.items() if key != "preset"}
    if not all(isinstance(key, str) for key in others):
        raise InputError(f"task.variation: a key must be the name of what varies, got {list(others)}")
    return build(Variation, {**asdict(PRESETS[preset]), **others}, "task.variation")


def varied(setting: Any) -> str:
    """What `task.variation` means, for titles and tables: "strong variation"; "": nothing varies."""
    variation = find_variation(setting)
    if variation == NONE:
        return ""
    if variation in PRESETS.values():
        return next(f"{name} variation" for name, preset in PRESETS.items() if preset == variation)
    base = setting.get("preset", "none")
    others = [it.name for it in fields(Variation) if getattr(variation, it.name) != getattr(PRESETS[base], it.name)]
    names = ", ".join(others)
    return f"variation of {names}" if base == "none" else f"{base} variation with other {names}"


def _between(span: tuple[float, float], shares: np.ndarray) -> np.ndarray:
    """Numbers that lie at these shares, in [0, 1), of the way from the lowest to the highest."""
    low, high = span
    return low + (high - low) * shares
