"""Variation of the robot from episode to episode (domain randomisation).

Peng et al. 2018, "Sim-to-real transfer of robotic control with dynamics randomization": a policy that drives well with
all of these robots is more likely to drive well with a real one.
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

# Each is a range of a uniform distribution; a number alone is a range of that number.
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
    """Ranges of the parameters of an episode's robot; without arguments it is the nominal robot.

    Wheels that are not nominal change the motion for a command, and their odometry has errors, see
    `tb2rl.simulation.odometry`.
    """

    wheel_radius: Shares = (1.0, 1.0)  # true / nominal
    wheel_separation: Shares = (1.0, 1.0)  # true / nominal
    odometry: Shares = (1.0, 1.0)  # distance that an encoder counts / the true one, drawn for each wheel
    acceleration: Shares = (1.0, 1.0)  # of the motors, true / nominal
    mass: Weights = (1.0, 1.0)  # true / nominal; where the simulator varies dynamics
    friction: Weights = (1.0, 1.0)  # of the wheels on the floor, true / nominal; where the simulator varies dynamics
    laser_noise: Deviations | None = None  # [m] standard deviation of the laser; None: the task's `laser_noise`
    bias: Lengths = (0.0, 0.0)  # [m] added to all ranges
    dropped: Fractions = (0.0, 0.0)  # share of beams that return inf
    mount_x: Lengths = (0.0, 0.0)  # [m] true position of the laser ahead of the nominal one
    mount_y: Lengths = (0.0, 0.0)  # [m] to its left
    mount_yaw: Angles = (0.0, 0.0)  # [rad] its true yaw
    latency: Latency = (0, 0)  # [control steps] until a command takes effect
    observation_latency: Latency = (0, 0)  # [control steps] until a robot state is observed
    gyro: Shares = (1.0, 1.0)  # turn that it counts / the true one, for robots with a gyro

    def vary(self, initial_state: InitialState, draws: Draws) -> None:
        """Draw the parameters of robots and write them into their initial states, in place.

        The number of draws does not depend on the ranges, so that changing one range leaves the others as they are;
        without any variation nothing is drawn.
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
# For the sources of the numbers see tb2rl/robots/README.md.
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
    """The variation of the setting `task.variation`: the name of a preset, or changes of one ("preset", else "none").

    Raises:
        InputError: For an unknown preset or key, or a range that does not fit.
    """
    changes = setting if isinstance(setting, Mapping) else {"preset": setting}
    preset = changes.get("preset", "none")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise unknown("preset of task.variation:", preset, PRESETS)
    others = {key: value for key, value in changes.items() if key != "preset"}
    if not all(isinstance(key, str) for key in others):
        raise InputError(f"task.variation: a key must be a string, got {list(others)}")
    return build(Variation, {**asdict(PRESETS[preset]), **others}, "task.variation")


def varied(setting: Any) -> str:
    """The setting `task.variation` for titles and tables: "strong variation"; "": nothing varies."""
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
    """Interpolate between the ends of a range by shares in [0, 1)."""
    low, high = span
    return low + (high - low) * shares
