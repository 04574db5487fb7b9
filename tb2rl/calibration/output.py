"""The robot file of a calibration, see `tb2rl.robots.robot_file`, and its table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import yaml

from tb2rl.calibration.calibration import QUANTITIES, Calibration
from tb2rl.calibration.estimates import UNKNOWN, Estimate
from tb2rl.robots import Robot
from tb2rl.simulation.variation import PRESETS

_MAX_LATENCY = 0.3  # [s] of a robot whose latency is unknown
_LASER = ("laser_noise", "bias", "dropped", "mount_x", "mount_y", "mount_yaw")
_NOT_NEGATIVE = ("laser_noise", "dropped")


def robot_file(calibration: Calibration, base: str) -> str:
    """The content of the file: estimates with their intervals, and the preset `strong` for what is unknown.

    Args:
        calibration: The calibration.
        base: Name of the nominal robot.
    """
    estimates = calibration.estimates
    robot: dict[str, Any] = {"base": base}
    for key, limit in zip(("max_speed", "max_turn_rate"), calibration.limits, strict=True):
        if estimates[key] is not UNKNOWN:
            robot[key] = _rounded(limit.value)
    if laser := _laser(calibration):
        robot["laser"] = laser
    latencies = {"latency": estimates["latency"], "observation_latency": estimates["scan_age"]}
    seconds = {
        key: [0.0, _MAX_LATENCY] if each is UNKNOWN else _range(each.within(0.0, 2.0))
        for key, each in latencies.items()
    }
    tree = {"robot": robot, "variation": variation_ranges(calibration), **seconds}
    missing = "".join(
        f"# unknown, and therefore varied widely: {key}. {text}\n" for key, text in calibration.missing.items()
    )
    return f"# A robot from `python -m tb2rl.calibrate`\n{missing}{yaml.safe_dump(tree, sort_keys=False)}"


def variation_ranges(calibration: Calibration) -> dict[str, list[float]]:
    """The ranges of the setting `task.variation`, without latencies."""
    estimates, strong = calibration.estimates, asdict(PRESETS["strong"])
    found: dict[str, Estimate] = {name: estimates[name] for name in ("wheel_radius", *_LASER)}
    found["wheel_separation"] = _quotient(estimates["wheel_radius"], estimates["turn_ratio"])
    found["odometry"] = calibration.forward if estimates["wheel_radius"] is not UNKNOWN else UNKNOWN
    if calibration.robot.gyro:
        found["gyro"] = estimates["turn_scale"]
    found["acceleration"] = _acceleration(calibration)
    ranges = {name: _range(each) if each is not UNKNOWN else list(strong[name]) for name, each in found.items()}
    return {
        name: [max(0.0, low), high] if name in _NOT_NEGATIVE else [low, high] for name, (low, high) in ranges.items()
    }


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


def _quotient(first: Estimate, second: Estimate) -> Estimate:
    if UNKNOWN in (first, second):
        return UNKNOWN
    value = first.value / second.value
    return Estimate.of(
        value, value * math.hypot(first.half_width / first.value, second.half_width / second.value) / 1.96
    )


def _laser(calibration: Calibration) -> Mapping[str, Any]:
    """Beams and field of view of the recorded laser, where they differ from the nominal one."""
    scans, robot = calibration.drives[0].scans, calibration.robot
    if scans is None or not _differs(scans.angles, robot):
        return {}
    count, span = len(scans.angles), float(scans.angles[-1] - scans.angles[0])
    full = span + span / max(1, count - 1)
    return {"beams": count, "field_of_view": math.tau if abs(full - math.tau) < 0.01 else _rounded(min(span, math.tau))}


def _differs(angles: Any, robot: Robot) -> bool:
    return abs(float(angles[-1] - angles[0]) - robot.laser.field_of_view) > 0.02


def _range(estimate: Estimate) -> list[float]:
    return [_rounded(estimate.low), _rounded(estimate.high)]


def _rounded(value: float) -> float:
    return round(float(value), 5)
