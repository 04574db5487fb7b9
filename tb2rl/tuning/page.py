"""What a study found, as files: the best settings as a preset, and the page."""

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
from tb2rl.tuning.judging import Comparison, Judgement
from tb2rl.tuning.study import BEST, PAGE, Search
from tb2rl.tuning.trials import best_trials, counts
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


def write_preset(search: Search, trial: FrozenTrial, judgement: Judgement, trials: int) -> Path:
    """Write the preset that makes a config of the trial, but for its seed."""
    low, high = judgement.interval
    where = {"bullet": "PyBullet", "kinematic": "the fast twin"}[judgement.simulation]
    lines = (
        f"# Found by tb2rl.tune: trial {trial.number} of {trials}, which began with {search.folder}/default.yaml.",
        f"# In {where} {100 * judgement.good_rate:.1f} % of {judgement.episodes} episodes are good "
        f"(95 % interval {100 * low:.1f} to {100 * high:.1f} %).",
    )
    tree = to_plain(search.preset(search.settings(trial.params)))
    file = search.folder / BEST
    write_text(file, "\n".join(lines) + "\n" + yaml.safe_dump(tree, sort_keys=False))
    return file


def write_page(
    search: Search,
    study: Study,
    judgements: Sequence[Judgement],
    best: FrozenTrial,
    comparisons: Sequence[Comparison] = (),
) -> Path:
    """Write the page.

    Args:
        search: The study.
        study: The same as Optuna has it.
        judgements: Of its best trials.
        best: The best of these.
        comparisons: Of the best and the default settings.
    """
    config = search.default
    text = template("study.html", Path(__file__).parent).render(
        title=f"Search: {config.agent_name} at {config.task_name} in {config.scene.place}",
        counts=counts(study),
        plan=search.plan,
        config=config,
        settings=settings_table(search, study, best),
        judgements=judgements,
        best=best,
        comparisons=comparisons,
        charts=draw_charts(study),
        trials=[(trial, _texts(search, trial)) for trial in best_trials(study, _LISTED)],
    )
    file = search.folder / PAGE
    write_text(file, text)
    return file


def settings_table(search: Search, study: Study, best: FrozenTrial) -> list[Setting]:
    """What was searched, what it was, and what was found."""
    mattered, found, tree = importances(study), search.settings(best.params), search.default.to_dict()
    return [
        Setting(key, str(entry), _text(_at(tree, key)), _text(found[key]), mattered.get(key))
        for key, entry in search.space.items()
    ]


def _texts(search: Search, trial: FrozenTrial) -> list[str]:
    """The settings of a trial, in the order of the space."""
    return [_text(value) for value in search.settings(trial.params).values()]


def _at(tree: Any, key: str) -> Any:
    """The value at a dotted key; None where the tree leaves it to a signature."""
    for name in key.split("."):
        tree = tree.get(name) if isinstance(tree, Mapping) else None
    return tree


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
