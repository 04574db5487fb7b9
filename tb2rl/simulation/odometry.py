"""What a robot believes of its way: it counts how its wheels turn, and takes them for what they should be.

Which way it looks a gyro tells better: the driver of the Kobuki takes its heading from there, and x and y from the
wheels (kobuki_node, `use_imu_heading`), and so do the drivers of the TurtleBot3 and the Jackal.

Borenstein and Feng 1996, "Measurement and correction of systematic odometry errors in mobile robots".
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.simulation.initial_state import InitialState


def is_exact(initial_state: InitialState) -> bool:
    """Whether wheels and gyros of all robots are what they should be, so that odometry is what they did."""
    rows = initial_state.rows
    names = "wheel_radius", "assumed_separation", "left_encoder", "right_encoder"
    return all((rows[name] == 1.0).all() for name in names) and bool(np.isin(rows["gyro"], (0.0, 1.0)).all())


def encoder_counts(ways: np.ndarray, initial_state: InitialState) -> np.ndarray:
    """Ways as the robots count them.

    Args:
        ways: How far each went [m] and turned [rad], or how fast, shape (num_envs, 2); of one robot any number of rows.
        start: How the episode of each began.
    """
    rows = initial_state.rows
    half = 0.5 * rows["wheel_separation"] * ways[:, 1]
    left = (ways[:, 0] - half) * rows["left_encoder"] / rows["wheel_radius"]
    right = (ways[:, 0] + half) * rows["right_encoder"] / rows["wheel_radius"]
    counted, gyro = (right - left) / (rows["wheel_separation"] * rows["assumed_separation"]), rows["gyro"]
    turn = np.where(gyro == 0.0, counted, gyro * ways[:, 1])
    return np.stack([0.5 * (left + right), turn], axis=1)


def integrate_odometry(odometry: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Odometry (num_envs, 3) after arcs: `ways` (num_envs, 2) are their lengths [m] and turns [rad]."""
    half = 0.5 * ways[:, 1]
    chord, heading = ways[:, 0] * np.sinc(half / math.pi), odometry[:, 2] + half
    yaw = odometry[:, 2] + ways[:, 1]
    yaw -= math.tau * np.floor((yaw + math.pi) / math.tau)
    return np.stack([odometry[:, 0] + chord * np.cos(heading), odometry[:, 1] + chord * np.sin(heading), yaw], axis=1)


def encoder_odometry(
    odometry: tuple[float, float, float],
    left: tuple[float, float],
    right: tuple[float, float],
    separation: float,
    initial_state: InitialState | None,
) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Odometry x, y, yaw of one robot after an arc, and v [m/s] and w [rad/s], by its wheels.

    Args:
        odometry: Before it.
        left, right: How far the wheel's rim went [m], and how fast it is [m/s].
        separation: Of the wheels [m].
        start: How the episode began; None: the wheels are what they should be.
    """
    x, y, yaw = odometry
    length, turn = (left[0] + right[0]) / 2, (right[0] - left[0]) / separation
    v, w = (left[1] + right[1]) / 2, (right[1] - left[1]) / separation
    if initial_state is not None:
        (length, turn), (v, w) = encoder_counts(np.array([(length, turn), (v, w)]), initial_state).tolist()
    if turn:
        length *= math.sin(turn / 2) / (turn / 2)  # the chord of the arc
    heading = yaw + turn / 2
    yaw = math.remainder(yaw + turn, math.tau)
    return (x + length * math.cos(heading), y + length * math.sin(heading), yaw), (v, w)
