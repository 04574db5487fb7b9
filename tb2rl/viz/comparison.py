"""The page that compares two sets of runs over their seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.ticker import PercentFormatter

from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluation import kept_evaluation
from tb2rl.evaluation.reliable import Estimate, Scores, difference, improvement, middle, profile, verdict
from tb2rl.runs.folder import Run
from tb2rl.viz.charts import GROUP_COLOURS, STYLE, chart, svg
from tb2rl.viz.page import template
from tb2rl.viz.run_views import run_folders

MEASURES = ("Good episodes", "Speed, as a share of the fastest action's")
_THRESHOLDS = 200  # of a performance profile


@dataclass(frozen=True)
class ComparedRuns:
    """The runs of one reference.

    Attributes:
        name: The reference.
        seeds: Of the runs, by task.
        scores: Of the runs, by measure: an array (runs,) for each task.
    """

    name: str
    seeds: dict[str, list[int]]
    scores: dict[str, Scores]


@dataclass(frozen=True)
class Comparison:
    """Both sets of runs by one measure."""

    title: str
    middles: tuple[Estimate, Estimate]
    difference: Estimate
    improvement: Estimate
    verdict: str
    picture: Markup


def read_compared_runs(reference: str, trust: bool = False) -> ComparedRuns:
    """Read the standard evaluations of the runs that a reference names.

    Raises:
        InputError: If it names no run, a run has no standard evaluation, or two runs have the same task and seed.
    """
    found: dict[str, dict[int, tuple[float, float]]] = {}
    for folder in run_folders([reference]):
        run = Run.open(folder, trust)
        evaluation, config = kept_evaluation(run), run.config
        runs = found.setdefault(f"{config.task_name} in {config.scene.place}", {})
        if config.train.seed in runs:
            raise InputError(f"{reference} has two runs of seed {config.train.seed}: compare runs of one config")
        speed = evaluation.summary()["mean_speed"] / config.scene.actions.max_speed
        runs[config.train.seed] = evaluation.good_rate, speed
    tasks = {task: dict(sorted(runs.items())) for task, runs in sorted(found.items())}
    scores: dict[str, Scores] = {
        title: [np.array([run[i] for run in runs.values()]) for runs in tasks.values()]
        for i, title in enumerate(MEASURES)
    }
    return ComparedRuns(reference, {task: list(runs) for task, runs in tasks.items()}, scores)


def compare(one: ComparedRuns, other: ComparedRuns) -> list[Comparison]:
    """Compare two sets of runs by each measure.

    Raises:
        InputError: If their tasks differ.
    """
    if one.seeds.keys() != other.seeds.keys():
        tasks = ("; ".join(runs.seeds) for runs in (one, other))
        raise InputError("compare runs of the same tasks and worlds, not {} with {}".format(*tasks))
    return [
        Comparison(
            title,
            (middle(ours), middle(theirs)),
            difference(ours, theirs),
            improvement(ours, theirs),
            verdict(ours, theirs, (one.name, other.name)),
            _draw_profiles([ours, theirs], title),
        )
        for title, ours, theirs in zip(MEASURES, one.scores.values(), other.scores.values(), strict=True)
    ]


@matplotlib.rc_context(STYLE)
def _draw_profiles(scores: Sequence[Scores], label: str) -> Markup:
    """Performance profiles: the share of runs above each score, with its 95 % interval."""
    figure, axes = chart(label.lower(), "runs above it")
    values = np.concatenate([task for each in scores for task in each])
    thresholds = np.linspace(min(values.min() - 0.02, 0.98), values.max() + 0.01, _THRESHOLDS)
    for number, each in enumerate(scores):
        (shares, low, high), colour = profile(each, thresholds), GROUP_COLOURS[number]
        axes.fill_between(thresholds, low, high, step="post", color=colour, alpha=0.2, linewidth=0)
        axes.step(thresholds, shares, where="post", color=colour, linewidth=1.4, gid=f"profile-{number}")
    axes.set_ylim(-0.02, 1.02)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


def comparison_page(one: ComparedRuns, other: ComparedRuns, comparisons: Sequence[Comparison]) -> str:
    """The page as HTML."""
    runs = list(zip((one, other), GROUP_COLOURS, strict=False))
    return template("compare.html", Path(__file__).parent).render(
        title=f"{one.name} against {other.name}", runs=runs, comparisons=comparisons
    )
