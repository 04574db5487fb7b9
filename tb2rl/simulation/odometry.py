"""Odometry from wheel encoders, with the nominal wheels, and from a gyro.

The driver of the Kobuki takes the heading from the gyro, and x and y from the wheels (kobuki_node, `use_imu_heading`);
so do the drivers of the TurtleBot3 and the Jackal.

Borenstein and Feng 1996, "Measurement and correction of systematic odometry errors in mobile robots".
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.simulation.initial_state import InitialState


def is_exact(initial_state: InitialState) -> bool:
    """Whether wheels and gyros of all robots are nominal, so that odometry has no errors."""
    rows = initial_state.rows
    names = "wheel_radius", "assumed_separation", "left_encoder", "right_encoder"
    return all((rows[name] == 1.0).all() for name in names) and bool(np.isin(rows["gyro"], (0.0, 1.0)).all())


def encoder_counts(arcs: np.ndarray, initial_state: InitialState) -> np.ndarray:
    """Arcs as encoders and gyros measure them.

    Args:
        arcs: Lengths [m] and turns [rad], or speeds and turn rates, shape (num_envs, 2); any number of rows for one
            robot.
        initial_state: With the errors of wheels, encoders and gyros.
    """
    rows = initial_state.rows
    half = 0.5 * rows["wheel_separation"] * arcs[:, 1]
    left = (arcs[:, 0] - half) * rows["left_encoder"] / rows["wheel_radius"]
    right = (arcs[:, 0] + half) * rows["right_encoder"] / rows["wheel_radius"]
    counted, gyro = (right - left) / (rows["wheel_separation"] * rows["assumed_separation"]), rows["gyro"]
    turn = np.where(gyro == 0.0, counted, gyro * arcs[:, 1])
    return np.stack([0.5 * (left + right), turn], axis=1)


def integrate_odometry(odometry: np.ndarray, arcs: np.ndarray) -> np.ndarray:
    """Add arcs (num_envs, 2), lengths [m] and turns [rad], to odometry (num_envs, 3)."""
    half = 0.5 * arcs[:, 1]
    chord, heading = arcs[:, 0] * np.sinc(half / math.pi), odometry[:, 2] + half
    yaw = odometry[:, 2] + arcs[:, 1]
    yaw -= math.tau * np.floor((yaw + math.pi) / math.tau)
    return np.stack([odometry[:, 0] + chord * np.cos(heading), odometry[:, 1] + chord * np.sin(heading), yaw], axis=1)


def encoder_odometry(
    odometry: tuple[float, float, float],
    left: tuple[float, float],
    right: tuple[float, float],
    separation: float,
    initial_state: InitialState | None,
) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Odometry of one robot after an arc.

    Args:
        odometry: x, y, yaw before it [m, m, rad].
        left, right: Distance [m] and speed [m/s] of the wheel's rim.
        separation: Of the wheels [m].
        initial_state: With the errors of wheels, encoders and gyro; None: there are none.

    Returns:
        x, y, yaw; v [m/s] and w [rad/s].
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
