"""Trains for one minute with a calibration, with the preset `strong` and without variation, and drives hidden robots.

`python tests/calibration/payoff.py FOLDER` trains into a folder and prints success rates in PyBullet on the five robots
of the report with the longest latencies: 94.6 % of 500 episodes calibrated, 75.6 % without variation, 90.2 % with
`strong`; paired differences 19.0 points (15.2 to 22.8) and 4.4 points (1.7 to 7.1). The task takes the
nominal limits of speed, which a policy's spaces contain.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from calibration.drives import calibration_drive, variation
from calibration.judging import ROBOT
from calibration.robots import REPORT_SEEDS, hidden_robot, in_steps

import tb2rl
from tb2rl.calibration.calibration import calibrate
from tb2rl.calibration.output import robot_file
from tb2rl.evaluation.evaluate import evaluate

STEPS, EPISODES, PERIOD = 500_000, 100, 0.1  # of training: about a minute
TRAINING = {"preset": "navigate-plan", "total_timesteps": STEPS, "eval_freq": 0}


def hardest_seeds(count: int = 5) -> list[int]:
    """Seeds of the robots of the report with the longest latencies of commands and scans."""
    return sorted(REPORT_SEEDS, key=lambda seed: -(hidden_robot(seed).latency + hidden_robot(seed).scan_age))[:count]


def trained(folder: Path, setting: object) -> Path:
    """The run folder of a policy that was trained with a variation."""
    if not folder.exists():
        tb2rl.train(folder=folder, settings={"task.variation": setting}, **TRAINING)
    return folder


def successes(run: Path, seed: int) -> np.ndarray:
    """Whether each episode with a hidden robot reaches its goal, shape (EPISODES,)."""
    hidden = in_steps(hidden_robot(seed), PERIOD, PERIOD)
    latencies = {"latency": round(hidden.latency / PERIOD), "observation_latency": round(hidden.scan_age / PERIOD)}
    settings = {"variation": {**variation(hidden), **latencies}}
    found = evaluate(str(run), settings=settings, simulation="bullet", episodes=EPISODES, steps=300, seed=seed)
    return np.array([episode.success for episode in found.episodes])


def calibrated_file(folder: Path, seed: int) -> Path:
    """The robot file of a hidden robot, from its calibration drive."""
    hidden = replace(hidden_robot(seed), max_speed=ROBOT.max_speed, max_turn_rate=ROBOT.max_turn_rate)
    path = folder / f"robot-{seed}.yaml"
    path.write_text(robot_file(calibrate([calibration_drive(hidden, seed)], ROBOT), "turtlebot2"))
    return path


def difference(first: np.ndarray, second: np.ndarray) -> str:
    """The paired difference of two rates with its 95 % interval."""
    each = first.astype(float) - second
    error = 1.96 * each.std(ddof=1) / np.sqrt(len(each))
    return f"{100 * each.mean():.1f} points ({100 * (each.mean() - error):.1f} to {100 * (each.mean() + error):.1f})"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    results: dict[str, list[np.ndarray]] = {"none": [], "calibrated": [], "strong": []}
    for seed in hardest_seeds():
        for name, rates in results.items():
            setting = str(calibrated_file(folder, seed)) if name == "calibrated" else name
            run = trained(folder / (f"calibrated-{seed}" if name == "calibrated" else name), setting)
            rates.append(successes(run, seed))
        print(seed, {name: round(float(rates[-1].mean()), 3) for name, rates in results.items()}, flush=True)
    pooled = {name: np.concatenate(rates) for name, rates in results.items()}
    print({name: round(float(rates.mean()), 4) for name, rates in pooled.items()})
    for name in ("none", "strong"):
        print(f"calibrated against {name}: {difference(pooled['calibrated'], pooled[name])}")
