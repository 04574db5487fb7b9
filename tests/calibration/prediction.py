"""Predicts where a held-out drive of 20 s ends, by its commands, with the calibrated and with the nominal robot.

`python tests/calibration/prediction.py tuning` (or `report`) prints the medians over the hidden robots: in the
report, 2.4 mm calibrated and 288 mm nominal.
"""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from calibration.drives import Recording
from calibration.judging import ROBOT, calibration_of
from calibration.robots import REPORT_SEEDS, TUNING_SEEDS, HiddenRobot, hidden_robot

from tb2rl.calibration.calibration import Calibration
from tb2rl.calibration.output import robot_file
from tb2rl.core.files import parse_yaml
from tb2rl.worlds import World

SECONDS, PERIOD = 20.0, 0.1
FLOOR = World.from_shapes("floor", [(30.0, 0.0, 0.1, 1.0, 0.0)], start=(0.0, 0.0, 0.0), bounds=(-31, -31, 31, 31))
_EXACT = {"wheel_radius": 1.0, "wheel_separation": 1.0, "left_encoder": 1.0,
          "right_encoder": 1.0, "gyro": 1.0, "acceleration": 1.0}  # fmt: skip
_LIMITS = {"max_speed": ROBOT.max_speed, "max_turn_rate": ROBOT.max_turn_rate}
_ZEROS = dict.fromkeys((field.name for field in fields(HiddenRobot)), 0.0)
NOMINAL = HiddenRobot(**{**_ZEROS, **_EXACT, **_LIMITS, "scan_period": 0.1})


def calibrated_robot(calibration: Calibration) -> HiddenRobot:
    """The robot with the middle of each range of the robot file."""
    tree = parse_yaml(robot_file(calibration, "turtlebot2"), "the robot file")
    middle = {name: float(np.mean(limits)) for name, limits in tree["variation"].items()}
    encoders = middle.pop("odometry")
    limits = (tree["robot"].get(name, getattr(ROBOT, name)) for name in ("max_speed", "max_turn_rate"))
    latencies = (float(np.mean(tree[name])) for name in ("latency", "observation_latency"))
    both = {"left_encoder": encoders, "right_encoder": encoders}
    keys = ("max_speed", "max_turn_rate"), ("latency", "scan_age")
    return HiddenRobot(
        **middle, **both, **dict(zip(keys[0], limits, strict=True)), **dict(zip(keys[1], latencies, strict=True))
    )


def end_of_drive(robot: HiddenRobot, seed: int) -> np.ndarray:
    """Where a robot is after 20 s of random commands: x, y [m]."""
    rng, recording = np.random.default_rng([37, seed]), Recording(robot, FLOOR, 0)
    commands = [(rng.uniform(0.1, 0.65), rng.uniform(-1.5, 1.5)) for _ in range(10)]
    durations = rng.multinomial(round(SECONDS / PERIOD), np.ones(10) / 10)
    sequence = [command for command, count in zip(commands, durations, strict=True) for _ in range(count)]
    return recording.follow(sequence).truth[-1, 1:3]


def prediction_errors(seed: int) -> tuple[float, float]:
    """Distances [m] from the true end: of the calibrated, and of the nominal robot."""
    hidden = hidden_robot(seed)
    calibration = calibration_of(seed)
    truth = end_of_drive(hidden, seed)
    robots = calibrated_robot(calibration), NOMINAL
    calibrated, nominal = (float(np.hypot(*(end_of_drive(robot, seed) - truth))) for robot in robots)
    return calibrated, nominal


if __name__ == "__main__":
    seeds = {"tuning": TUNING_SEEDS, "report": REPORT_SEEDS}[sys.argv[1]]
    errors = np.array([prediction_errors(seed) for seed in seeds])
    print(np.round(errors, 4))
    print("median error: calibrated {:.4f} m, nominal {:.4f} m".format(*np.median(errors, axis=0)))
