"""The calibration of a robot: all quantities that a drive shows, with intervals, and what would show the others."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tb2rl.calibration import alignment, response
from tb2rl.calibration.alignment import Alignment
from tb2rl.calibration.estimates import UNKNOWN, Estimate, Solution
from tb2rl.calibration.laser import dropped, noise, used_beams
from tb2rl.calibration.map_alignment import MapAlignment
from tb2rl.calibration.response import Response, fit_response, is_limited
from tb2rl.core import InputError
from tb2rl.deploy.bags.reading import Drive
from tb2rl.deploy.bags.scans import Scans
from tb2rl.robots import Robot
from tb2rl.worlds import World

_MIN_SCANS, _MIN_BEAMS = 10, 8
_PER_LATENCY = 4.0  # [1/s] relative error of an acceleration for an error of the latency


@dataclass(frozen=True)
class Quantity:
    """What is estimated."""

    label: str  # for tables
    unit: str  # of the value, or an empty string for ratios
    useful: float  # largest half of an interval that still tells something; with a wider one the quantity is unknown
    manoeuvre: str  # what would tell the quantity


_STEPS, _FAST = "start and stop at irregular times", "drive straight at full speed for a second"
_FAST_TURN, _LINES = "turn on the spot at full speed for a second", "drive straight lines of 2 m near walls"
_TURNS, _STAND = "turn on the spot by several whole turns, both ways", "stand still for a few seconds in front of walls"
QUANTITIES: Mapping[str, Quantity] = {
    "latency": Quantity("latency of commands", "s", 0.1, _STEPS),
    "scan_period": Quantity("period of scans", "s", 0.05, "record scans"),
    "scan_age": Quantity("age of scans at arrival", "s", 0.05, f"{_TURNS}; {_STEPS}"),
    "max_speed": Quantity("largest speed", "m/s", 0.1, f"{_FAST}, commanding more than the robot can"),
    "max_turn_rate": Quantity("largest turn rate", "rad/s", 0.5, f"{_FAST_TURN}, commanding more than it can"),
    "acceleration": Quantity("acceleration", "m/s^2", 0.6, f"{_FAST}, then stop"),
    "turn_acceleration": Quantity("turning acceleration", "rad/s^2", 5.0, f"{_FAST_TURN}, then stop"),
    "distance_scale": Quantity("odometry: measured / true distance", "", 0.03, _LINES),
    "turn_scale": Quantity("odometry: measured / true turn", "", 0.03, _TURNS),
    "wheel_radius": Quantity("true / commanded speed", "", 0.03, _LINES),
    "turn_ratio": Quantity("true / commanded turn rate", "", 0.03, _TURNS),
    "laser_noise": Quantity("laser: noise", "m", 0.01, _STAND),
    "bias": Quantity("laser: bias", "m", 0.02, f"{_TURNS}, with walls on all sides"),
    "dropped": Quantity("laser: share of dropped beams", "", 0.02, _STAND),
    "mount_x": Quantity("laser: mounting x", "m", 0.02, _TURNS),
    "mount_y": Quantity("laser: mounting y", "m", 0.02, _TURNS),
    "mount_yaw": Quantity("laser: mounting yaw", "rad", 0.03, _LINES),
}
# Standard errors that the residuals do not show, from hidden robots in PyBullet: slip, the shape of its accelerations,
# and the lines' ends.
_SYSTEMATIC = {
    "latency": 0.00005, "scan_age": 0.00015, "max_speed": 0.0001, "max_turn_rate": 0.00003, "acceleration": 0.001,
    "turn_acceleration": 0.006, "distance_scale": 0.0002, "turn_scale": 0.00002, "forward": 0.00015, "turn": 0.00003,
    "bias": 0.0014, "mount_x": 0.0002, "mount_y": 0.0, "mount_yaw": 0.0003,
}  # fmt: skip
_SPARSE = {  # added for each radian between two beams, as the lines of sparse beams cut corners
    "bias": 0.03, "mount_x": 0.04, "mount_y": 0.025, "mount_yaw": 0.01, "distance_scale": 0.008, "turn_scale": 0.006,
}  # fmt: skip


@dataclass(frozen=True)
class Calibration:
    """The estimates of a robot."""

    estimates: Mapping[str, Estimate]  # by the keys of `QUANTITIES`; `UNKNOWN` where the drives do not tell
    # Of commands, the largest speed "max_speed" [m/s] and turn rate "max_turn_rate" [rad/s], beyond which the robot
    # goes no faster; "forward" and "turn" are the speeds by odometry / commanded speeds:
    commanded: Mapping[str, Estimate]
    robot: Robot  # the nominal one
    responses: Sequence[Response]  # the fits of the speeds, one per drive
    alignments: Sequence[np.ndarray]  # parameters of `Alignment`, one per drive; its start values without scans
    drives: Sequence[Drive]

    @property
    def missing(self) -> dict[str, str]:
        """The manoeuvres that would tell the unknown quantities, by key."""
        return {key: QUANTITIES[key].manoeuvre for key, each in self.estimates.items() if each is UNKNOWN}


def calibrate(drives: Sequence[Drive], robot: Robot, world: World | None = None) -> Calibration:
    """Estimate a robot from drives.

    Args:
        drives: Drives of one robot, read with their scans.
        robot: The nominal robot.
        world: The map of the drives, for the scales of the odometry; None: scans are compared with each other.

    Raises:
        InputError: If a drive has no odometry, or the world does not fit it.
    """
    drives = [_with_useful_scans(drive) for drive in drives]
    parts = [_calibrate_one(drive, robot, world) for drive in drives]
    estimates = {key: _combine([part.estimates[key] for part in parts]) for key in QUANTITIES}
    useful = {key: each if each.half_width <= QUANTITIES[key].useful else UNKNOWN for key, each in estimates.items()}
    commanded = {key: _combine([part.commanded[key] for part in parts]) for key in _COMMANDED}
    responses, alignments = ([getattr(part, name)[0] for part in parts] for name in ("responses", "alignments"))
    return Calibration(useful, commanded, robot, responses, alignments, drives)


def _calibrate_one(drive: Drive, robot: Robot, world: World | None) -> Calibration:
    if not len(drive.odometry):
        raise InputError(f"{drive.name} has no odometry")
    fit, scans, estimates = fit_response(drive, robot), drive.scans, dict.fromkeys(QUANTITIES, UNKNOWN)
    aligned, spacing = Solution(alignment.START, np.diag(alignment.PRIOR**2), 1.96), 0.0  # without scans
    if scans:
        aligned, laser = _read_scans(drive, scans)
        estimates |= laser
        spacing = float(np.diff(used_beams(scans)[1]).mean())
    errors = {name: _SYSTEMATIC[name] + per_radian * spacing for name, per_radian in _SPARSE.items()}
    at_scans = {name: aligned.estimate(_ALIGNED[name], error) for name, error in errors.items()}
    if scans and world:
        mapped = MapAlignment(drive, scans, _noise_level(estimates["laser_noise"]), world).solve()
        for name, error in _MAPPED.items():
            at_walls = mapped.estimate(_ALIGNED[name], error)
            _check_map(drive, world, QUANTITIES[name].label, at_walls, at_scans[name])
            at_scans[name] = at_walls
    commanded = {name: fit.solution.estimate(index, _SYSTEMATIC[name]) for name, index in _COMMANDED.items()}
    estimates |= _motion(fit, commanded, at_scans, robot) | (at_scans if scans else {})
    for name, commands in zip(("max_speed", "max_turn_rate"), drive.commands.T[1:], strict=True):
        if not is_limited(commands, commanded[name].value):
            estimates[name] = UNKNOWN
    return Calibration(estimates, commanded, robot, [fit], [aligned.values], [drive])


def _with_useful_scans(drive: Drive) -> Drive:
    scans = drive.scans
    if scans and len(scans.times) >= _MIN_SCANS and len(used_beams(scans)[1]) >= _MIN_BEAMS:
        return drive
    return replace(drive, scans=None)


_ALIGNED = {
    "distance_scale": alignment.DISTANCE, "turn_scale": alignment.TURN, "mount_x": alignment.X, "mount_y": alignment.Y,
    "mount_yaw": alignment.YAW, "bias": alignment.BIAS,
}  # fmt: skip
_MAPPED = {"distance_scale": 0.0005, "turn_scale": 0.00015}  # what a map tells, and systematic standard errors
_COMMANDED = {
    "forward": response.FORWARD, "turn": response.TURN, "max_speed": response.SPEED,
    "max_turn_rate": response.TURN_RATE,
}  # fmt: skip
_UNSCALED = response.SPEED, response.TURN_RATE, response.ACCELERATION, response.TURN_ACCELERATION


def _read_scans(drive: Drive, scans: Scans) -> tuple[Solution, dict[str, Estimate]]:
    """The solution of the alignment, and what the scans tell beyond it."""
    first = noise(drive, scans, 0.0)
    aligned = Alignment(drive, scans, _noise_level(first)).solve()
    delay = aligned.estimate(alignment.DELAY, _SYSTEMATIC["scan_age"])
    age, periods = float(np.median(scans.ages)), np.diff(scans.times)
    period = float(np.median(periods))
    spread = float(np.median(np.abs(periods - period)))
    return aligned, {
        "scan_period": Estimate.of(period, 0.0001 + spread / math.sqrt(len(periods))),
        "scan_age": Estimate(age + delay.value, age + delay.low, age + delay.high),
        "laser_noise": noise(drive, scans, float(aligned.values[alignment.BIAS])),
        "dropped": dropped(scans),
    }


def _check_map(drive: Drive, world: World, label: str, by_map: Estimate, by_scans: Estimate) -> None:
    """Raise an `InputError` if a map contradicts the scans: readings lie at walls of other maps, too."""
    if abs(by_map.value - by_scans.value) > 2.0 * math.hypot(by_map.half_width, by_scans.half_width):
        texts = (f"{each.low:.4f} to {each.high:.4f}" for each in (by_map, by_scans))
        values = "{} by the map, {} by the scans alone".format(*texts)
        raise InputError(f"{drive.name} was not recorded in {world.name}, or its scale is wrong: {label} is {values}")


def _noise_level(noise: Estimate) -> float:
    return noise.value if math.isfinite(noise.value) else 0.02


def _motion(
    fit: Response, commanded: Mapping[str, Estimate], at_scans: Mapping[str, Estimate], robot: Robot
) -> dict[str, Estimate]:
    """Latency, limits, accelerations and ratios in true units, from the response in units of the odometry."""
    latency, distance_scale, turn_scale = fit.latency, at_scans["distance_scale"], at_scans["turn_scale"]
    wheel_radius, turn_ratio = commanded["forward"].over(distance_scale), commanded["turn"].over(turn_scale)
    blur = _PER_LATENCY * latency.half_width  # as a longer latency and a higher acceleration look alike
    errors = {name: math.hypot(blur, _SYSTEMATIC[name]) for name in ("acceleration", "turn_acceleration")}
    speed, turn_rate, acceleration, turn_acceleration = map(fit.solution.estimate, _UNSCALED)
    latency_error = math.hypot(latency.half_width, 1.96 * _SYSTEMATIC["latency"])
    to_turn = Estimate.of(2.0 / robot.wheel_separation, 0.0)
    return {
        "latency": Estimate.of(latency.value, latency_error, 1.0).within(0.0, math.inf),
        "max_speed": speed.times(wheel_radius, _SYSTEMATIC["max_speed"]),
        "max_turn_rate": turn_rate.times(turn_ratio, _SYSTEMATIC["max_turn_rate"]),
        "acceleration": acceleration.over(distance_scale, errors["acceleration"]),
        "turn_acceleration": turn_acceleration.over(turn_scale, errors["turn_acceleration"]).times(to_turn),
        "wheel_radius": wheel_radius,
        "turn_ratio": turn_ratio,
    }


def _combine(estimates: Sequence[Estimate]) -> Estimate:
    """The mean of estimates, weighted by their precision."""
    known = [each for each in estimates if math.isfinite(each.half_width) and each.half_width > 0.0]
    if len(known) < 2:
        return known[0] if known else estimates[0]
    weights = np.array([each.half_width**-2.0 for each in known])
    value = float(weights @ [each.value for each in known] / weights.sum())
    half = float(weights.sum() ** -0.5)
    return Estimate(value, value - half, value + half)
