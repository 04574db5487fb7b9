"""Optuna's charts of a study, as elements of a page."""

from __future__ import annotations

import warnings
from typing import Any

import matplotlib
from markupsafe import Markup
from matplotlib import pyplot as plt
from optuna import Study, importance
from optuna.exceptions import ExperimentalWarning
from optuna.trial import TrialState
from optuna.visualization.matplotlib import plot_optimization_history, plot_parallel_coordinate, plot_param_importances

from tb2rl.viz.charts import STYLE, WIDTH, svg


def importances(study: Study) -> dict[str, float]:
    """Importance of each parameter as a share of all, by PED-ANOVA (Watanabe et al. 2023), the largest first.

    Empty if there are too few trials, or all have the same score.
    """
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len({trial.value for trial in complete}) < 2:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return importance.get_param_importances(study)


def draw_charts(study: Study) -> dict[str, Markup]:
    """The charts by title; those of parameters only if the study has enough trials."""
    plots: dict[str, Any] = {"Scores": plot_optimization_history}
    if params := list(importances(study)):
        plots |= {"Importance of the settings": plot_param_importances}
    if len(params) > 1:
        plots |= {"Settings of each trial": plot_parallel_coordinate}
    matplotlib.use("agg")  # Optuna draws with pyplot, which would open a window
    charts = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        for title, plot in plots.items():
            width = 2.2 * WIDTH if plot is plot_parallel_coordinate else WIDTH
            with matplotlib.rc_context(STYLE | {"savefig.bbox": "tight", "text.parse_math": True}):
                axes = plot(study, target_name="score")
                axes.set_title("", loc="left")
                axes.set_title("")
                axes.figure.set_size_inches(width, 0.8 * WIDTH)
                charts[title] = svg(axes.figure)
                plt.close(axes.figure)
    return charts
