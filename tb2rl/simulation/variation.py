"""Variation of the robot from episode to episode (domain randomisation).

Peng et al. 2018, "Sim-to-real transfer of robotic control with dynamics randomization": a policy that drives well with
many simulated robots is more likely to drive well with a real robot.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, TypeVar

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.errors import unknown
from tb2rl.core.values import ASCENDING, PAIR, Fraction, NonNegative, build
from tb2rl.simulation.random_streams import RandomSource
from tb2rl.simulation.spec import InitialState

T = TypeVar("T")
Range = Annotated[tuple[T, T], PAIR, ASCENDING]  # ends of a uniform distribution; a single number stands for both ends
Ratio = Annotated[float, Ge(0.5), Le(2)]
WideRatio = Annotated[float, Ge(0.1), Le(10)]
Length = Annotated[float, Ge(-0.5), Le(0.5)]
Angle = Annotated[float, Ge(-math.pi), Le(math.pi)]
Steps = Annotated[int, Ge(0), Le(10)]


@dataclass(frozen=True)
class Variation:
    """Ranges of the parameters of an episode's robot; the defaults are the nominal robot.

    Wheels that are not nominal move the robot differently for the same command, and cause errors of the odometry (see
    `tb2rl.simulation.odometry`).
    """

    wheel_radius: Range[Ratio] = (1.0, 1.0)  # true / nominal
    wheel_separation: Range[Ratio] = (1.0, 1.0)  # true / nominal
    odometry: Range[Ratio] = (1.0, 1.0)  # measured / true distance of each wheel, if the wheel radius is nominal
    acceleration: Range[Ratio] = (1.0, 1.0)  # acceleration by the motors, true / nominal
    mass: Range[WideRatio] = (1.0, 1.0)  # true / nominal, in physics only
    friction: Range[WideRatio] = (1.0, 1.0)  # friction of the wheels on the floor, true / nominal, in physics only
    laser_noise: Range[NonNegative] | None = None  # [m] standard deviation of the laser; None: the task's `laser_noise`
    bias: Range[Length] = (0.0, 0.0)  # [m] added to all ranges
    dropped: Range[Fraction] = (0.0, 0.0)  # share of beams that return inf
    mount_x: Range[Length] = (0.0, 0.0)  # [m] x of the laser in its nominal frame
    mount_y: Range[Length] = (0.0, 0.0)  # [m] y of the laser in its nominal frame
    mount_yaw: Range[Angle] = (0.0, 0.0)  # [rad] yaw of the laser in its nominal frame
    latency: Range[Steps] = (0, 0)  # [control steps] until a command takes effect
    observation_latency: Range[Steps] = (0, 0)  # [control steps] until a robot state is observed
    gyro: Range[Ratio] = (1.0, 1.0)  # turn measured by the gyro / true turn, for robots with a gyro

    def vary(self, initial_state: InitialState, random: RandomSource) -> None:
        """Draw the parameters of the robots and write them into the initial states, in place.

        The number of draws does not depend on the ranges, so that a change of one range leaves the other parameters as
        they are. Without any variation nothing is drawn.
        """
        if self == NONE:
            return
        records = initial_state.records
        numbers = iter(random.uniform(len(fields(self)) + 1).T)  # one more than fields, because odometry takes two

        def draw(limits: tuple[float, float]) -> np.ndarray:
            low, high = limits
            return low + (high - low) * next(numbers)

        records["wheel_radius"] = draw(self.wheel_radius)
        separation = draw(self.wheel_separation)
        records["wheel_separation"] *= separation
        records["assumed_separation"] = 1.0 / separation
        records["left_encoder"], records["right_encoder"] = draw(self.odometry), draw(self.odometry)
        acceleration = draw(self.acceleration)
        records["wheel_acceleration"] *= acceleration
        records["wheel_coupling"] *= acceleration
        for name in ("mass", "friction", "laser_noise", "bias", "dropped", "mount_x", "mount_y", "mount_yaw"):
            drawn = draw(getattr(self, name) or (0.0, 0.0))
            if getattr(self, name) is not None:
                records[name] = drawn
        for name, (low, high) in (("command_latency", self.latency), ("observation_latency", self.observation_latency)):
            records[name] = np.floor(draw((low, high + 1)))
        records["gyro"] *= draw(self.gyro)


NONE = Variation()
_MILD_AND_STRONG: dict[str, tuple[tuple[Any, Any], tuple[Any, Any]]] = {  # sources: tb2rl/robots/README.md
    "wheel_radius": ((0.99, 1.01), (0.97, 1.03)),
    "wheel_separation": ((0.99, 1.01), (0.95, 1.05)),
    "odometry": ((0.998, 1.002), (0.99, 1.01)),
    "acceleration": ((0.9, 1.1), (0.8, 1.2)),
    "mass": ((0.9, 1.1), (0.9, 1.8)),
    "friction": ((0.8, 1.0), (0.4, 1.0)),
    "laser_noise": ((0.0, 0.01), (0.0, 0.03)),
    "bias": ((-0.01, 0.01), (-0.03, 0.03)),
    "dropped": ((0.0, 0.01), (0.0, 0.05)),
    "mount_x": ((-0.005, 0.005), (-0.02, 0.02)),
    "mount_y": ((-0.005, 0.005), (-0.02, 0.02)),
    "mount_yaw": ((-0.02, 0.02), (-0.05, 0.05)),
    "latency": ((0, 1), (0, 1)),
    "observation_latency": ((0, 0), (0, 1)),
    "gyro": ((0.998, 1.002), (0.99, 1.01)),
}
_MILD, _STRONG = ({name: ranges[k] for name, ranges in _MILD_AND_STRONG.items()} for k in (0, 1))
PRESETS = {"none": NONE, "mild": Variation(**_MILD), "strong": Variation(**_STRONG)}


def find_variation(setting: Any) -> Variation:
    """Parse the setting `task.variation`: the name of a preset, or a mapping of changed ranges.

    The key "preset" of the mapping is the name of the changed preset (default: "none").

    Raises:
        InputError: If a preset or a key is unknown, or a range is invalid.
    """
    changes = dict(setting) if isinstance(setting, Mapping) else {"preset": setting}
    preset = changes.pop("preset", "none")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise unknown("preset of task.variation:", preset, PRESETS)
    return build(Variation, {**asdict(PRESETS[preset]), **changes}, "task.variation")


def describe_variation(setting: Any) -> str:
    """Describe the setting `task.variation` for titles, as "strong variation", or an empty string without variation."""
    variation = find_variation(setting)
    for name, preset in PRESETS.items():
        if variation == preset:
            return "" if preset == NONE else f"{name} variation"
    preset_name = setting.get("preset", "none")
    preset_ranges = asdict(PRESETS[preset_name])
    changes = {name: limits for name, limits in asdict(variation).items() if limits != preset_ranges[name]}
    if preset_name == "none":
        return f"variation of {', '.join(changes)}"
    ranges = (f"{name.replace('_', ' ')} {_describe_range(limits)}" for name, limits in changes.items())
    return f"{preset_name} variation, but {', '.join(ranges)}"


def _describe_range(limits: tuple[float, float] | None) -> str:
    """Describe a range as "0 to 1", or as one number if its ends are equal."""
    if limits is None:
        return "of the task"
    low, high = limits
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
