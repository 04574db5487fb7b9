"""The records that compiled code of the kinematic simulator takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tb2rl.worlds.index import WorldIndex


class Constants(NamedTuple):
    """What no step changes.

    Attributes:
        initial: Records of the initial states, see `tb2rl.simulation.spec.RECORD`, shape (num_envs,).
        index: Of all worlds.
        beams: Cosines and sines of the laser's beam directions, each of shape (beams,).
        laser_noise: Standard deviation of the laser [m].
        min_range, max_range: Of the laser [m].
        physics_step: Of PyBullet [s].
    """

    initial: np.ndarray
    index: WorldIndex  # type: ignore[assignment]  # hides a method of tuple that nobody calls
    beams: tuple[np.ndarray, np.ndarray]
    laser_noise: float
    min_range: float
    max_range: float
    physics_step: float


class Motion(NamedTuple):
    """The state of all robots; compiled code changes it in place.

    Attributes:
        poses: x [m], y [m], yaw [rad], shape (num_envs, 3).
        wheel_speeds: Of the left and the right rim [m/s], shape (num_envs, 2).
        streams: Key of each environment's random numbers for its laser, and its number of scans, shape (num_envs, 2),
            uint64.
        bumped: Whether the base touched an obstacle in the last step, shape (num_envs,).
        commands: v [m/s] and w [rad/s] of the last step, shape (num_envs, 2).
        accelerations: Mean forward acceleration in the last step [m/s^2], shape (num_envs,).
        twists: v [m/s] and w [rad/s], shape (num_envs, 2).
    """

    poses: np.ndarray
    wheel_speeds: np.ndarray
    streams: np.ndarray
    bumped: np.ndarray
    commands: np.ndarray
    accelerations: np.ndarray
    twists: np.ndarray


class Measured(NamedTuple):
    """What a step measures, beside the motion; compiled code writes it.

    Attributes:
        arcs: Length [m] and turn [rad] of each robot's way, shape (num_envs, 2).
        travelled: Distance between the poses before and after the step [m], shape (num_envs,).
        ranges: Of the laser [m], shape (num_envs, beams).
        nearest: Shortest range [m], shape (num_envs,).
        nearest_is_dynamic: See `RobotState`, shape (num_envs,).
    """

    arcs: np.ndarray
    travelled: np.ndarray
    ranges: np.ndarray
    nearest: np.ndarray
    nearest_is_dynamic: np.ndarray
