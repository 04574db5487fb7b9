"""The charts of a study: its history, what mattered, and which settings went together."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from optuna import Study, importance
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.trial import FrozenTrial, TrialState

from tb2rl.rendering.colours import FAILED, PATH
from tb2rl.viz.charts import STYLE, WIDTH, svg

_LONGEST = 12  # characters of a choice beside its axis


def importances(study: Study) -> dict[str, float]:
    """How much each setting mattered, as shares of all, by PED-ANOVA (Watanabe et al. 2023), the largest first.

    Nothing where there are too few trials to tell, or all scored the same.
    """
    if len({trial.value for trial in _complete(study)}) < 2:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return importance.get_param_importances(study)


def draw_charts(study: Study) -> dict[str, Markup]:
    """The charts by their titles, those that the study has trials for."""
    shares = importances(study)
    charts = {"Scores": draw_history(study)}
    if shares:
        charts["What mattered"] = draw_importances(shares)
        charts["Which settings went together"] = draw_parallel(_complete(study), list(shares))
    return charts


@matplotlib.rc_context(STYLE)
def draw_history(study: Study) -> Markup:
    """The score of each trial and the best so far; a cross is where a trial was when it was pruned."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel="trial", ylabel="score")
    numbers, values = _columns([(trial.number, trial.value) for trial in _complete(study)])
    axes.step(numbers, np.maximum.accumulate(values), where="post", color=PATH, linewidth=1.2, gid="best")
    axes.scatter(numbers, values, s=14, color=PATH, linewidths=0, gid="scores")
    ended = study.get_trials(deepcopy=False, states=(TrialState.PRUNED,))
    last = [(trial.number, list(trial.intermediate_values.values())[-1]) for trial in ended if trial.last_step]
    pruned, reached = _columns(last)
    axes.scatter(pruned, reached, s=16, color=FAILED, marker="x", linewidths=1.0, gid="pruned")
    axes.grid(axis="y")
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_importances(shares: Mapping[str, float]) -> Markup:
    """The share of each setting, the largest on top."""
    figure = Figure(figsize=(WIDTH, 0.6 + 0.25 * len(shares)), layout="constrained")
    axes = figure.add_subplot()
    axes.barh(list(map(_short, shares)), list(shares.values()), color=PATH, height=0.6)
    axes.invert_yaxis()
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_parallel(trials: Sequence[FrozenTrial], keys: Sequence[str]) -> Markup:
    """An axis for each setting and one for the score, and a line for each trial, darker where its score is higher."""
    figure = Figure(figsize=(2.2 * WIDTH, 0.8 * WIDTH), layout="constrained")
    axes = figure.add_subplot(ylim=(-0.04, 1.04), xlim=(-0.1, len(keys) + 0.4))
    ordered = sorted(trials, key=lambda trial: trial.value or 0.0)  # the best on top
    scores = np.array([trial.value for trial in ordered])
    heights = [_heights(ordered, key) for key in keys]
    heights.append((scores - scores.min()) / (np.ptp(scores) or 1.0))
    lines = np.stack([np.broadcast_to(np.arange(len(heights)), (len(ordered), len(heights))), np.transpose(heights)], 2)
    ranks = np.linspace(0.15, 1.0, len(ordered))
    axes.add_collection(LineCollection(list(lines), colors=colormaps["Blues"](ranks), linewidths=1.0))
    ends = [_ends(ordered[0], key) for key in keys] + [{0.0: f"{scores.min():.3f}", 1.0: f"{scores.max():.3f}"}]
    for place, labels in enumerate(ends):
        axes.axvline(place, color="#888888", linewidth=0.8, zorder=0)
        for height, label in labels.items():
            axes.text(place + 0.04, height, label, va="center", fontsize=8.0)
    axes.set_xticks(range(len(keys) + 1), [*map(_short, keys), "score"], rotation=12)
    axes.yaxis.set_visible(False)
    axes.spines[:].set_visible(False)
    return svg(figure)


def _heights(trials: Sequence[FrozenTrial], key: str) -> np.ndarray:
    """Where the values of a setting are on its axis, from 0 to 1, shape (trials,)."""
    return np.array([_height(trial, key) for trial in trials])


def _height(trial: FrozenTrial, key: str) -> float:
    value, kind = trial.params[key], trial.distributions[key]
    if isinstance(kind, CategoricalDistribution):
        return kind.choices.index(value) / (len(kind.choices) - 1)
    assert isinstance(kind, FloatDistribution | IntDistribution)
    low, high, at = (math.log(x) if kind.log else x for x in (kind.low, kind.high, value))
    return (at - low) / (high - low)


def _ends(trial: FrozenTrial, key: str) -> dict[float, str]:
    """What stands beside the axis of a setting, by height."""
    kind = trial.distributions[key]
    if isinstance(kind, CategoricalDistribution):
        last = len(kind.choices) - 1
        return {number / last: str(choice)[:_LONGEST] for number, choice in enumerate(kind.choices)}
    assert isinstance(kind, FloatDistribution | IntDistribution)
    return {0.0: f"{kind.low:g}", 1.0: f"{kind.high:g}"}


def _complete(study: Study) -> list[FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def _columns(pairs: Sequence[tuple[int, float | None]]) -> np.ndarray:
    """Shape (2, pairs)."""
    return np.array(pairs, dtype=float).reshape(-1, 2).T


def _short(key: str) -> str:
    """A setting without its section, and the last of what it is in: "learning_rate.start"."""
    return ".".join(key.split(".")[1:][-2:])
