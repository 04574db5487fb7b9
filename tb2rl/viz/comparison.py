"""The HTML page that compares two sets of runs, each with several seeds."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.ticker import PercentFormatter

from tb2rl.core.errors import InputError
from tb2rl.evaluation import statistics
from tb2rl.evaluation.evaluation import load_evaluation
from tb2rl.evaluation.statistics import Estimate, Scores
from tb2rl.runs.folder import Run
from tb2rl.viz.charts import GROUP_COLOURS, STYLE, chart, svg
from tb2rl.viz.page import template
from tb2rl.viz.run_views import run_folders

SCORES = ("Good episodes", "Speed, relative to the fastest action")
_NUM_THRESHOLDS = 200  # points of a performance profile


@dataclass(frozen=True)
class ComparedRuns:
    """The scores of one set of runs."""

    name: str  # reference of the runs
    scores: dict[str, np.ndarray]  # by task and worlds, shape (runs, len(SCORES))


@dataclass(frozen=True)
class Comparison:
    """The comparison of two sets of runs by one score."""

    title: str
    means: Sequence[Estimate]  # interquartile means of both sets
    difference: Estimate  # interquartile mean of the first set minus that of the second
    improvement: Estimate  # probability that a run of the first set is better
    verdict: str
    picture: Markup


def read_compared_runs(reference: str, trust: bool = False) -> ComparedRuns:
    """Read the scores of runs from their standard evaluations.

    Args:
        reference: An argument of `run_folders`.
        trust: See `Run.open`.

    Raises:
        InputError: If there is no such run, a run has no standard evaluation, or two runs share task, worlds and seed.
    """
    scores_by_seed: dict[str, dict[int, tuple[float, float]]] = {}
    for folder in run_folders([reference]):
        run = Run.open(folder, trust)
        evaluation, config = load_evaluation(run), run.config
        scores = scores_by_seed.setdefault(f"{config.task_name} in {config.scene.worlds_title}", {})
        if config.train.seed in scores:
            raise InputError(f"{reference} has two runs of seed {config.train.seed} at one task: give only one of them")
        speed = evaluation.summary()["mean_speed"] / config.scene.actions.max_speed
        scores[config.train.seed] = evaluation.good_rate, speed
    tasks = sorted(scores_by_seed.items())
    return ComparedRuns(reference, {task: np.array(list(scores.values())) for task, scores in tasks})


def compare(first: ComparedRuns, second: ComparedRuns) -> list[Comparison]:
    """Compare two sets of runs by each score.

    Raises:
        InputError: If their tasks or worlds differ.
    """
    if first.scores.keys() != second.scores.keys():
        tasks = ("; ".join(runs.scores) for runs in (first, second))
        raise InputError("compare runs of the same tasks and worlds, not {} with {}".format(*tasks))
    comparisons = []
    for i, title in enumerate(SCORES):
        sets = [[scores[:, i] for scores in runs.scores.values()] for runs in (first, second)]
        means = [Estimate.of(statistics.interquartile_mean, scores) for scores in sets]
        difference = Estimate.of(statistics.interquartile_difference, *sets)
        improvement = Estimate.of(statistics.improvement_probability, *sets)
        verdict, picture = statistics.verdict(sets[0], sets[1], (first.name, second.name)), _draw_profiles(sets, title)
        comparisons.append(Comparison(title, means, difference, improvement, verdict, picture))
    return comparisons


@matplotlib.rc_context(STYLE)
def _draw_profiles(sets: Sequence[Scores], label: str) -> Markup:
    """Performance profiles: the share of runs above each score, with the 95 % interval of this share."""
    figure, axes = chart(label.lower(), "share of runs above")
    values = np.concatenate([task_scores for scores in sets for task_scores in scores])
    thresholds = np.linspace(min(values.min() - 0.02, 0.98), values.max() + 0.01, _NUM_THRESHOLDS)
    for i, scores in enumerate(sets):
        (shares, low, high), colour = statistics.performance_profile(scores, thresholds), GROUP_COLOURS[i]
        axes.fill_between(thresholds, low, high, step="post", color=colour, alpha=0.2, linewidth=0)
        axes.step(thresholds, shares, where="post", color=colour, linewidth=1.4, gid=f"profile-{i}")
    axes.set_ylim(-0.02, 1.02)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


def comparison_page(first: ComparedRuns, second: ComparedRuns, comparisons: Sequence[Comparison]) -> str:
    """The page as HTML."""
    sets, title = list(zip((first, second), GROUP_COLOURS, strict=False)), f"{first.name} against {second.name}"
    return template("compare.html").render(title=title, sets=sets, comparisons=comparisons)
