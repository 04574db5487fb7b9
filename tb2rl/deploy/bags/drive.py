"""A drive as a bag tells it: where the robot went, what it was told, how near it came to anything."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tb2rl.core.values import Pose


@dataclass(frozen=True)
class Drive:
    """A drive; what a bag does not tell has no rows.

    Every row begins with its time [s] since the first message that was read.

    Attributes:
        name: Of the bag.
        topics: What was read, by the kinds of `tb2rl.deploy.bags.topics`.
        odometry: Time, x [m], y [m], yaw [rad], forward speed [m/s], turn rate [rad/s], shape (messages, 6).
        truth: The same, as a simulation knows it, in the world's frame.
        commands: Time, v [m/s], w [rad/s], shape (messages, 3).
        nearest: Time, shortest range of a scan [m], inf where nothing was in range; shape (messages, 2).
        touches: Time, whether the bumper was touched, 1 or 0, shape (messages, 2).
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
    def way(self) -> np.ndarray:
        """Where it went and how fast: the truth where it is known, else the odometry; rows as of `odometry`."""
        return self.truth if len(self.truth) else self.odometry

    @property
    def seconds(self) -> float:
        """How long it took [s]."""
        return float(self.way[-1, 0] - self.way[0, 0])

    @property
    def distance(self) -> float:
        """How far it went [m]."""
        return float(np.hypot(*np.diff(self.way[:, 1:3], axis=0).T).sum())

    @property
    def speed(self) -> float:
        """Its mean speed [m/s]; 0 if it took no time."""
        return self.distance / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def closest(self) -> float:
        """The shortest range of all [m]; inf if there is no scan."""
        return float(self.nearest[:, 1].min(initial=math.inf))

    @property
    def touched(self) -> int | None:
        """How often it began to touch something; None: no bumper was recorded."""
        if not len(self.touches):
            return None
        return int((np.diff(self.touches[:, 1], prepend=0.0) > 0.0).sum())

    def begun_at(self, pose: Pose) -> np.ndarray:
        """The way x [m], y [m], shape (messages, 2), moved and turned so that it begins at a pose."""
        _, x, y, yaw, *_ = self.way[0].tolist()
        cos, sin = math.cos(pose[2] - yaw), math.sin(pose[2] - yaw)
        return (self.way[:, 1:3] - (x, y)) @ np.array([(cos, sin), (-sin, cos)]) + pose[:2]
