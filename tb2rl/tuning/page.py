"""Writes the results of a study: a preset with the best settings, and a page with Optuna's charts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import yaml
from markupsafe import Markup
from matplotlib import pyplot as plt
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
        evaluations=evaluations,
        best=best,
        comparisons=comparisons,
        charts=_draw_charts(study, len(importances)),
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
    if len({trial.value for trial in best_trials(study)}) < 2:
        return {}
    return importance.get_param_importances(study)


def _draw_charts(study: Study, num_importances: int) -> dict[str, Markup]:
    """Draw Optuna's charts as SVG, by title; charts of parameters need enough trials and parameters."""
    plots: dict[str, Any] = {"Scores": plot_optimization_history}
    if num_importances:
        plots["Importance of the settings"] = plot_param_importances
    if num_importances > 1:
        plots["Settings of each trial"] = plot_parallel_coordinate
    matplotlib.use("agg")  # because Optuna uses pyplot, which would open a window
    charts = {}
    with matplotlib.rc_context(STYLE | {"savefig.bbox": "tight", "text.parse_math": True}):
        for title, plot in plots.items():
            axes = plot(study, target_name="score")
            axes.set_title("", loc="left")
            axes.set_title("")
            axes.figure.set_size_inches(2.2 * WIDTH if plot is plot_parallel_coordinate else WIDTH, 0.8 * WIDTH)
            charts[title] = svg(axes.figure)
            plt.close(axes.figure)
    return charts
