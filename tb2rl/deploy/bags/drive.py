"""A recorded drive: trajectory, commands, nearest ranges and contacts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tb2rl.core.values import Pose


@dataclass(frozen=True)
class Drive:
    """A drive; parts that the bag does not hold have no rows. Rows begin with the time since the first message [s].

    Attributes:
        name: Name of the bag.
        topics: Topics that were read, by the kinds of `tb2rl.deploy.bags.topics`.
        odometry: Time, x [m], y [m], yaw [rad], forward speed [m/s], turn rate [rad/s], shape (messages, 6).
        truth: The same, as a simulation knows it, in the world's frame.
        commands: Time, v [m/s], w [rad/s], shape (messages, 3).
        nearest: Time, shortest range of a scan [m], inf where nothing was in range; shape (messages, 2).
        touches: Time, whether the bumper was pressed, 1 or 0, shape (messages, 2).
        goals: Time, x [m], y [m], shape (messages, 3).
    """

    name: str
    topics: Mapping[str, str]
    odometry: np.ndarray
    truth: np.ndarray
    commands: np.ndarray
    nearest: np.ndarray
    touches: np.ndarray
    goals: np.ndarray

    @property
    def trajectory(self) -> np.ndarray:
        """The truth where it is known, else the odometry; rows as in `odometry`."""
        return self.truth if len(self.truth) else self.odometry

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.trajectory[-1, 0] - self.trajectory[0, 0])

    @property
    def distance(self) -> float:
        """Length of the path [m]."""
        return float(np.hypot(*np.diff(self.trajectory[:, 1:3], axis=0).T).sum())

    @property
    def speed(self) -> float:
        """Mean speed [m/s]; 0 without a duration."""
        return self.distance / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def closest(self) -> float:
        """Shortest range of all scans [m]; inf without scans."""
        return float(self.nearest[:, 1].min(initial=math.inf))

    @property
    def touched(self) -> int | None:
        """Number of contacts; None: no bumper was recorded."""
        if not len(self.touches):
            return None
        return int((np.diff(self.touches[:, 1], prepend=0.0) > 0.0).sum())

    def path_from(self, pose: Pose) -> np.ndarray:
        """Return the path x [m], y [m], shape (messages, 2), moved and rotated so that it begins at a pose."""
        _, x, y, yaw, *_ = self.trajectory[0].tolist()
        cos, sin = math.cos(pose[2] - yaw), math.sin(pose[2] - yaw)
        return (self.trajectory[:, 1:3] - (x, y)) @ np.array([(cos, sin), (-sin, cos)]) + pose[:2]
