"""The recovery filter: a robot that stands for too long turns to free space and drives on.

Exported policies include this file, so it needs only Python 3.8 and numpy.

A policy can go on trying for ever where the safety filter stops it, such as before a gap. The recoveries of Nav2 (spin,
then drive on heading) end this from outside: the robot gets to another place, from which the policy finds another way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.envs.filters import Filter, SensedState

_STANDING_SPEED = 0.05  # [m/s] below which a robot stands
_TURN_RATE, _SPEED = 1.5, 0.4  # [rad/s], [m/s] of a recovery
_DRIVE_TIME = 1.5  # [s] for which a robot drives after its turn
_LEAST_TURN = 0.6  # [rad] because straight ahead is where it stands
_HALF_WINDOW = 0.44  # [rad] of the beams around a direction that count
_LEAST_ROOM, _MAX_ROOM = 0.6, 3.0  # [m] least range of a free direction, and range from which on all are equally free
_RECOVERY_STATE = "standing", "turn", "drive", "count", "recovers"  # attributes that last for the episode


class Recovery(Filter):
    """Turns a robot that stands for too long to the side with the most room, and drives it there.

    If there is no room, and each third time in an episode, it turns around. A robot with the command to stand may do
    so, and a recovery ends with it. This filter comes before `safety`, which keeps the robot from what its laser sees.

    Args:
        robot: Facts about the robot, see `tb2rl.envs.parts.robot_facts`.
        patience: Time for which a robot may stand [s].

    Raises:
        ValueError: If `patience` is not above 0.
    """

    acts_in_training = False  # it makes a robot reach more goals, but a policy that learns with it fewer

    def __init__(self, robot: Mapping[str, Any], patience: float = 4.0) -> None:
        if not 0.0 < patience < math.inf:
            raise ValueError(f"patience must be above 0 s, got {patience}")
        self._angles, self._period = np.array(robot["angles"], dtype=float), float(robot["control_period"])
        differences = np.abs(self._angles[:, None] - self._angles)
        self._windows = np.minimum(differences, math.tau - differences) <= _HALF_WINDOW
        self._is_aside = np.abs(self._angles) > _LEAST_TURN
        self._patience = max(1, round(patience / self._period))

    def reset(self, num_envs: int) -> None:  # numbers of control steps, but for the last two
        self._standing = np.zeros(num_envs, dtype=np.int64)  # for which the robot has stood
        self._turn = np.zeros(num_envs, dtype=np.int64)  # left to turn; negative: to the right
        self._drive = np.zeros(num_envs, dtype=np.int64)  # left to drive after the turn
        self._count = np.zeros(num_envs, dtype=np.int64)  # of the recoveries in this episode
        self._recovers = np.zeros(num_envs, dtype=bool)  # in the latest step

    def reset_at(self, indices: np.ndarray) -> None:
        for name in _RECOVERY_STATE:
            getattr(self, f"_{name}")[indices] = 0

    def state(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, f"_{name}").copy() for name in _RECOVERY_STATE}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        for name in _RECOVERY_STATE:
            setattr(self, f"_{name}", state[name].copy())

    def __call__(self, commands: np.ndarray, robot_state: SensedState) -> np.ndarray:
        """Replace the commands of recovering robots, see `Filter.__call__`."""
        may_stand = ~commands.any(axis=1)
        stands = (np.abs(robot_state.twist[:, 0]) < _STANDING_SPEED) & ~may_stand
        self._standing = np.maximum(self._standing + np.where(stands, 1, -2), 0)
        self._turn[may_stand] = self._drive[may_stand] = 0
        for i in np.flatnonzero(self._standing > self._patience):
            self._count[i] += 1
            direction = self._free_direction(robot_state.ranges[i], self._count[i])
            self._turn[i] = math.copysign(math.ceil(abs(direction) / _TURN_RATE / self._period), direction)
            self._drive[i] = math.ceil(_DRIVE_TIME / self._period)
        self._recovers = self._drive > 0
        if not self._recovers.any():
            return commands
        side = np.sign(self._turn)
        drives = self._recovers & (side == 0)
        recovery = np.column_stack([_SPEED * drives, _TURN_RATE * side])
        self._turn -= side
        self._drive -= drives
        self._standing[self._recovers] = 0
        return np.where(self._recovers[:, None], recovery, commands)

    def _free_direction(self, ranges: np.ndarray, count: int) -> float:
        """Direction with the most room [rad]; pi if there is none, or if it is time to turn around."""
        room = np.where(self._windows, np.minimum(ranges, _MAX_ROOM), _MAX_ROOM).min(axis=1)
        room[~self._is_aside] = 0.0
        best = int(room.argmax())
        return float(self._angles[best]) if count % 3 and room[best] >= _LEAST_ROOM else math.pi

    def reason(self, index: int) -> str:
        return "the robot has stood for too long" if self._recovers[index] else ""
