"""The page that holds two sets of runs against each other, over their seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluation import kept_evaluation
from tb2rl.evaluation.reliable import Estimate, Scores, difference, improvement, middle, profile, verdict
from tb2rl.runs.folder import Run
from tb2rl.viz.charts import STYLE, WIDTH, svg
from tb2rl.viz.page import template
from tb2rl.viz.palettes import GROUPS, colours
from tb2rl.viz.subjects import run_folders

_STEPS = 200  # of a profile


@dataclass(frozen=True)
class Side:
    """The runs of one reference.

    Attributes:
        name: The reference.
        seeds: Of the runs of each task.
        good: The share of good episodes of each run, by task.
        speed: Its mean speed, as a share of the fastest command's, by task.
    """

    name: str
    seeds: dict[str, list[int]]
    good: dict[str, np.ndarray]
    speed: dict[str, np.ndarray]


@dataclass(frozen=True)
class Measure:
    """Both sides by one figure."""

    title: str
    middles: tuple[Estimate, Estimate]
    difference: Estimate
    improvement: Estimate
    verdict: str
    picture: Markup


def read_side(reference: str, trust: bool = False) -> Side:
    """Read the standard evaluations of the runs that a reference means.

    Raises:
        InputError: If it means no runs, one has no standard evaluation, or two are the same training.
    """
    found: dict[str, dict[int, tuple[float, float]]] = {}
    for folder in run_folders([reference]):
        run = Run.open(folder, trust)
        evaluation, config = kept_evaluation(run), run.config
        runs = found.setdefault(f"{config.task_name} in {config.scene.place}", {})
        if config.train.seed in runs:
            raise InputError(
                f"{reference} has two runs of seed {config.train.seed}: compare one kind of runs with another"
            )
        runs[config.train.seed] = (
            evaluation.good_rate,
            evaluation.summary()["mean_speed"] / config.scene.actions.max_speed,
        )
    ordered = {task: dict(sorted(runs.items())) for task, runs in sorted(found.items())}
    good, speed = (
        {task: np.array([run[i] for run in runs.values()]) for task, runs in ordered.items()} for i in (0, 1)
    )
    return Side(reference, {task: list(runs) for task, runs in ordered.items()}, good, speed)


def compare(one: Side, other: Side) -> list[Measure]:
    """Hold two sides against each other.

    Raises:
        InputError: If they are not of the same tasks.
    """
    if one.seeds.keys() != other.seeds.keys():
        tasks = ("; ".join(side.seeds) for side in (one, other))
        raise InputError("compare runs of the same tasks and worlds, not {} with {}".format(*tasks))
    names = (one.name, other.name)
    return [
        _measure("Good episodes", list(one.good.values()), list(other.good.values()), names),
        _measure(
            "Speed, as a share of the fastest command's", list(one.speed.values()), list(other.speed.values()), names
        ),
    ]


def _measure(title: str, ours: Scores, theirs: Scores, names: tuple[str, str]) -> Measure:
    return Measure(
        title,
        (middle(ours), middle(theirs)),
        difference(ours, theirs),
        improvement(ours, theirs),
        verdict(ours, theirs, names),
        draw_profiles([ours, theirs], title),
    )


@matplotlib.rc_context(STYLE)
def draw_profiles(sides: Sequence[Scores], label: str) -> Markup:
    """Performance profiles: the share of runs above each score, with its 95 % interval."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel=label.lower(), ylabel="runs above it", ylim=(-0.02, 1.02))
    every = np.concatenate([task for side in sides for task in side])
    thresholds = np.linspace(min(every.min() - 0.02, 0.98), every.max() + 0.01, _STEPS)
    for number, (side, colour) in enumerate(zip(sides, colours(len(sides), GROUPS), strict=True)):
        shares, low, high = profile(side, thresholds)
        axes.fill_between(thresholds, low, high, step="post", color=colour, alpha=0.2, linewidth=0)
        axes.step(thresholds, shares, where="post", color=colour, linewidth=1.4, gid=f"profile-{number}")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    axes.grid(axis="y")
    return svg(figure)


def comparison_page(one: Side, other: Side, measures: Sequence[Measure]) -> str:
    """The page as HTML."""
    sides = list(zip((one, other), colours(2, GROUPS), strict=True))
    return template("compare.html", Path(__file__).parent).render(
        title=f"{one.name} against {other.name}", sides=sides, measures=measures
    )
