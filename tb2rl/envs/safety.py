"""The safety filter: slows a robot down, or stops it, before it can touch what its laser sees.

Exported policies include this file, so it needs only Python 3.8 and numpy; the kernel is in `safe_motion`.

A command is safe if the robot can hold it for a control period and then brake without coming closer to any point that
the laser hit than a margin. A robot inside the margin may turn and drive away, but not come closer. The filter predicts
this motion from the speeds of the wheels, which change only as fast as the motors allow. An unsafe command is replaced
by a slower one on the same arc, or with the same turn rate, or else by a stop. Admissible velocities are those of the
dynamic window approach (Fox, Burgard and Thrun 1997, "The dynamic window approach to collision avoidance"). Since every
command leaves room to brake, the robot never is in an inevitable collision state (Fraichard and Asama 2004).

The guarantee of the setting `guaranteed` assumes that obstacles are static and wider than the gap between two beams;
that the laser sees at least the half plane ahead; and that latencies, motors, and errors of the ranges stay within the
bounds that the filter was told. The setting `usual` takes means in place of bounds, and the median of three
neighbouring ranges in place of each one, so that noise does not slow a good policy down. Where a robot stands close to
an obstacle, sooner or later noise makes every range too long in one scan; so the filter can keep earlier scans, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.envs.filters import Filter, SensedState
from tb2rl.envs.safe_motion import NO_REASON, RobotModel, filter_commands, median_of_three

SETTINGS = "usual", "guaranteed"
REASONS = "", "an obstacle is in the way", "the laser does not see where the command leads"
_MAX_BEAM_GAP = math.radians(5.5)  # [rad] between neighbouring beams
_MAX_AGE = 0.5  # [s] of a scan; with an older one, drivers stop
_DRIVE_STEP = 0.05  # [s] between predicted poses before the robot brakes
_MAX_SCANS = 10
_STATE = "issued", "reasons", "kept_scans", "kept_poses"  # attributes that last for the episode


class Safety(Filter):
    """Slows a robot down, or stops it, before it can touch what its laser sees; never speeds it up.

    Args:
        robot: Facts about the robot, see `tb2rl.envs.parts.robot_facts`.
        setting: "usual" or "guaranteed".
        latency: Time until a command takes effect [s], in place of that of the setting.
        error: Amount by which a range can be too long [m], in place of that of the setting.
        margin: Gap that is kept to obstacles [m], in place of that of the setting.
        scans: Number of the latest scans whose points the robot avoids, at their places by the odometry.

    Raises:
        ValueError: If the setting is unknown, a number is out of range, or the laser does not fit.
    """

    def __init__(
        self,
        robot: Mapping[str, Any],
        setting: str = "usual",
        latency: float | None = None,
        error: float | None = None,
        margin: float | None = None,
        scans: int = 1,
    ) -> None:
        if setting not in SETTINGS:
            raise ValueError("setting must be {} or {}, got {!r}".format(*SETTINGS, setting))
        values: dict[str, Any] = dict(robot[setting])
        given = {"latency": latency, "error": error, "margin": margin}
        values.update({name: value for name, value in given.items() if value is not None})
        if not (0.0 <= values["latency"] <= 5.0 and values["margin"] >= 0.0):
            raise ValueError("latency must be from 0 to 5 s, and margin at least 0 m")
        if not 1 <= scans <= _MAX_SCANS:
            raise ValueError(f"scans must be from 1 to {_MAX_SCANS}, got {scans!r}")
        angles, period = np.array(robot["angles"], dtype=float), float(robot["control_period"])
        delays = list(np.arange(0.0, values["latency"], period)) if setting == "guaranteed" else []
        distance, drive_steps = robot["radius"] + values["error"], math.ceil(period / _DRIVE_STEP)
        half_field = _half_field_of_view(angles, setting)
        self._model = RobotModel(
            cos=np.cos(angles),
            sin=np.sin(angles),
            delays=np.array([*delays, values["latency"]]),
            accelerations=np.array(values["accelerations"]),
            braking=float(values["braking"]),
            drive_steps=drive_steps,
            drive_step=period / drive_steps,
            wheel_separation=float(robot["wheel_separation"]),
            inner=distance + 0.5 * values["margin"],
            outer=distance + values["margin"],
            half_field=half_field,
            edge=(math.cos(half_field), math.sin(half_field)),
        )
        self._takes_median, self._num_scans = setting == "usual", scans
        self._memory_length = 1 + math.ceil((values["latency"] + _MAX_AGE) / period)

    def reset(self, num_envs: int) -> None:
        self._issued = np.zeros((num_envs, self._memory_length, 2))  # v [m/s], w [rad/s] of commands, the newest first
        self._reasons = np.zeros(num_envs, dtype=np.int64)
        self._kept_scans = np.full((num_envs, self._num_scans, len(self._model.cos)), np.inf)  # [m] the newest first
        self._kept_poses = np.zeros((num_envs, self._num_scans, 3))  # x, y [m], yaw [rad] of these scans

    def reset_at(self, indices: np.ndarray) -> None:
        self._issued[indices], self._reasons[indices] = 0.0, NO_REASON
        if self._num_scans > 1:  # else they are those of the robot state, which is not the filter's to change
            self._kept_scans[indices] = np.inf

    def state(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, f"_{name}").copy() for name in _STATE}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        for name in _STATE:
            setattr(self, f"_{name}", state[name].copy())

    def __call__(self, commands: np.ndarray, robot_state: SensedState) -> np.ndarray:
        """Filter commands, see `Filter.__call__`."""
        ranges = median_of_three(robot_state.ranges) if self._takes_median else robot_state.ranges
        self._kept_scans = _prepend(ranges, self._kept_scans)
        self._kept_poses = _prepend(robot_state.pose, self._kept_poses)
        sensed = self._kept_scans, self._kept_poses, robot_state.twist, robot_state.age
        filtered, self._reasons = filter_commands(self._model, commands, *sensed, self._issued)
        self._issued = _prepend(filtered, self._issued)
        return filtered

    def reason(self, index: int) -> str:
        return REASONS[self._reasons[index]]


def _prepend(newest: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Values of the latest steps, the newest first, shape (num_envs, steps, ...): one is added, the oldest dropped."""
    return newest[:, None] if kept.shape[1] == 1 else np.concatenate((newest[:, None], kept[:, :-1]), axis=1)


def _half_field_of_view(angles: np.ndarray, setting: str) -> float:
    """Half of the field of view of beams [rad]; pi if they see all around."""
    field, gap = float(angles[-1] - angles[0]), float(np.diff(angles).max(initial=0.0))
    if len(angles) < 3 or gap > _MAX_BEAM_GAP:
        limit = math.degrees(_MAX_BEAM_GAP)
        raise ValueError(f"the safety filter needs a laser beam at least every {limit:g} degrees")
    if setting == "guaranteed" and field < math.pi - 1e-6:
        raise ValueError(f"the setting guaranteed needs a laser that sees 180 degrees, not {math.degrees(field):.0f}")
    return math.pi if field + gap > math.tau - 1e-6 else 0.5 * field
