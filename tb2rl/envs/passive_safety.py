"""The passive safety filter: a robot stands before an obstacle that moves can arrive.

Exported policies include this file, so it needs only Python 3.8 and numpy; in tb2rl, `njit` compiles the kernel.

Nobody can avoid all contacts with people who do not care; but a robot that stands causes none (passive motion safety,
Macek et al. 2009, "Towards safe vehicle navigation in dynamic urban scenarios"). For the safety filter, this one
shortens the ranges of the laser to the places that moving obstacles can reach before the robot stands. A robot only
turns, or drives away, while such an obstacle can reach it.

A point that the laser hits moves if an earlier scan saw past it: space that was free has something in it now (Azim and
Aycard 2012, "Detection, classification and tracking of moving objects in a 3D environment"). Someone who comes closer
or crosses the way is found so by the front edge; who walks away is not, and need not be. People stop, too, so what is
near to a point that moved a few seconds ago counts as moving.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.envs.filters import SensedState
from tb2rl.envs.safe_motion import OBSTACLE
from tb2rl.envs.safety import Safety

_SCAN_AGE = 0.6  # [s] of the earlier scan
_LEAST_MOTION = 0.15  # [m] by which the earlier scan saw past a moving point
_MEMORY = 5.0  # [s] for which the places of moving points are remembered
_SAME_PLACE = 0.3  # [m] in x and y
_MAX_DISTANCE = 2.5  # [m] of points that may move; farther ones do not matter yet
_BEHIND = -0.3  # cosine of the direction of beams that do not matter to a robot that drives forward
_FAR = 1e9  # [m] nothing is there


class PassiveSafety(Safety):
    """The safety filter, which also stops a robot before a moving obstacle can arrive, if the laser saw it in time.

    Args:
        robot: Facts about the robot, see `tb2rl.envs.parts.robot_facts`.
        setting: "usual" or "guaranteed".
        latency: Time until a command takes effect [s], in place of that of the setting.
        error: Amount by which a range can be too long [m], in place of that of the setting.
        margin: Gap that is kept to obstacles [m], in place of that of the setting.
        obstacle_speed: Speed of moving obstacles [m/s].

    Raises:
        ValueError: As `Safety`, and if `obstacle_speed` is not above 0.
    """

    def __init__(
        self,
        robot: Mapping[str, Any],
        setting: str = "usual",
        latency: float | None = None,
        error: float | None = None,
        margin: float | None = None,
        obstacle_speed: float = 1.0,
    ) -> None:
        super().__init__(robot, setting, latency, error, margin)
        if not obstacle_speed > 0.0:
            raise ValueError(f"obstacle_speed must be above 0 m/s, got {obstacle_speed}")
        self._angles, self._obstacle_speed = np.array(robot["angles"], dtype=float), obstacle_speed
        period = float(robot["control_period"])
        # [s] A motion may begin just after a scan, so the robot begins to brake with the command after the next one.
        self._reaction_time = float(self._model.delays[-1]) + 2.0 * period
        self._num_scans, self._num_places = math.ceil(_SCAN_AGE / period), math.ceil(_MEMORY / period)

    def reset(self, num_envs: int) -> None:
        super().reset(num_envs)
        self._scans = np.zeros((num_envs, self._num_scans, len(self._angles)))  # [m], the newest first; 0: none yet
        self._poses = np.zeros((num_envs, self._num_scans, 3))  # of these scans
        self._places = np.full((num_envs, self._num_places, 2), _FAR)  # of the nearest moving points, x and y [m]

    def reset_at(self, indices: np.ndarray) -> None:
        super().reset_at(indices)
        self._scans[indices], self._places[indices] = 0.0, _FAR

    def state(self) -> dict[str, np.ndarray]:
        memory = {"scans": self._scans, "poses": self._poses, "places": self._places}
        return {**super().state(), **{name: array.copy() for name, array in memory.items()}}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        super().restore(state)
        self._scans, self._poses, self._places = (state[name].copy() for name in ("scans", "poses", "places"))

    def __call__(self, commands: np.ndarray, robot_state: SensedState) -> np.ndarray:
        """Filter commands, see `Filter.__call__`."""
        ranges, poses = np.array(robot_state.ranges, dtype=float), np.array(robot_state.pose, dtype=float)
        braking = np.abs(robot_state.twist[:, 0]) / (self._model.braking * self._model.accelerations[0])
        reaches = self._obstacle_speed * (robot_state.age + self._reaction_time + braking)
        self._places[:, 1:], self._places[:, 0] = self._places[:, :-1].copy(), _FAR
        shorter, earlier = ranges.copy(), (self._scans[:, -1], self._poses[:, -1])
        arguments = self._places, self._angles, reaches, self._model.outer
        is_ahead, is_behind = _shorten(shorter, ranges, poses, *earlier, *arguments).T
        stops = (is_ahead & (commands[:, 0] > 0.0)) | (is_behind & (commands[:, 0] < 0.0))
        self._scans = np.concatenate((ranges[:, None], self._scans[:, :-1]), axis=1)
        self._poses = np.concatenate((poses[:, None], self._poses[:, :-1]), axis=1)
        # Whoever stands close behind a robot must not hold it, nor let it come as close to what is ahead.
        drives_forward = np.minimum(commands[:, 0], robot_state.twist[:, 0]) > -0.01
        shorter[drives_forward[:, None] & (self._model.cos < _BEHIND)] = np.inf
        commands = np.where(stops[:, None], commands * (0.0, 1.0), commands)
        filtered = super().__call__(commands, robot_state._replace(ranges=shorter))
        self._reasons[stops] = OBSTACLE
        return filtered


@njit(cache=True, error_model="numpy")
def _shorten(shorter, ranges, poses, earlier_ranges, earlier_poses, places, angles, reaches, radius):
    """Shorten ranges to what moving points can reach, and store the nearest of these points in `places`.

    Args:
        shorter: The ranges that are shortened [m], shape (num_envs, beams).
        ranges, poses: The latest scans [m], and where they were made.
        earlier_ranges, earlier_poses: Earlier scans.
        places: Where points moved, the latest first, shape (num_envs, places, 2).
        angles: Of the beams, evenly spaced [rad].
        reaches: How far an obstacle can come before the robot stands [m], shape (num_envs,).
        radius: Of the robot, with the gap that it keeps [m].

    Returns:
        Whether a moving point in front of each robot, and one behind it, can arrive before it stands, (num_envs, 2).
    """
    can_arrive = np.zeros((len(ranges), 2), np.bool_)
    for i in range(len(ranges)):
        nearest, reach = _MAX_DISTANCE, float(reaches[i])
        for beam in range(len(angles)):
            distance, yaw = float(ranges[i, beam]), float(poses[i, 2] + angles[beam])
            if not distance < _MAX_DISTANCE:
                continue
            x, y = poses[i, 0] + distance * math.cos(yaw), poses[i, 1] + distance * math.sin(yaw)
            if _was_free(x, y, earlier_ranges[i], earlier_poses[i], angles):
                if distance < nearest:
                    nearest, places[i, 0, 0], places[i, 0, 1] = distance, x, y
            elif not _is_remembered(x, y, places[i]):
                continue
            if distance < radius + reach:
                can_arrive[i, int(math.cos(angles[beam]) < 0.0)] = True
                continue
            for other in range(len(angles)):
                cos, sin = math.cos(angles[other] - angles[beam]), math.sin(angles[other] - angles[beam])
                if cos > 0.0 and abs(distance * sin) < reach:  # the beam enters the disc around the point
                    entry = distance * cos - math.sqrt(reach * reach - distance * distance * sin * sin)
                    shorter[i, other] = min(shorter[i, other], entry)
    return can_arrive


@njit(cache=True, error_model="numpy")
def _was_free(x, y, ranges, pose, angles):
    """Whether both beams of an earlier scan nearest to the direction of a point x, y [m] saw past it."""
    dx, dy = x - pose[0], y - pose[1]
    distance, num_beams, spacing = math.sqrt(dx * dx + dy * dy), len(angles), angles[1] - angles[0]
    angle = math.atan2(dy, dx) - pose[2] - angles[0]
    before = int((angle - math.tau * math.floor(angle / math.tau)) / spacing)  # the last beam right of the point
    sees_all_around = (num_beams + 1) * spacing > math.tau
    for beam in (before, before + 1):
        if not (sees_all_around or 0 <= beam < num_beams):
            return False
        if ranges[beam % num_beams] < distance + _LEAST_MOTION:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _is_remembered(x, y, places):
    """Whether something moved near to x, y [m] lately."""
    for place in range(1, len(places)):
        if abs(places[place, 0] - x) < _SAME_PLACE and abs(places[place, 1] - y) < _SAME_PLACE:
            return True
    return False
