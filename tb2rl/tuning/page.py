"""The results of a study as files: the best settings as a preset, and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from optuna import Study
from optuna.trial import FrozenTrial

from tb2rl.core.files import write_text
from tb2rl.runs.plain_values import to_plain
from tb2rl.tuning.charts import draw_charts, importances
from tb2rl.tuning.selection import Comparison, TrialEvaluation
from tb2rl.tuning.study import BEST, PAGE, StudyFolder
from tb2rl.tuning.trials import best_trials, count_trials
from tb2rl.viz.page import template

_LISTED = 20  # trials


@dataclass(frozen=True)
class Setting:
    """A row of the table of settings."""

    key: str
    searched: str
    default: str
    best: str
    importance: float | None


def write_preset(folder: StudyFolder, trial: FrozenTrial, evaluation: TrialEvaluation, trials: int) -> Path:
    """Write the preset with the settings of a trial."""
    low, high = evaluation.interval
    lines = (
        f"# Found by tb2rl.tune: trial {trial.number} of {trials}, which began with {folder.path}/default.yaml.",
        f"# In {evaluation.simulator} {100 * evaluation.good_rate:.1f} % of {evaluation.episodes} episodes are good "
        f"(95 % interval {100 * low:.1f} to {100 * high:.1f} %).",
    )
    tree = to_plain(folder.preset(folder.settings(trial.params)))
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
    """Write the page.

    Args:
        folder: Of the study.
        study: The study.
        evaluations: Of the selected trials.
        best: The best of these.
        comparisons: Of the best and the default settings.
    """
    config = folder.default
    text = template("study.html", Path(__file__).parent).render(
        title=f"Search: {config.agent_name} at {config.task_name} in {config.scene.place}",
        counts=count_trials(study),
        options=folder.options,
        config=config,
        settings=_settings_table(folder, study, best),
        evaluations=evaluations,
        best=best,
        comparisons=comparisons,
        charts=draw_charts(study),
        trials=[(trial, _format_settings(folder, trial)) for trial in best_trials(study, _LISTED)],
    )
    file = folder.path / PAGE
    write_text(file, text)
    return file


def _settings_table(folder: StudyFolder, study: Study, best: FrozenTrial) -> list[Setting]:
    shares, found, tree = importances(study), folder.settings(best.params), folder.default.to_dict()
    return [
        Setting(key, str(entry), _format(_value_at(tree, key)), _format(found[key]), shares.get(key))
        for key, entry in folder.space.items()
    ]


def _format_settings(folder: StudyFolder, trial: FrozenTrial) -> list[str]:
    return [_format(value) for value in folder.settings(trial.params).values()]


def _value_at(tree: Any, key: str) -> Any:
    """The value at a dotted key; None if the tree has none."""
    for name in key.split("."):
        tree = tree.get(name) if isinstance(tree, Mapping) else None
    return tree


def _format(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
