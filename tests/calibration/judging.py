"""Compares calibrations of hidden robots with the truth: `python tests/calibration/judging.py` prints the figures.

Arguments: `tuning` or `report`, and `drive` (the calibration drive), `ros` (the same over ROS 1) or `play` (bags of a
policy).
"""

import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from calibration.drives import calibration_drive, play_drive, ros_drive
from calibration.robots import REPORT_SEEDS, ROS_STEP, TUNING_SEEDS, HiddenRobot, hidden_robot, in_steps

from tb2rl.calibration.calibration import QUANTITIES, Calibration, calibrate
from tb2rl.calibration.estimates import UNKNOWN
from tb2rl.robots.robot import find_robot

ROBOT = find_robot("turtlebot2")
RELATIVE = {
    "distance_scale": 0.01, "turn_scale": 0.01, "wheel_radius": 0.01, "turn_ratio": 0.01, "max_speed": 0.05,
    "max_turn_rate": 0.05, "acceleration": 0.05, "turn_acceleration": 0.05, "laser_noise": 0.2,
}  # fmt: skip
ABSOLUTE = {"bias": 0.005, "mount_x": 0.01, "mount_y": 0.01, "mount_yaw": np.radians(1.0), "dropped": 0.02}


@cache
def calibration_of(seed: int) -> Calibration:
    """The calibration of a hidden robot from its calibration drive."""
    return calibrate([calibration_drive(hidden_robot(seed), seed)], ROBOT)


def true_values(hidden: HiddenRobot) -> dict[str, float]:
    """The truth, by the keys of `QUANTITIES`."""
    turn_ratio = hidden.wheel_radius / hidden.wheel_separation
    motors = ROBOT.wheel_acceleration, ROBOT.wheel_coupling
    same = ("laser_noise", "bias", "dropped", "mount_x", "mount_y", "mount_yaw", "latency", "scan_age", "wheel_radius")
    return {
        **{name: getattr(hidden, name) for name in same},
        "distance_scale": hidden.encoders / hidden.wheel_radius,
        "turn_scale": hidden.gyro,
        "turn_ratio": turn_ratio,
        "max_speed": hidden.max_speed * hidden.wheel_radius,
        "max_turn_rate": hidden.max_turn_rate * turn_ratio,
        "acceleration": hidden.acceleration * sum(motors),
        "turn_acceleration": hidden.acceleration * (motors[0] - motors[1]) * 2.0 / ROBOT.wheel_separation,
        "scan_period": hidden.scan_period,
    }


def judge(hidden: HiddenRobot, calibration: Calibration, period: float) -> dict[str, tuple[bool, bool, bool]]:
    """For each quantity: whether it is known, within its tolerance, and whether the interval holds the truth."""
    verdicts = {}
    for name, truth in true_values(hidden).items():
        each = calibration.estimates[name]
        tolerance = RELATIVE[name] * abs(truth) if name in RELATIVE else ABSOLUTE.get(name, 0.5 * period)
        known = each is not UNKNOWN
        verdicts[name] = known, known and abs(each.value - truth) <= tolerance, each.low <= truth <= each.high
    return verdicts


def table(verdicts: Iterable[dict[str, tuple[bool, bool, bool]]]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Shares of known, good and covered estimates by quantity, and pooled over all known ones."""
    rows = {name: np.array([each[name] for each in verdicts]) for name in QUANTITIES}
    pooled = np.concatenate(list(rows.values()))
    known = pooled[pooled[:, 0].astype(bool)]
    return {name: each.mean(axis=0) for name, each in rows.items()}, np.array(
        [len(known) / len(pooled), *known.mean(axis=0)[1:]]
    )


if __name__ == "__main__":
    seeds, kind = {"tuning": TUNING_SEEDS, "report": REPORT_SEEDS}[sys.argv[1]], sys.argv[2]
    results = []
    for seed in seeds:
        hidden = hidden_robot(seed)
        if kind != "drive":
            hidden = in_steps(hidden, *((0.2, 0.2) if kind == "play" else (ROS_STEP, 0.1)))
        drive = {"drive": calibration_drive, "ros": ros_drive, "play": play_drive}[kind](hidden, seed)
        calibration = calibrate([drive], ROBOT)
        results.append(judge(hidden, calibration, 0.2 if kind == "play" else 0.1))
        for name, (known, good, covered) in results[-1].items():
            if (known and not good) or not covered:
                print(seed, name, true_values(hidden)[name], calibration.estimates[name])
        sys.stdout.flush()
    shares, pooled = table(results)
    for name, (known, good, covered) in shares.items():
        print(f"{name:18} known {known:.2f} good {good:.2f} covered {covered:.2f}")
    print("pooled: known {:.3f}, of these within tolerance {:.3f}, interval holds the truth {:.3f}".format(*pooled))
