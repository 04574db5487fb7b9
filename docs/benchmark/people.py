"""Goals among people: how many people, whether they give way, and what the laser sees; policies and rules.

    python docs/benchmark/people.py

Trains the presets of `POLICIES` in `runs/people`, unless they are there, and writes the page `people.md`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stable_baselines3.common.policies import BasePolicy

import tb2rl
from tb2rl.core import write_text
from tb2rl.core.command import ArgumentParser, between, report_errors
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs import Config, make_baseline, resolve
from tb2rl.training.training import train_config

FOLDER, RUNS, SEED, EPISODES = Path(__file__).parent, Path("runs/people"), 1, 150
POLICIES, RULES = ("navigate-people", "navigate-people-lidar"), ("dwa", "vfh")
WITHOUT_PEOPLE = "zoo:navigate-plan-ppo"
SPEED = {"speed": [0.3, 1.0]}
CROWDS: dict[str, dict[str, Any] | None] = {
    "no people": None,
    "8 people": {"people": 8, **SPEED},
    "8 who give way": {"people": 8, "avoid_robot": True, **SPEED},
    "16 people": {"people": 16, **SPEED},
}
INTRODUCTION = f"""# Among people

Task `navigate` with a plan on a known map, in test worlds of `mixed`, among people who walk at 0.3 to 1 m/s to random
points and do not see the robot, or give way to it. A cell has the share of goals that the robot reaches within 150 s;
in brackets, that of episodes that end because it causes a contact, and of episodes with any contact [%]. A robot
that stands or drives away causes no contact (at fault, as in nuPlan). The speed is the mean among eight people. The
episodes of a column are the same in every row.

The presets [navigate-people](../../configs/navigate-people.yaml) and
[navigate-people-lidar](../../configs/navigate-people-lidar.yaml), whose laser sees all around, are trained on seed
{SEED}; `{WITHOUT_PEOPLE}` never saw people. The filter is
[passive_safety](../../tb2rl/tasks/README.md#among-people). Written by `python docs/benchmark/people.py`.
"""


def main(arguments: list[str] | None = None) -> None:
    """Train what is missing, drive all of them in all crowds, and write the page."""
    parser = ArgumentParser(prog="python docs/benchmark/people.py", description=str(__doc__).splitlines()[0])
    parser.add_argument("--episodes", type=between(1, 10_000), default=EPISODES, help=f"in each cell ({EPISODES})")
    parser.add_argument("--simulation", default=None, metavar="NAME", help="a simulator (default: PyBullet)")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the page")
    with report_errors():
        options = parser.parse_args(arguments)
        print(write_page(options.folder, measure(options), options.episodes))


def measure(options: argparse.Namespace) -> dict[str, list[str]]:
    """Cells of each row."""
    rows = {}
    for name, policy, config, settings in drivers():
        rows[name], conditions = [], {"episodes": options.episodes, "simulation": options.simulation}
        for crowd in CROWDS.values():
            evaluation = tb2rl.evaluate(policy, config, {**settings, "dynamic_obstacles": crowd}, **conditions)
            rows[name].append(describe(evaluation))
            if crowd == CROWDS["8 people"]:
                speed = evaluation.summary()["mean_speed"]
        rows[name].append(f"{speed:.2f} m/s")
        print(f"{name}: {', '.join(rows[name])}", flush=True)
    return rows


def drivers() -> Iterator[tuple[str, BasePolicy, Config | None, dict[str, Any]]]:
    """Name, policy, config if the policy does not know it, and settings of each row."""
    for preset in POLICIES:
        run = RUNS / preset
        if not (run / "config.yaml").is_file():
            train_config(resolve(preset=preset, settings={"train.seed": SEED}), run)
        yield f"{preset}, with the filter", tb2rl.load(run), None, {}
    for name in (WITHOUT_PEOPLE, *RULES):
        config = resolve(name, "navigate", settings={"task.guide": "plan"}) if name in RULES else None
        policy = make_baseline(config) if config else tb2rl.load(name)
        yield name, policy, config, {"filters": []}
        yield f"{name}, with the filter", policy, config, {"filters": ["passive_safety"]}


def describe(evaluation: Evaluation) -> str:
    """Shares of goals, contacts at fault, and episodes with any contact."""
    episodes = evaluation.episodes
    shares = [[each.success, each.failed, each.touched] for each in episodes]
    goals, faults, contacts = (100 * sum(column) / len(episodes) for column in zip(*shares, strict=True))
    return f"{goals:.1f} ({faults:.1f}, {contacts:.1f})"


def write_page(folder: Path, rows: dict[str, list[str]], episodes: int) -> Path:
    """Write people.md; a row for each driver."""
    table = [["", *CROWDS, "speed"], ["---"] * (2 + len(CROWDS)), *([name, *cells] for name, cells in rows.items())]
    lines = [f"| {' | '.join(cells)} |" for cells in table]
    text = "\n".join([INTRODUCTION, *lines, "", f"{episodes} episodes in each cell."])
    write_text(folder / "people.md", text + "\n")
    return folder / "people.md"


if __name__ == "__main__":
    main()
