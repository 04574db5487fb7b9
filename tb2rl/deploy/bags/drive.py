"""A recorded drive: trajectory, commands, shortest ranges and contacts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tb2rl.core.values import Pose


@dataclass(frozen=True)
class Drive:
    """A recorded drive. Each table has a row per message, or no rows if the bag lacks such messages.

    The first column of each table is the time since the first message [s].

    Attributes:
        name: Name of the bag.
        topics: The topics of the tables, by the kinds of `tb2rl.deploy.bags.topics.TOPIC_KINDS`.
        odometry: Time, x [m], y [m], yaw [rad], forward speed [m/s], turn rate [rad/s], shape (messages, 6).
        truth: True motion in the world's frame, from a simulation, with the columns of `odometry`.
        scan_minima: Time, shortest range of a scan [m], inf without an obstacle in range, shape (messages, 2).
        commands: Time, v [m/s], w [rad/s], shape (messages, 3).
        bumper: Time, 1 if the bumper is pressed, else 0, shape (messages, 2).
        goals: Time, x [m], y [m], shape (messages, 3).
    """

    name: str
    topics: Mapping[str, str]
    odometry: np.ndarray
    truth: np.ndarray
    scan_minima: np.ndarray
    commands: np.ndarray
    bumper: np.ndarray
    goals: np.ndarray

    @property
    def trajectory(self) -> np.ndarray:
        """The true motion if the bag has it, else the odometry."""
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
        """Mean speed [m/s]; 0 if the duration is 0."""
        return self.distance / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def min_range(self) -> float:
        """Shortest range of all scans [m]; inf without scans."""
        return float(self.scan_minima[:, 1].min(initial=math.inf))

    @property
    def contacts(self) -> int | None:
        """Number of contacts; None if the bag has no bumper messages."""
        return int((np.diff(self.bumper[:, 1], prepend=0.0) > 0.0).sum()) if len(self.bumper) else None

    def path_from(self, pose: Pose) -> np.ndarray:
        """Return the path x, y [m], shape (messages, 2), shifted and rotated so that it begins at a pose."""
        _, x, y, yaw, *_ = self.trajectory[0].tolist()
        cos, sin = math.cos(pose[2] - yaw), math.sin(pose[2] - yaw)
        return (self.trajectory[:, 1:3] - (x, y)) @ np.array([(cos, sin), (-sin, cos)]) + pose[:2]
