"""The safety filter: slows a robot down, or stops it, before it can touch what its laser sees.

Exported policies include this file, so it needs only Python 3.8 and numpy; in tb2rl, `njit` compiles the kernel.

A command is safe if the robot can hold it for a control period and then brake without coming closer to any point that
the laser hit than a margin. A robot inside the margin may turn and drive away, but not come closer. The filter predicts
this motion from the speeds of the wheels, which change only as fast as the motors allow. An unsafe command is replaced
by a slower one on the same arc, or with the same turn rate, or else by a stop. Admissible velocities are those of the
dynamic window approach (Fox, Burgard and Thrun 1997, "The dynamic window approach to collision avoidance"). Since every
command leaves room to brake, the robot never is in an inevitable collision state (Fraichard and Asama 2004).

The guarantee of the setting `guaranteed` assumes that obstacles are static and wider than the gap between two beams;
that the laser sees at least the half plane ahead; and that latencies, motors, and errors of the ranges stay within the
bounds that the filter was told. The setting `usual` takes means in place of bounds, and the median of three
neighbouring ranges in place of each one, so that noise does not slow a good policy down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.envs.filters import Filter, SensedState

SETTINGS = "usual", "guaranteed"
NO_REASON, OBSTACLE, UNSEEN = range(3)
REASONS = "", "an obstacle is in the way", "the laser does not see where the command leads"
_MAX_BEAM_GAP = math.radians(5.5)  # [rad] between neighbouring beams
_MAX_AGE = 0.5  # [s] of a scan; with an older one, drivers stop
_MIN_SPEED = 1e-3  # [m/s] slower commands turn on the spot
_DRIVE_STEP = 0.05  # [s] between predicted poses before the robot brakes
_OVERSHOOT = 0.1  # [m/s] by which the speed can exceed that of both commands while the wheels change their speeds
_BRAKE_STEPS = 5  # predicted poses while it brakes
_ATTEMPTS = 3  # to find a safe speed, each with half the speed of the last one
_HALF_PLANE = 0.5 * math.pi - 1e-6  # [rad]
_CREEP = 0.05  # share of the gap between the robot and the inner margin by which it may come closer in a step


class _Model(NamedTuple):
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
    takes_median: bool


class Safety(Filter):
    """Slows a robot down, or stops it, before it can touch what its laser sees; never speeds it up.

    Args:
        robot: Facts about the robot, see `tb2rl.envs.parts.robot_facts`.
        setting: "usual" or "guaranteed".
        latency: Time until a command takes effect [s], in place of that of the setting.
        error: Amount by which a range can be too long [m], in place of that of the setting.
        margin: Gap that is kept to obstacles [m], in place of that of the setting.

    Raises:
        ValueError: If the setting is unknown, a number is out of range, or the laser does not fit.
    """

    def __init__(
        self,
        robot: Mapping[str, Any],
        setting: str = "usual",
        latency: float | None = None,
        error: float | None = None,
        margin: float | None = None,
    ) -> None:
        if setting not in SETTINGS:
            raise ValueError("setting must be {} or {}, got {!r}".format(*SETTINGS, setting))
        values: dict[str, Any] = dict(robot[setting])
        given = {"latency": latency, "error": error, "margin": margin}
        values.update({name: value for name, value in given.items() if value is not None})
        if not (0.0 <= values["latency"] <= 5.0 and values["margin"] >= 0.0):
            raise ValueError("latency must be from 0 to 5 s, and margin at least 0 m")
        angles, period = np.array(robot["angles"], dtype=float), float(robot["control_period"])
        delays = list(np.arange(0.0, values["latency"], period)) if setting == "guaranteed" else []
        distance, drive_steps = robot["radius"] + values["error"], math.ceil(period / _DRIVE_STEP)
        half_field = _half_field_of_view(angles, setting)
        self._model = _Model(
            cos=np.cos(angles),
            sin=np.sin(angles),
            delays=np.array([*delays, values["latency"]]),
            accelerations=np.array(values["accelerations"]),
            braking=float(values["braking"]),
            drive_steps=drive_steps,
            drive_step=period / drive_steps,
            wheel_separation=float(robot["wheel_separation"]),
            inner=distance + 0.5 * values["margin"],
            outer=distance + values["margin"],
            half_field=half_field,
            edge=(math.cos(half_field), math.sin(half_field)),
            takes_median=setting == "usual",
        )
        self._memory_length = 1 + math.ceil((values["latency"] + _MAX_AGE) / period)

    def reset(self, num_envs: int) -> None:
        self._issued = np.zeros((num_envs, self._memory_length, 2))  # v [m/s], w [rad/s] of commands, the newest first
        self._reasons = np.zeros(num_envs, dtype=np.int64)

    def reset_at(self, indices: np.ndarray) -> None:
        self._issued[indices], self._reasons[indices] = 0.0, NO_REASON

    def state(self) -> dict[str, np.ndarray]:
        return {"issued": self._issued.copy(), "reasons": self._reasons.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self._issued, self._reasons = state["issued"].copy(), state["reasons"].copy()

    def __call__(self, commands: np.ndarray, robot_state: SensedState) -> np.ndarray:
        """Filter commands, see `Filter.__call__`."""
        sensed = robot_state.ranges, robot_state.twist, robot_state.age
        filtered, self._reasons = _filter_commands(self._model, commands, *sensed, self._issued)
        self._issued = np.concatenate((filtered[:, None], self._issued[:, :-1]), axis=1)
        return filtered

    def reason(self, index: int) -> str:
        return REASONS[self._reasons[index]]


def _half_field_of_view(angles: np.ndarray, setting: str) -> float:
    """Half of the field of view of beams [rad]; pi if they see all around."""
    field, gap = float(angles[-1] - angles[0]), float(np.diff(angles).max(initial=0.0))
    if len(angles) < 3 or gap > _MAX_BEAM_GAP:
        limit = math.degrees(_MAX_BEAM_GAP)
        raise ValueError(f"the safety filter needs a laser beam at least every {limit:g} degrees")
    if setting == "guaranteed" and field < math.pi - 1e-6:
        raise ValueError(f"the setting guaranteed needs a laser that sees 180 degrees, not {math.degrees(field):.0f}")
    return math.pi if field + gap > math.tau - 1e-6 else 0.5 * field


@njit(cache=True, error_model="numpy")
def _filter_commands(model, commands, ranges, twists, ages, issued):
    """Filter the commands of all robots.

    Args:
        model: `_Model`.
        commands, twists: v [m/s] and w [rad/s], shape (num_envs, 2).
        ranges: [m], shape (num_envs, beams).
        ages: Of ranges and twists [s], shape (num_envs,).
        issued: The latest commands, the newest first, shape (num_envs, commands, 2).

    Returns:
        Filtered commands, shape (num_envs, 2), and numbers of `REASONS`, shape (num_envs,).
    """
    filtered, reasons = np.zeros(commands.shape), np.zeros(len(commands), np.int64)
    distances = _median_of_three(ranges) if model.takes_median else ranges
    for i in range(len(commands)):
        v, w = float(commands[i, 0]), float(commands[i, 1])  # without numba, numpy's floats are slow
        states = _predict_states(model, twists[i], ages[i], issued[i])
        points = _near_points(model, distances[i], v, states)
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
        model, v, w: `_Model`, and the command.
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
def _near_points(model, distances, v, states):
    """Points x, y [m] that the laser hit, and that the robot can reach with a command and while it brakes."""
    fastest, origin = abs(v), 0.0
    for state in states:
        fastest = max(fastest, 0.5 * abs(state[3] + state[4]))
        origin = max(origin, math.hypot(state[0], state[1]))
    fastest += _OVERSHOOT
    braking = 0.5 * fastest / (model.braking * float(model.accelerations[0]))
    reach = model.outer + origin + fastest * (model.drive_step * model.drive_steps + braking)
    beams = zip(distances, model.cos, model.sin)  # noqa: B905 (Python 3.8)
    return [(float(distance * cos), float(distance * sin)) for distance, cos, sin in beams if distance < reach]


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
def _median_of_three(ranges):
    """Median of each range and its two neighbours, shape (num_envs, beams); the outermost ranges stay as they are."""
    median = ranges.copy()
    left, right = ranges[:, :-2], ranges[:, 2:]
    median[:, 1:-1] = np.maximum(np.minimum(left, right), np.minimum(np.maximum(left, right), ranges[:, 1:-1]))
    return median
