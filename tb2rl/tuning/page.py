"""Writes the results of a study: a preset with the best settings, and a page with Optuna's charts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import yaml
from markupsafe import Markup
from matplotlib import pyplot as plt
from matplotlib.ticker import MaxNLocator
from optuna import Study, importance
from optuna.trial import FrozenTrial
from optuna.visualization.matplotlib import plot_optimization_history, plot_parallel_coordinate, plot_param_importances
from pydantic_core import to_jsonable_python

from tb2rl.core.files import write_text
from tb2rl.tuning.selection import Comparison, TrialEvaluation
from tb2rl.tuning.study import BEST, PAGE, StudyFolder
from tb2rl.tuning.trials import best_trials, count_trials
from tb2rl.viz.charts import STYLE, WIDTH, svg
from tb2rl.viz.page import template

_LISTED_TRIALS = 20  # number of trials in the table of the page
_MIN_TRIALS = 10  # complete trials for importances, because those of fewer trials are chance


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
    config, importances = folder.default, _importances(study)
    text = template("study.html", Path(__file__).parent).render(
        title=f"Search: {config.agent_name} at {config.task_name} in {config.scene.worlds_title}",
        counts=count_trials(study),
        folder=folder,
        default=config.to_dict(),
        shares=importances,
        min_trials=_MIN_TRIALS,
        evaluations=evaluations,
        best=best,
        comparisons=comparisons,
        charts=_draw_charts(study, bool(importances)),
        trials=best_trials(study, _LISTED_TRIALS),
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
    has_enough_trials = len(best_trials(study)) >= _MIN_TRIALS and _scores_differ(study)
    return importance.get_param_importances(study) if has_enough_trials else {}


def _scores_differ(study: Study) -> bool:
    return len({trial.value for trial in best_trials(study)}) > 1


def _draw_charts(study: Study, has_importances: bool) -> dict[str, Markup]:
    """Draw Optuna's charts as SVG, by title; the chart of each trial's settings needs several scores and settings."""
    plots: dict[str, Any] = {"Scores": plot_optimization_history}
    if has_importances:
        plots["Importance of the settings"] = plot_param_importances
    if _scores_differ(study) and len(study.best_trial.params) > 1:
        plots["Settings of each trial"] = plot_parallel_coordinate
    matplotlib.use("agg")  # because Optuna uses pyplot, which would open a window
    charts = {}
    with matplotlib.rc_context(STYLE | {"savefig.bbox": "tight", "text.parse_math": True}):
        for title, plot in plots.items():
            axes = plot(study, target_name="score")
            axes.set_title("", loc="left")
            axes.set_title("")
            if plot is plot_optimization_history:
                axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
                # Above the axes, because beside them it takes half of the width.
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
            # Larger than other charts, because Optuna's text is larger.
            axes.figure.set_size_inches((2.8 if plot is plot_parallel_coordinate else 1.25) * WIDTH, WIDTH)
            charts[title] = svg(axes.figure)
            plt.close(axes.figure)
    return charts
