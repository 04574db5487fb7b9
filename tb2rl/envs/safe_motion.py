"""Kernel of the safety filter: predicts the motion of a robot, and slows its command down until it is safe.

Exported policies include this file, so it needs only Python 3.8 and numpy; in tb2rl, `njit` compiles it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import njit

NO_REASON, OBSTACLE, UNSEEN = range(3)
_MIN_SPEED = 1e-3  # [m/s] slower commands turn on the spot
_OVERSHOOT = 0.1  # [m/s] by which the speed can exceed that of both commands while the wheels change their speeds
_BRAKE_STEPS = 5  # predicted poses while it brakes
_ATTEMPTS = 3  # to find a safe speed, each with half the speed of the last one
_HALF_PLANE = 0.5 * math.pi - 1e-6  # [rad]
_CREEP = 0.05  # share of the gap between the robot and the inner margin by which it may come closer in a step


class RobotModel(NamedTuple):
    """What the prediction knows of a robot, for compiled code."""

    cos: np.ndarray  # of the beams' directions, shape (beams,)
    sin: np.ndarray
    delays: np.ndarray  # [s] possible times until a command takes effect, shape (delays,)
    accelerations: np.ndarray  # [m/s^2] possible accelerations of the wheels' rims, the smallest first
    braking: float  # share of the acceleration with which the robot is to brake
    drive_steps: int  # predicted poses before the robot brakes
    drive_step: float  # [s] between these poses
    wheel_separation: float  # [m]
    inner: float  # [m] smallest distance from the robot's centre to a point
    outer: float  # [m] distance that the robot keeps if it can
    half_field: float  # [rad] half of the field of view; pi if the laser sees all around
    edge: tuple[float, float]  # its cosine and sine


@njit(cache=True, error_model="numpy")
def filter_commands(model, commands, scans, poses, twists, ages, issued):
    """Filter the commands of all robots.

    Args:
        model: `RobotModel`.
        commands, twists: v [m/s] and w [rad/s], shape (num_envs, 2).
        scans: Ranges of the latest scans [m], the newest first, shape (num_envs, scans, beams).
        poses: x, y [m] and yaw [rad] of these scans, shape (num_envs, scans, 3).
        ages: Of ranges and twists [s], shape (num_envs,).
        issued: The latest commands, the newest first, shape (num_envs, commands, 2).

    Returns:
        Filtered commands, shape (num_envs, 2), and numbers of `REASONS`, shape (num_envs,).
    """
    filtered, reasons = np.zeros(commands.shape), np.zeros(len(commands), np.int64)
    for i in range(len(commands)):
        v, w = float(commands[i, 0]), float(commands[i, 1])  # without numba, numpy's floats are slow
        states = _predict_states(model, twists[i], ages[i], issued[i])
        points = _near_points(model, scans[i], poses[i], v, states)
        limits = _limits(model, states, points)
        is_seen = v > -_MIN_SPEED or model.half_field == math.pi
        share = _safe_share(model, v, w, states, points, limits) if is_seen else 0.0
        if share < 1.0:
            reasons[i] = OBSTACLE if is_seen else UNSEEN
            v, w = _slow_down(model, v, w, share, states, points, limits)
        filtered[i, 0], filtered[i, 1] = v, w
    return filtered, reasons


@njit(cache=True, error_model="numpy")
def _slow_down(model, v, w, share, states, points, limits):
    """A slower safe command on the arc of a command, or with its turn rate, or else a stop."""
    for _ in range(_ATTEMPTS):
        if share == 0.0 or _safe_share(model, share * v, share * w, states, points, limits) == 1.0:
            break
        share *= 0.5
    else:
        share = 0.0
    if _safe_share(model, share * v, w, states, points, limits) == 1.0:
        return share * v, w
    return share * v, share * w


@njit(cache=True, error_model="numpy")
def _safe_share(model, v, w, states, points, limits):
    """Share of its way that a robot can drive safely, if it holds a command for a period and then brakes.

    Args:
        model, v, w: `RobotModel`, and the command.
        states, limits: States in which the robot may be, see `_predict_states`, and their `_limits`.
        points: Points x, y [m] that it must not touch.
    """
    half, samples = 0.5 * model.wheel_separation, model.drive_steps + _BRAKE_STEPS
    checks_view = abs(v) >= _MIN_SPEED and model.half_field < _HALF_PLANE
    for case in range(len(states)):
        start, (keep, free), share = states[case], limits[case], 1.0
        state, acceleration = start, float(model.accelerations[case % len(model.accelerations)])
        targets, step, change = (v - half * w, v + half * w), model.drive_step, model.drive_step * acceleration
        for sample in range(samples):
            if sample == model.drive_steps:  # brake
                targets, change = (0.0, 0.0), max(abs(state[3]), abs(state[4])) / _BRAKE_STEPS
                step = change / (model.braking * acceleration)
            state = _advance(state, targets, change, step, model.wheel_separation)
            if checks_view and abs(state[1]) * model.edge[0] > state[0] * model.edge[1] + _MIN_SPEED:
                return 0.0  # the centre of the robot leaves the field of view of the laser
            if share == 1.0 and state[5] > free:  # before, it cannot touch anything
                distance = _distance(points, state, keep, start)
                free = state[5] + max(distance - keep - 1e-9, 0.0)  # 1e-9: more than rounding errors
                if distance < 0.0:
                    share = max(float(sample), 0.25) / samples  # some share, so that the robot can creep past
                    if not checks_view:
                        return share
        if share < 1.0:
            return share
    return 1.0


@njit(cache=True, error_model="numpy")
def _distance(points, state, keep, start):
    """Distance to the nearest point [m], or -1 if a point is nearer than `keep` [m] and than in the state `start`."""
    robot_x, robot_y, nearest = state[0], state[1], 1e18
    for x, y in points:
        dx, dy = x - robot_x, y - robot_y
        squared = dx * dx + dy * dy
        if squared < keep * keep and squared < (x - start[0]) ** 2 + (y - start[1]) ** 2 - 1e-9:
            return -1.0
        if squared < nearest:
            nearest = squared
    return math.sqrt(nearest)


@njit(cache=True, error_model="numpy", forceinline=True)
def _advance(state, targets, change, duration, wheel_separation):
    """State (x, y, yaw, left and right rim speed, way) after a `duration` [s]; rims change by at most `change`."""
    x, y, yaw, left, right, way = state
    next_left = left + min(max(targets[0] - left, -change), change)
    next_right = right + min(max(targets[1] - right, -change), change)
    length = 0.25 * (left + next_left + right + next_right) * duration
    turn = 0.5 * (right + next_right - left - next_left) * duration / wheel_separation
    cos, sin = math.cos(yaw + 0.5 * turn), math.sin(yaw + 0.5 * turn)
    return x + length * cos, y + length * sin, yaw + turn, next_left, next_right, way + abs(length)


@njit(cache=True, error_model="numpy")
def _predict_states(model, twist, age, issued):
    """States as in `_advance` when the next command takes effect, for each delay and acceleration."""
    half, period = 0.5 * model.wheel_separation, model.drive_step * model.drive_steps
    states = []
    for delay in model.delays:
        for acceleration in model.accelerations:
            state = (0.0, 0.0, 0.0, float(twist[0] - half * twist[1]), float(twist[0] + half * twist[1]), 0.0)
            for index in range(len(issued) - 1, -1, -1):
                step = 0.5 * min(float(delay + age) - index * period, period)
                if step > 1e-6:
                    v, w = float(issued[index, 0]), float(issued[index, 1])
                    for _ in range(2):
                        targets, change = (v - half * w, v + half * w), step * float(acceleration)
                        state = _advance(state, targets, change, step, model.wheel_separation)
            states.append(state)
    return states


@njit(cache=True, error_model="numpy")
def _near_points(model, scans, poses, v, states):
    """Points x, y [m] that the laser hit, and that the robot can reach with a command and while it brakes."""
    fastest, origin = abs(v), 0.0
    for state in states:
        fastest = max(fastest, 0.5 * abs(state[3] + state[4]))
        origin = max(origin, math.hypot(state[0], state[1]))
    fastest += _OVERSHOOT
    braking = 0.5 * fastest / (model.braking * float(model.accelerations[0]))
    reach = model.outer + origin + fastest * (model.drive_step * model.drive_steps + braking)
    points = []
    for k in range(len(scans)):
        x, y, yaw = float(poses[k, 0] - poses[0, 0]), float(poses[k, 1] - poses[0, 1]), float(poses[0, 2])
        x, y = math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x
        turn, farthest = float(poses[k, 2] - yaw), reach + math.hypot(x, y)
        cos, sin = math.cos(turn), math.sin(turn)
        for beam in range(scans.shape[1]):
            distance = float(scans[k, beam])
            if distance < farthest:
                ahead, left = distance * float(model.cos[beam]), distance * float(model.sin[beam])
                points.append((x + cos * ahead - sin * left, y + sin * ahead + cos * left))
    return points


@njit(cache=True, error_model="numpy")
def _limits(model, states, points):
    """For each state, the distance [m] to keep from points, and the way [m] up to which the robot surely keeps it."""
    limits = []
    for state in states:
        nearest = _distance(points, state, 0.0, state)
        keep = min(model.outer, nearest - _CREEP * max(nearest - model.inner, 0.0))
        limits.append((keep, state[5] + max(nearest - keep - 1e-9, 1e-10)))  # 1e-10: no touch, see `_distance`
    return limits


@njit(cache=True, error_model="numpy")
def median_of_three(ranges):
    """Median of each range and its two neighbours, shape (num_envs, beams); the outermost ranges stay as they are."""
    median = ranges.copy()
    left, right = ranges[:, :-2], ranges[:, 2:]
    median[:, 1:-1] = np.maximum(np.minimum(left, right), np.minimum(np.maximum(left, right), ranges[:, 1:-1]))
    return median
