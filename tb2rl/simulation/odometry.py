"""Odometry from wheel encoders and gyro (Borenstein and Feng 1996, "Measurement and correction of systematic odometry
errors in mobile robots").

With a gyro, the heading comes from the gyro, and x and y come from the wheels, as in the drivers of the Kobuki
(kobuki_node, `use_imu_heading`), the TurtleBot3 and the Jackal.
"""

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.simulation.spec import InitialState

Pose = tuple[float, float, float]
Pair = tuple[float, float]


@njit(cache=True)
def is_odometry_exact(initial_states):
    """Whether odometry has no errors, because wheels and gyros are nominal in all `initial_states` (num_envs,)."""
    for start in initial_states:
        has_errors = start.wheel_radius != 1.0 or start.assumed_separation != 1.0
        has_errors |= start.left_encoder != 1.0 or start.right_encoder != 1.0
        if has_errors or not (start.gyro == 0.0 or start.gyro == 1.0):
            return False
    return True


def measure_arcs(arcs: np.ndarray, initial_state: InitialState) -> np.ndarray:
    """Measure arcs with the errors of encoders and gyros.

    Args:
        arcs: True lengths [m] and turns [rad], or speeds and turn rates, shape (num_envs, 2). For one robot, `arcs`
            may have any number of rows.
        initial_state: Errors of each robot.

    Returns:
        Measured values, of the same shape.
    """
    records = initial_state.records
    half_difference = 0.5 * records["wheel_separation"] * arcs[:, 1]  # of the two wheels' arc lengths
    left = (arcs[:, 0] - half_difference) * records["left_encoder"] / records["wheel_radius"]
    right = (arcs[:, 0] + half_difference) * records["right_encoder"] / records["wheel_radius"]
    encoder_turn, gyro = (right - left) / (records["wheel_separation"] * records["assumed_separation"]), records["gyro"]
    turn = np.where(gyro == 0.0, encoder_turn, gyro * arcs[:, 1])
    return np.stack([0.5 * (left + right), turn], axis=1)


def integrate_odometry(odometry: np.ndarray, arcs: np.ndarray) -> np.ndarray:
    """Add arcs (num_envs, 2), lengths [m] and turns [rad], to odometry (num_envs, 3)."""
    half_turn = 0.5 * arcs[:, 1]
    chord, heading = arcs[:, 0] * np.sinc(half_turn / math.pi), odometry[:, 2] + half_turn
    yaw = odometry[:, 2] + arcs[:, 1]
    yaw -= math.tau * np.floor((yaw + math.pi) / math.tau)
    return np.stack([odometry[:, 0] + chord * np.cos(heading), odometry[:, 1] + chord * np.sin(heading), yaw], axis=1)


def encoder_odometry(
    odometry: Pose, left: Pair, right: Pair, separation: float, initial_state: InitialState | None
) -> tuple[Pose, Pair]:
    """Odometry x, y, yaw [m, m, rad] of one robot after an arc, and its v [m/s] and w [rad/s].

    Args:
        odometry: x, y, yaw before the arc.
        left, right: Distance [m] that the rim of the left (right) wheel has moved, and its speed [m/s].
        separation: Wheel separation of PyBullet's body [m]; `initial_state` has the varied one.
        initial_state: Errors of wheels, encoders and gyro; None: no errors.
    """
    x, y, yaw = odometry
    length, turn = (left[0] + right[0]) / 2, (right[0] - left[0]) / separation
    v, w = (left[1] + right[1]) / 2, (right[1] - left[1]) / separation
    if initial_state is not None:
        (length, turn), (v, w) = measure_arcs(np.array([(length, turn), (v, w)]), initial_state).tolist()
    if turn:
        length *= math.sin(turn / 2) / (turn / 2)  # the chord of the arc
    heading = yaw + turn / 2
    yaw = math.remainder(yaw + turn, math.tau)
    return (x + length * math.cos(heading), y + length * math.sin(heading), yaw), (v, w)
