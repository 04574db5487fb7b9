"""Writes the results of a study: a preset with the best settings, and a page with charts of the scores."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import yaml
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from optuna import Study, importance
from optuna.trial import FrozenTrial
from pydantic_core import to_jsonable_python

from tb2rl.core.files import write_text
from tb2rl.rendering.colours import BEAM, PATH
from tb2rl.tuning.selection import Comparison, TrialEvaluation
from tb2rl.tuning.study import BEST, PAGE, Choices, Range, StudyFolder
from tb2rl.tuning.trials import best_trials, count_trials
from tb2rl.viz.charts import STYLE, chart, svg
from tb2rl.viz.page import template

_LISTED_TRIALS = 20  # number of trials in the table of the page
_MIN_TRIALS = 10  # complete trials for importances, because those of fewer trials are chance
_MAX_LETTERS, _AXIS_LETTERS = 12, 48  # of a choice and of all choices below a chart
_MAX_MARKERS = 500  # charts of more trials have them as pixels


def write_preset(folder: StudyFolder, trial: FrozenTrial, evaluation: TrialEvaluation, num_trials: int) -> Path:
    """Write a preset with the settings of a trial."""
    low, high = evaluation.interval
    lines = (
        f"# Found by tb2rl.tune: trial {trial.number} of {num_trials}, starting from {folder.path}/default.yaml.",
        f"# In {evaluation.simulator} {100 * evaluation.good_rate:.1f} % of {evaluation.episodes} episodes are good "
        f"(95 % interval {100 * low:.1f} to {100 * high:.1f} %).",
    )
    tree = to_jsonable_python(folder.preset(folder.settings(trial.params)))
    file = folder.path / BEST
    write_text(file, "\n".join(lines) + "\n" + yaml.safe_dump(tree, sort_keys=False))
    return file


def write_page(
    folder: StudyFolder,
    study: Study,
    evaluations: Sequence[TrialEvaluation],
    best: FrozenTrial,
    comparisons: Sequence[Comparison] = (),
) -> Path:
    """Write the page of a study.

    Args:
        folder: Folder of the study.
        study: The study.
        evaluations: Evaluations of the trials with the highest scores, in physics.
        best: The trial with the best evaluation.
        comparisons: Trainings with the best and with the default settings.
    """
    config, trials = folder.default, best_trials(study)
    by_setting = {key: _draw_setting(trials, best, key, entry) for key, entry in folder.space.items()}
    text = template("study.html", Path(__file__).parent).render(
        title=f"Search: {config.agent_name} at {config.task_name} in {config.scene.worlds_title}",
        counts=count_trials(study),
        folder=folder,
        default=config.to_dict(),
        shares=_importances(study),
        min_trials=_MIN_TRIALS,
        evaluations=evaluations,
        best=best,
        comparisons=comparisons,
        charts={"Scores": _draw_history(trials, best), **by_setting},
        colours={"trial": PATH, f"trial {best.number}, the best": BEAM},
        trials=trials[:_LISTED_TRIALS],
        value_at=_value_at,
        short=_format,
    )
    file = folder.path / PAGE
    write_text(file, text)
    return file


def _value_at(tree: Any, key: str) -> Any:
    """The value at a dotted key of a tree, or None."""
    for name in key.split("."):
        tree = tree.get(name) if isinstance(tree, Mapping) else None
    return tree


def _format(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def _importances(study: Study) -> dict[str, float]:
    """Importances of parameters by PED-ANOVA (Watanabe et al. 2023), largest first; their sum is 1.

    The result is empty if there are too few trials, or all scores are equal.
    """
    trials = best_trials(study)
    has_enough_trials = len(trials) >= _MIN_TRIALS and len({trial.value for trial in trials}) > 1
    return importance.get_param_importances(study) if has_enough_trials else {}


@matplotlib.rc_context(STYLE)
def _draw_history(trials: Sequence[FrozenTrial], best: FrozenTrial) -> Markup:
    """Scores over the numbers of the trials, and the best score so far."""
    figure, axes = chart("trial", "score")
    numbers, scores = np.array(sorted((trial.number, trial.value) for trial in trials)).T
    axes.step(numbers, np.maximum.accumulate(scores), where="post", color=PATH, linewidth=1)
    _scatter(axes, trials, best, {trial.number: trial.number for trial in trials})
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    return svg(figure)


@matplotlib.rc_context(STYLE)
def _draw_setting(trials: Sequence[FrozenTrial], best: FrozenTrial, key: str, entry: Range | Choices) -> Markup:
    """Scores over the values of a setting; choices have equal distances."""
    figure, axes = chart("value", "score")
    values = {trial.number: trial.params[key] for trial in trials}
    if isinstance(entry, Choices):
        choices = entry.distribution.choices
        labels = [str(choice)[:_MAX_LETTERS] for choice in choices]
        step = 1 + len(labels) * max(map(len, labels)) // _AXIS_LETTERS  # else labels overlap
        axes.set_xticks(range(0, len(labels), step), labels[::step])
        values = {number: choices.index(value) for number, value in values.items()}
    elif entry.log:
        decades = (1.0,) if entry.high > 100 * entry.low else (1.0, 2.0, 5.0)
        axes.set_xscale("log")
        axes.xaxis.set(major_locator=LogLocator(subs=decades), major_formatter="{x:g}", minor_formatter=NullFormatter())
    _scatter(axes, trials, best, values)
    return svg(figure)


def _scatter(axes: Axes, trials: Sequence[FrozenTrial], best: FrozenTrial, x: Mapping[int, float]) -> None:
    """Draw a point for the score of each trial at x, by its number."""
    for shown, colour, size in ((trials, PATH, 20), ([best], BEAM, 45)):
        places, scores = [x[trial.number] for trial in shown], [trial.value or 0.0 for trial in shown]
        axes.scatter(places, scores, size, color=colour, linewidths=0, rasterized=len(shown) > _MAX_MARKERS)
