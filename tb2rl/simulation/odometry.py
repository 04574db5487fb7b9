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


@njit(cache=True)
def measure_arcs(arcs, turns, initial_states):
    """Measure arcs with the errors of encoders and gyros.

    Args:
        arcs: Lengths [m] and turns [rad] by the true motion of the wheels, or speeds and turn rates, shape
            (num_envs, 2). For one robot, `arcs` may have any number of rows.
        turns: True turns of the robots [rad], or their rates; unlike those of `arcs` if wheels slip, shape (num_envs,).
        initial_states: Records with the errors of each robot, shape (num_envs,).

    Returns:
        Measured values, of the same shape.
    """
    measured = np.empty(arcs.shape)
    for i in range(len(arcs)):
        robot = initial_states[i if len(initial_states) > 1 else 0]
        half_difference = 0.5 * robot.wheel_separation * arcs[i, 1]  # of the two wheels' arc lengths
        left = (arcs[i, 0] - half_difference) * robot.left_encoder / robot.wheel_radius
        right = (arcs[i, 0] + half_difference) * robot.right_encoder / robot.wheel_radius
        encoder_turn = (right - left) / (robot.wheel_separation * robot.assumed_separation)
        measured[i, 0] = 0.5 * (left + right)
        measured[i, 1] = encoder_turn if robot.gyro == 0.0 else robot.gyro * turns[i]
    return measured


@njit(cache=True)
def integrate_odometry(odometry, arcs):
    """Add arcs (num_envs, 2), lengths [m] and turns [rad], to odometry (num_envs, 3), in a new array."""
    result = np.empty(odometry.shape)
    for i in range(len(arcs)):
        length, turn = arcs[i]
        if turn != 0.0:
            length *= math.sin(0.5 * turn) / (0.5 * turn)  # the chord of the arc
        heading, yaw = odometry[i, 2] + 0.5 * turn, odometry[i, 2] + turn
        result[i, 0] = odometry[i, 0] + length * math.cos(heading)
        result[i, 1] = odometry[i, 1] + length * math.sin(heading)
        result[i, 2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
    return result


def encoder_odometry(
    odometry: Pose, left: Pair, right: Pair, turned: Pair | None, separation: float, initial_state: InitialState | None
) -> tuple[Pose, Pair]:
    """Odometry x, y, yaw [m, m, rad] of one robot after an arc, and its v [m/s] and w [rad/s].

    Args:
        odometry: x, y, yaw before the arc.
        left, right: Distance [m] that the rim of the left (right) wheel has moved, and its speed [m/s].
        turned: True change of the yaw [rad], up to full turns, and its rate [rad/s]; None: there is no gyro.
        separation: Wheel separation of PyBullet's body [m]; `initial_state` has the varied one.
        initial_state: Errors of wheels, encoders and gyro; None: no errors.
    """
    x, y, yaw = odometry
    length, turn = (left[0] + right[0]) / 2, (right[0] - left[0]) / separation
    v, w = (left[1] + right[1]) / 2, (right[1] - left[1]) / separation
    turned = (turn, w) if turned is None else (turn + math.remainder(turned[0] - turn, math.tau), turned[1])
    if initial_state is None:
        turn, w = turned
    else:
        arcs = np.array([(length, turn), (v, w)])
        (length, turn), (v, w) = measure_arcs(arcs, np.array(turned), initial_state.records).tolist()
    if turn:
        length *= math.sin(turn / 2) / (turn / 2)  # the chord of the arc
    heading = yaw + turn / 2
    yaw = math.remainder(yaw + turn, math.tau)
    return (x + length * math.cos(heading), y + length * math.sin(heading), yaw), (v, w)
