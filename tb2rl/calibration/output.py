"""The robot file of a calibration, see `tb2rl.robots.robot_file`, and its table for the terminal."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import yaml

from tb2rl.calibration.calibration import QUANTITIES, Calibration
from tb2rl.calibration.estimates import UNKNOWN, Estimate
from tb2rl.simulation.variation import PRESETS

_MAX_LATENCY = 0.3  # [s] of a robot whose latency is unknown
_LASER = ("laser_noise", "bias", "dropped", "mount_x", "mount_y", "mount_yaw")
_NOT_NEGATIVE = ("laser_noise", "dropped")


def robot_file(calibration: Calibration, base: str) -> str:
    """The content of the file: estimates with their intervals, and the preset `strong` for what is unknown.

    `base` is the name of the nominal robot.
    """
    estimates = calibration.estimates
    robot: dict[str, Any] = {"base": base}
    for key in ("max_speed", "max_turn_rate"):
        if estimates[key] is not UNKNOWN:
            robot[key] = _rounded(calibration.commanded[key].value)
    if laser := _laser(calibration):
        robot["laser"] = laser
    latencies = {"latency": estimates["latency"], "observation_latency": estimates["scan_age"]}
    longest = {key: _MAX_LATENCY if each is UNKNOWN else 2.0 for key, each in latencies.items()}
    seconds = {key: _range(each.within(0.0, longest[key])) for key, each in latencies.items()}
    tree = {"robot": robot, "variation": variation_ranges(calibration), **seconds}
    unknown_keys = "# unknown, and therefore varied widely: {}. {}\n"
    missing = "".join(unknown_keys.format(*item) for item in calibration.missing.items())
    return f"# A robot from `python -m tb2rl.calibrate`\n{missing}{yaml.safe_dump(tree, sort_keys=False)}"


def variation_ranges(calibration: Calibration) -> dict[str, list[float]]:
    """The ranges of the setting `task.variation`, without latencies."""
    estimates, strong = calibration.estimates, asdict(PRESETS["strong"])
    found: dict[str, Estimate] = {name: estimates[name] for name in ("wheel_radius", *_LASER)}
    radius, turn_ratio = estimates["wheel_radius"], estimates["turn_ratio"]
    found["wheel_separation"] = UNKNOWN if UNKNOWN in (radius, turn_ratio) else radius.over(turn_ratio)
    found["odometry"] = UNKNOWN if radius is UNKNOWN else calibration.commanded["forward"]
    if calibration.robot.gyro:
        found["gyro"] = estimates["turn_scale"]
    found["acceleration"] = _acceleration(calibration)
    ranges = {name: _range(each) if each is not UNKNOWN else list(strong[name]) for name, each in found.items()}
    return {name: [max(0.0, low) if name in _NOT_NEGATIVE else low, high] for name, (low, high) in ranges.items()}


def rows(calibration: Calibration) -> Iterator[tuple[str, str, str]]:
    """The table of all quantities: label, value with unit, and interval, or what would tell it."""
    for key, quantity in QUANTITIES.items():
        each = calibration.estimates[key]
        if each is UNKNOWN:
            yield quantity.label, "unknown", f"to know it: {quantity.manoeuvre}"
        else:
            yield quantity.label, f"{each.value:.4f} {quantity.unit}".strip(), f"{each.low:.4f} to {each.high:.4f}"


def _acceleration(calibration: Calibration) -> Estimate:
    """Ratio of true and nominal accelerations, over both kinds of motion, as the simulators know one ratio."""
    robot, estimates = calibration.robot, calibration.estimates
    forward, turn = robot.wheel_acceleration + robot.wheel_coupling, robot.wheel_acceleration - robot.wheel_coupling
    nominal = {"acceleration": forward, "turn_acceleration": turn * 2.0 / robot.wheel_separation}
    known = [(estimates[key], value) for key, value in nominal.items() if estimates[key] is not UNKNOWN]
    if not known:
        return UNKNOWN
    low, high = min(each.low / value for each, value in known), max(each.high / value for each, value in known)
    return Estimate(0.5 * (low + high), low, high).within(0.5, 2.0)


def _laser(calibration: Calibration) -> Mapping[str, Any]:
    """Beams and field of view of the recorded laser, where they differ from the nominal one."""
    scans = calibration.drives[0].scans
    if scans is None:
        return {}
    count, span = len(scans.angles), float(scans.angles[-1] - scans.angles[0])
    if abs(span - calibration.robot.laser.field_of_view) <= 0.02:
        return {}
    full = span + span / max(1, count - 1)
    return {"beams": count, "field_of_view": math.tau if abs(full - math.tau) < 0.01 else _rounded(min(span, math.tau))}


def _range(estimate: Estimate) -> list[float]:
    return [_rounded(estimate.low), _rounded(estimate.high)]


def _rounded(value: float) -> float:
    return round(float(value), 5)
