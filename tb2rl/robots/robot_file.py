"""Files with a robot of one's own, from `python -m tb2rl.calibrate`: changes of a built-in robot, and its variation.

    robot: {base: turtlebot2, max_speed: 0.58}
    variation: {wheel_radius: [0.99, 1.0], bias: [0.01, 0.02]}
    latency: [0.1, 0.12]  # [s] of commands
    observation_latency: [0.05, 0.06]  # [s] of scans

`task.robot` and `task.variation` take the path of such a file, or the values in it. A config stores the values, so that
a run does not need the file.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Le

from tb2rl.core.files import read_yaml
from tb2rl.core.trust import check_file_allowed
from tb2rl.core.values import ASCENDING, PAIR, NonNegative, build

ROBOT_SUFFIXES = (".yaml", ".yml")
_Seconds = Annotated[tuple[Annotated[NonNegative, Le(2)], Annotated[NonNegative, Le(2)]], PAIR, ASCENDING]
_TOLERANCE = 0.02  # [control steps] a latency that is longer by less takes no further step


@dataclass(frozen=True)
class RobotFile:
    """The content of a file; its values are checked where they are used."""

    robot: dict[str, Any]
    variation: dict[str, Any] = field(default_factory=dict)
    latency: _Seconds = (0.0, 0.0)  # [s]
    observation_latency: _Seconds = (0.0, 0.0)  # [s]

    def variation_in_steps(self, control_period: float) -> dict[str, Any]:
        """The setting `task.variation`, with latencies in control steps of some length [s]."""
        ranges: dict[str, Any] = dict(self.variation)
        for name in ("latency", "observation_latency"):
            low, high = (seconds / control_period for seconds in getattr(self, name))
            ranges[name] = [math.floor(low + _TOLERANCE), math.ceil(high - _TOLERANCE)]
        return ranges


def is_robot_file(setting: Any) -> bool:
    """Whether a setting is the path of a robot file."""
    return isinstance(setting, str) and setting.endswith(ROBOT_SUFFIXES)


def read_robot_file(path: str) -> RobotFile:
    """Read a robot file.

    Raises:
        InputError: If it cannot be read, or has an unknown key or a wrong type.
    """
    check_file_allowed(path)
    return build(RobotFile, read_yaml(Path(path)), path)


def robot_setting(setting: Any) -> Any:
    """The setting `task.robot`, with the values of a file in place of its path."""
    return read_robot_file(setting).robot if is_robot_file(setting) else setting


def variation_setting(setting: Any, control_period: float) -> Any:
    """The setting `task.variation`, with the values of a file in place of its path."""
    if not is_robot_file(setting):
        return setting
    return read_robot_file(setting).variation_in_steps(control_period)


def split_base(setting: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The name of the built-in robot that a setting changes, and the changes."""
    return str(setting.get("base", "turtlebot2")), {key: value for key, value in setting.items() if key != "base"}
