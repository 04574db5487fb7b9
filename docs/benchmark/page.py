"""The page of the benchmark, from the lines of `runs.jsonl`: tables and learning curves.

python docs/benchmark/page.py
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from pairs import PILOT, TUTORIAL, Pair, find_config, find_preset, is_rule

import tb2rl.viz
from tb2rl.core import agent_names, write_text
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs import read_lines

SECONDS, EPISODES = 30, 100
KINEMATIC, PHYSICS = "kinematic", "bullet"
STYLE = Path(tb2rl.viz.__path__[0], "charts.mplstyle")
Row = Mapping[str, Any]
TASKS = ("maze", "my-maze", "wall", "drive", "navigate")
INTRODUCTION = f"""# Benchmark of learning

Every agent at every task that it can learn, trained in the kinematic simulator for {SECONDS} s of one processor core,
evaluations not counted. A number is the rate of good episodes [%] among {EPISODES} with random starts: those without a
collision, or at `wall` and `navigate` those that reach the goal. The policy is the one that training keeps: the best of
its evaluations, which have other starts and, at `navigate`, other worlds. "-": the agent cannot learn the task, because
it needs other actions, or another program was not tried there.

This page is written by `python docs/benchmark/run.py`, which trains what is missing in [runs.jsonl](runs.jsonl), on
request on a cluster (`--on ray:ADDRESS`). The rows of SBX need `pip install sbx-rl`.
"""


MEANS = """Mean of the seeds, in brackets its 95 % interval (bootstrap over the trainings). Number of seeds:
{0} for agents, {1} for other programs. A rule has no training.
"""
RANGES = "Mean of the first three seeds in PyBullet, in brackets the worst and the best of them.\n"
SQUARES = """A robot that only drives in circles never collides, too. The number of squares of 1 m that the median
episode visits tells it from one that explores: in world `loop`, where `maze` and `drive` take place, a policy that
drives around visits 35 to 50.
"""
CURVES = f"""Rates of good episodes in ten evaluations during training, of {EPISODES} validation episodes each: mean and
95 % interval over the seeds. Steps differ between agents; seconds do not.
"""
COMMANDS = f"""The steps are those that {SECONDS} s allow. The benchmark also sets `train.stop_score=null`,
`train.save_freq=0`, `train.eval_episodes={EPISODES}`, and `train.eval_freq` to a tenth of the steps.
"""
PLAN = "With a planned path to the goal (`task.guide=plan`): an easier task.\n"


def write_page(folder: Path, rows: Sequence[Row]) -> Path:
    """Write the page and its pictures; returns the path of the page."""
    runs: dict[Pair, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row["seed"]):
        if row["seed"] != PILOT:
            runs.setdefault(_pair(row), []).append(row)
    pilots = {_pair(row): row for row in rows if row["seed"] == PILOT}
    machines = sorted({row["machine"] for row in pilots.values()})
    parts = [INTRODUCTION, f"Machine: {'; '.join(machines)}.\n"]
    parts += [
        "## In the kinematic simulator\n",
        MEANS.format(*_num_seeds(runs)),
        _table(runs, KINEMATIC, _mean),
        f"\\* {PLAN}",
    ]
    parts += ["## In physics\n", RANGES, _table(runs, PHYSICS, _range)]
    parts += ["## Visited squares\n", SQUARES, _table(runs, KINEMATIC, _squares)]
    parts += ["## Learning curves\n", CURVES]
    for task in TASKS:
        curves = {name: rows for (name, other), rows in runs.items() if other == task and rows[0]["curve"]}
        if curves:
            _draw(folder / f"{task}.svg", curves, {name: pilots[name, task]["timesteps"] for name in curves})
            parts.append(f"### {task}\n\n![Learning curves of {task}]({task}.svg)\n")
    parts += ["## How each pair is trained\n", COMMANDS, _commands(pilots)]
    page = folder / "README.md"
    write_text(page, "\n".join(parts))
    return page


def _num_seeds(runs: Mapping[Pair, Sequence[Row]]) -> list[str]:
    """The number of seeds of agents and of other programs, as text."""
    counts = [[len(rows) for (name, _), rows in runs.items() if _group(name)[0] == group] for group in (0, 2)]
    return [" to ".join(map(str, sorted({min(found, default=0), max(found, default=0)}))) for found in counts]


def _pair(row: Row) -> Pair:
    return row["name"], row["task"]


def _table(runs: Mapping[Pair, Sequence[Row]], simulation: str, cell: Callable[[Sequence[Row]], str]) -> str:
    """A row for each agent or program, rules after agents and other programs last, and a column for each task."""
    names = sorted({name for name, _ in runs}, key=_group)
    lines = ["| | " + " | ".join(f"`{task}`" for task in TASKS) + " |", "|---" * (len(TASKS) + 1) + "|"]
    for name in names:
        cells = [f"`{name}`" if name in agent_names() else "the tutorial's" if name == TUTORIAL else name]
        for task in TASKS:
            results = [row["results"][simulation] for row in runs.get((name, task), []) if simulation in row["results"]]
            cells.append(cell(results) + (" \\*" if _has_plan(name, task) else "") if results else "-")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


@cache
def _has_plan(name: str, task: str) -> bool:
    config = None if name not in agent_names() else find_config(name, task)
    return getattr(config and config.task, "guide", None) == "plan"


def _group(name: str) -> tuple[int, str]:
    """Order of the rows: agents (0), rules (1), other programs (2)."""
    is_agent = name in agent_names()
    return (1 if is_rule(name) else 0) if is_agent else 2, name


def _rates(results: Sequence[Row]) -> np.ndarray:
    return np.array([100 * result["good"] / EPISODES for result in results])


def _mean(results: Sequence[Row]) -> str:
    rates = _rates(results)
    low, high = bootstrap_interval(rates)
    return f"{rates.mean():.1f}" + (f" ({low:.1f} to {high:.1f})" if len(rates) > 1 else "")


def _range(results: Sequence[Row]) -> str:
    rates = _rates(results)
    return f"{rates.mean():.1f}" + (f" ({rates.min():.0f} to {rates.max():.0f})" if len(rates) > 1 else "")


def _squares(results: Sequence[Row]) -> str:
    return f"{np.median([result['squares'] for result in results]):g}"


def _commands(pilots: Mapping[Pair, Row]) -> str:
    lines = ["| | task | steps | command |", "|---|---|---|---|"]
    for (name, task), row in sorted(pilots.items(), key=lambda item: (_group(item[0][0]), TASKS.index(item[0][1]))):
        preset = find_preset(name, task)
        chosen = f"--preset {preset}" if preset else f"--agent {name} --task {task}"
        command = f"`python -m tb2rl.train {chosen} --simulation kinematic --total-timesteps {row['timesteps']}`"
        is_ours = name in agent_names() or name == TUTORIAL
        lines.append(f"| {name} | `{task}` | {row['timesteps']:,} | {command if is_ours else '[peers.py](peers.py)'} |")
    return "\n".join(lines) + "\n"


def _draw(file: Path, curves: Mapping[str, Sequence[Row]], steps: Mapping[str, int]) -> None:
    """Draw the rate of good episodes over steps and over seconds."""
    with plt.style.context([STYLE, {"figure.facecolor": "white"}]):
        figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
        for name, rows in curves.items():
            timesteps = [timesteps for timesteps, _ in rows[0]["curve"]]  # the same for all seeds
            rates = np.array([[100 * rate for _, rate in row["curve"]] for row in rows])
            seconds = np.array(timesteps) / steps[name] * SECONDS
            bands = np.array([bootstrap_interval(column) for column in rates.T]).T
            for panel, x in zip(panels, (timesteps, seconds), strict=True):
                panel.plot(x, rates.mean(axis=0), label=name)
                panel.fill_between(x, *bands, alpha=0.15)
        panels[0].set(xscale="log", xlabel="control steps", ylabel="good episodes [%]", ylim=(0, 101))
        panels[1].set(xlabel="time of one core [s]", xlim=(0, SECONDS))
        for panel in panels:
            panel.grid()
        panels[1].legend(loc="lower right")
        figure.savefig(file, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    write_page(Path(__file__).parent, read_lines(Path(__file__).parent / "runs.jsonl"))
