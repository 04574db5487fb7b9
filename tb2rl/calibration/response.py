"""Explains the measured speeds by the commands: latency, limits and accelerations.

The model is that of the kinematic simulator: a command takes effect after a latency, is limited, and both wheels then
accelerate evenly to their new speeds.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tb2rl.calibration.estimates import Estimate, Solution, solve
from tb2rl.core.compiled import njit
from tb2rl.deploy.bags.reading import Drive
from tb2rl.robots import Robot
from tb2rl.simulation.kinematic.motion import wheel_speed

LATENCY, FORWARD, TURN, SPEED, TURN_RATE, ACCELERATION, TURN_ACCELERATION = range(7)
MAX_LATENCY = 0.8  # [s]
_USUAL_ERRORS = np.array([0.01, 0.03])  # [m/s], [rad/s] of the measured speeds
_BEYOND, _MIN_BEYOND = 1.01, 5  # ratio to a limit, and number, of commands that show the limit
_BLOCK = 4.0  # [s] the residuals of a block depend on each other
_COLUMNS = 7  # the parameters above; the others are deviations of the latency
_JITTER = 0.02  # [s] standard deviation of the latency of a command
_MAX_EVENTS = 40  # most commands whose latency has a deviation of its own
_MIN_CHANGE = 0.1  # of a command, as share of the limits, that shows a deviation


@dataclass(frozen=True)
class Response:
    """The fit of the speeds, by the columns above: s, ratio, ratio, m/s, rad/s, m/s^2, m/s^2 (of the wheels' rims).

    The columns after these are deviations from the latency [s], one for each of the largest changes of the commands.

    All of these are in the odometry's units: "forward" is the speed by odometry / commanded speed.
    """

    solution: Solution
    latency: Estimate  # [s]
    times: np.ndarray  # [s] of the odometry's stamps, shape (n,)
    measured: np.ndarray  # v [m/s], w [rad/s] by odometry, shape (n, 2)
    nominal: np.ndarray  # predicted for the nominal robot
    fitted: np.ndarray  # predicted by the solution


def fit_response(drive: Drive, robot: Robot) -> Response:
    """Fit the response to the commands of a drive."""
    odometry, commands = drive.odometry, drive.commands
    events = _events(commands[:, 1:], robot)
    times = odometry[:, 0] - odometry[:, 6]
    measured, half_separation = odometry[:, 4:6], 0.5 * robot.wheel_separation

    def predict(parameters: np.ndarray) -> np.ndarray:
        sent = commands[:, 0].copy()
        sent[events] += parameters[_COLUMNS:]
        return respond(times, np.maximum.accumulate(sent), commands[:, 1:], parameters[:_COLUMNS], half_separation)

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return ((predict(parameters) - measured) / _USUAL_ERRORS).ravel()

    acceleration, coupling = robot.wheel_acceleration, robot.wheel_coupling
    limits = robot.max_speed, robot.max_turn_rate
    no_jitter = np.zeros(len(events))
    nominal = np.array([0.0, 1.0, 1.0, *limits, acceleration + coupling, acceleration - coupling, *no_jitter])
    starts = [np.array([latency, *nominal[1:]]) for latency in np.arange(0.0, MAX_LATENCY, 0.02)]
    start = min(starts, key=lambda each: float(np.minimum(np.abs(residuals(each)), 5.0).sum()))
    prior = np.array([0.3, 0.1, 0.1, 0.3 * limits[0], 0.3 * limits[1], 0.5 * acceleration, 0.5 * acceleration,
                      *(no_jitter + _JITTER)])  # fmt: skip
    clusters = np.repeat(((times - times[0]) / _BLOCK).astype(int), 2)
    solution = solve(residuals, start, prior, clusters, nuisances=len(events))
    latency = _profile(residuals, solution)
    return Response(solution, latency, times, measured, predict(nominal), predict(solution.values))


def _events(commands: np.ndarray, robot: Robot) -> np.ndarray:
    """Indices of the commands (messages, 2) with the largest changes, in order."""
    changes = np.abs(np.diff(commands, axis=0)) / (robot.max_speed, robot.max_turn_rate)
    largest = np.argsort(-changes.max(axis=1), kind="stable")[:_MAX_EVENTS]
    return np.sort(largest[changes[largest].max(axis=1) > _MIN_CHANGE]) + 1


def is_limited(commands: np.ndarray, limit: float) -> bool:
    """Whether some commands, shape (messages,), exceed a limit, so that they show it."""
    return int((np.abs(commands) > _BEYOND * limit).sum()) >= _MIN_BEYOND


def _profile(residuals: Callable[[np.ndarray], np.ndarray], solution: Solution) -> Estimate:
    """The latencies that explain the drive about as well as the best one.

    The residuals can be flat, if the odometry is rarer than the accelerations are long.
    """
    grid = np.arange(0.0, MAX_LATENCY, 0.005)
    factors = (0.6, 0.8, 1.0, 1.25, 1.6)  # of the accelerations, which a latency replaces
    costs = np.array([[_cost(residuals, solution.values, each, factor) for factor in factors] for each in grid])
    fit = solution.estimate(LATENCY)
    best = min(float(costs.min()), _cost(residuals, solution.values, fit.value, 1.0))
    good = grid[costs.min(axis=1) <= best + 4.0 * max(1.0, best / solution.count)]
    if not len(good):
        return fit
    found = Estimate.of(0.5 * float(good[0] + good[-1]), 0.5 * float(good[-1] - good[0]) + 0.005, 1.0)
    if fit.half_width > 2.0 * found.half_width:
        return found
    return fit if fit.half_width > 0.5 * found.half_width or len(good) < 3 else found


def _cost(residuals: Callable[[np.ndarray], np.ndarray], values: np.ndarray, latency: float, factor: float) -> float:
    changed = values.copy()
    changed[[ACCELERATION, TURN_ACCELERATION]] *= factor
    changed[LATENCY] = latency
    return float((2.0 * (np.sqrt(1.0 + residuals(changed) ** 2) - 1.0)).sum())


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
