"""The report: one self-contained HTML page of runs, suite results and drives."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

from tb2rl.evaluation.evaluator import EPISODES
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.rendering.colours import FAILED, FLOOR, GOAL, START, WALL
from tb2rl.viz import charts
from tb2rl.viz.action_map import HEADINGS, action_map
from tb2rl.viz.curves import SeedCurves
from tb2rl.viz.drives import LINE_COLOURS, DriveSection
from tb2rl.viz.run_views import RunGroup, RunView, differences
from tb2rl.viz.suites import SuiteSection

_COLOURS = {"start": START, "failed": FAILED, "goal": GOAL, "wall": WALL, "floor": FLOOR, **LINE_COLOURS}
_CURVES = (  # key, title, label of the axis, whether it is a rate
    ("rollout/ep_rew_mean", "Return in training", "return of an episode", False),
    ("rollout/ep_len_mean", "Length in training", "steps of an episode", False),
    ("rollout/failure_rate", "Failures in training", "failed episodes", True),
    *(
        (metric.key, f"Evaluations during training: {metric.label}", "episodes", True)
        for metric in shown_metrics(goal_task=True)
        if metric.kind == "rate"
    ),
)


def page(
    groups: Sequence[RunGroup],
    suites: Sequence[SuiteSection] = (),
    drives: Sequence[DriveSection] = (),
    progress: bool = False,
) -> str:
    """The report as HTML; `progress` shows a progress bar if there is a terminal."""
    pairs = [(group, view) for group in groups for view in group.views]
    rows = [_row(*pair) for pair in progress_bar(pairs, "drawing", "run", shown=progress)]
    views = [view for _, view in pairs]
    others = [*(suite.result.title for suite in suites), *(section.drive.name for section in drives)]
    action_kinds = max((len(view.action_names) for view in views), default=0)
    return template("page.html").render(
        title=_title(views) if groups else "; ".join(others),
        groups=groups,
        suites=suites,
        drives=drives,
        rows=rows,
        views=views,
        charts=learning_curves(groups),
        differences=differences(groups),
        action_colours=charts.distinct_colours(action_kinds, charts.ACTION_COLOURS),
        colours=_COLOURS,
        headings=HEADINGS,
        standard_episodes=EPISODES,
        metrics=shown_metrics(any(view.config.task.goal_task for view in views)),
    )


def _row(group: RunGroup, view: RunView) -> dict[str, Any]:
    """A run with its pictures; a heat map is of one world."""
    evaluation = view.evaluation
    worlds = len({episode.world for episode in evaluation.episodes})
    return {
        "group": group,
        "view": view,
        "paths": charts.draw_episodes(evaluation),
        "heat_map": charts.draw_heat_map(evaluation) if len(evaluation.scene.spec.worlds) == 1 else None,
        "map": action_map(view.policy, view.config.scene),
        "worlds": worlds,
        "drawn_worlds": min(worlds, charts.MAX_WORLDS),
    }


def learning_curves(groups: Sequence[RunGroup]) -> list[dict[str, Any]]:
    """The charts of all curves that at least one group has."""
    drawn = []
    for key, title, label, is_rate in _CURVES:
        curves = [(group, [view.curves[key] for view in group.views if key in view.curves]) for group in groups]
        found = [SeedCurves(group.name, group.colour, each) for group, each in curves if each]
        if found:
            picture = charts.draw_curves(found, label, is_rate)
            drawn.append({"title": title, "groups": found, "picture": picture, "is_rate": is_rate})
    return drawn


def _title(views: Sequence[RunView]) -> str:
    names = (f"{v.config.agent_name} at {v.config.task_name} in {v.evaluation.scene.place}" for v in views)
    title = ", ".join(dict.fromkeys(names))
    return title if len(views) == 1 else f"{title}: {len(views)} runs"


def template(name: str, *folders: Path) -> jinja2.Template:
    """A template of this folder or of other folders; all values are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, *folders]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    numbers = itertools.count()
    environment.filters.update(
        spaced=_spaced,
        percent=lambda share: f"{100 * share:.1f}\u202f%",
        plain=lambda number: _spaced(number) if abs(number) >= 1000 else f"{number:.1f}",
        unique_ids=lambda picture: charts.with_unique_ids(picture, next(numbers)),
    )
    return environment.get_template(name)


def _spaced(number: float) -> str:
    """600000 as 600 000, with spaces that do not break."""
    return f"{number:,.0f}".replace(",", "\u202f")
