"""Explains the measured speeds by the commands: latency, limits and accelerations.

The model is that of the kinematic simulator: a command takes effect after a latency, is limited, and both wheels then
accelerate evenly to their new speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tb2rl.calibration.estimates import Solution, solve
from tb2rl.core.compiled import njit
from tb2rl.deploy.bags.reading import Drive
from tb2rl.robots import Robot
from tb2rl.simulation.kinematic.motion import wheel_speed

LATENCY, FORWARD, TURN, SPEED, TURN_RATE, ACCELERATION, TURN_ACCELERATION = range(7)
MAX_LATENCY = 0.8  # [s]
_USUAL_ERRORS = np.array([0.01, 0.03])  # [m/s], [rad/s] of the measured speeds
_BLOCK = 4.0  # [s] the residuals of a block depend on each other


@dataclass(frozen=True)
class Response:
    """The fit of the speeds, by the columns above: s, ratio, ratio, m/s, rad/s, m/s^2, m/s^2 (of the wheels' rims).

    All of these are in the odometry's units: "forward" is the speed by odometry / commanded speed.
    """

    solution: Solution
    times: np.ndarray  # [s] of the odometry's stamps, shape (n,)
    measured: np.ndarray  # v [m/s], w [rad/s] by odometry, shape (n, 2)
    nominal: np.ndarray  # predicted for the nominal robot
    fitted: np.ndarray  # predicted by the solution


def fit_response(drive: Drive, robot: Robot) -> Response:
    """Fit the response to the commands of a drive."""
    odometry, commands = drive.odometry, drive.commands
    times = odometry[:, 0] - odometry[:, 6]
    measured, half_separation = odometry[:, 4:6], 0.5 * robot.wheel_separation

    def predict(parameters: np.ndarray) -> np.ndarray:
        return respond(times, commands[:, 0], commands[:, 1:], parameters, half_separation)

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return ((predict(parameters) - measured) / _USUAL_ERRORS).ravel()

    acceleration, coupling = robot.wheel_acceleration, robot.wheel_coupling
    limits = robot.max_speed, robot.max_turn_rate
    nominal = np.array([0.0, 1.0, 1.0, *limits, acceleration + coupling, acceleration - coupling])
    starts = [np.array([latency, *nominal[1:]]) for latency in np.arange(0.0, MAX_LATENCY, 0.02)]
    start = min(starts, key=lambda each: float(np.minimum(np.abs(residuals(each)), 5.0).sum()))
    prior = np.array([0.3, 0.1, 0.1, 0.3 * limits[0], 0.3 * limits[1], 0.5 * acceleration, 0.5 * acceleration])
    clusters = np.repeat(((times - times[0]) / _BLOCK).astype(int), 2)
    solution = solve(residuals, start, prior, clusters)
    return Response(solution, times, measured, predict(nominal), predict(solution.values))


@njit(cache=True)
def respond(times, command_times, commands, parameters, half_separation):
    """Speeds v [m/s], w [rad/s] at `times` [s] (n,), shape (n, 2), by the `parameters` of `Response`."""
    latency, forward, turn, speed, turn_rate, acceleration, turn_acceleration = parameters
    mean, coupling = 0.5 * (acceleration + turn_acceleration), 0.5 * (acceleration - turn_acceleration)
    mean, coupling = max(mean, 1e-3), min(max(coupling, -0.9 * mean), 0.9 * mean)
    speeds, left, right = np.zeros((len(times), 2)), 0.0, 0.0
    v, w, k, now = 0.0, 0.0, 0, min(times[0], command_times[0] + latency) if len(command_times) else times[0]
    for i in range(len(times)):
        while now < times[i]:
            has_next = k < len(command_times) and command_times[k] + latency <= times[i]
            end = max(command_times[k] + latency, now) if has_next else times[i]
            left, right = _accelerate(left, right, v - half_separation * w, v + half_separation * w, end - now,
                                      mean, coupling)  # fmt: skip
            now = end
            if has_next:
                v = forward * min(max(commands[k, 0], -speed), speed)
                w = turn * min(max(commands[k, 1], -turn_rate), turn_rate)
                k += 1
        speeds[i, 0], speeds[i, 1] = 0.5 * (left + right), 0.5 * (right - left) / half_separation
    return speeds


@njit(cache=True)
def _accelerate(left, right, wanted_left, wanted_right, duration, acceleration, coupling):
    """Speeds of the wheels [m/s] a `duration` [s] later."""
    change_left, change_right = wanted_left - left, wanted_right - right
    sign = math.copysign(1.0, change_left * change_right)
    both = math.copysign(min(abs(change_left), abs(change_right)) / (acceleration + sign * coupling), sign)
    return (
        wheel_speed(left, change_left, both, duration, acceleration, coupling),
        wheel_speed(right, change_right, both, duration, acceleration, coupling),
    )
