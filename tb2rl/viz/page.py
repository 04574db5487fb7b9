"""The report: a self-contained HTML page with runs, suite results and drives."""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from tb2rl.evaluation.evaluate import EPISODES
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.sim_to_sim import describe_place
from tb2rl.rendering import colours
from tb2rl.viz import charts
from tb2rl.viz.action_map import HEADINGS, action_map
from tb2rl.viz.drives import DriveSection
from tb2rl.viz.replay import RUN_STEPS, run_replays
from tb2rl.viz.run_views import TRAINING_CURVES, RunGroup, RunView, differences
from tb2rl.viz.suites import SuiteSection

_MAX_REPLAYED_RUNS = 3  # maximum number of runs with replays, because each takes 0.2 MB


def page(
    groups: Sequence[RunGroup],
    suites: Sequence[SuiteSection] = (),
    drives: Sequence[DriveSection] = (),
    progress_bar: bool = False,
) -> str:
    """The report as HTML; `progress_bar` shows a progress bar if there is a terminal."""
    runs = [(group, view) for group in groups for view in group.views]
    rows = [_row(group, view) for group, view in progress(runs, "drawing", "run", shown=progress_bar)]
    views = [view for _, view in runs]
    tasks = [view.config.task for view in views]
    metrics = shown_metrics(any(task.goal_task for task in tasks), any(task.filters for task in tasks))
    titles = [_title(views)] if views else [*(s.result.title for s in suites), *(d.drive.name for d in drives)]
    max_actions = max((len(view.action_shares) for view in views), default=0)
    return template("page.html").render(
        title="; ".join(titles),
        groups=groups,
        suites=suites,
        drives=drives,
        rows=rows,
        views=views,
        charts=learning_curves(groups),
        differences=differences(groups),
        replays=_replays_of_best(groups),
        replay_steps=RUN_STEPS,
        action_colours=charts.distinct_colours(max_actions, charts.ACTION_COLOURS),
        colours=colours,
        headings=HEADINGS,
        max_worlds=charts.MAX_WORLDS,
        standard_episodes=EPISODES,
        metrics={f"{metric.label} [{metric.unit}]" if metric.unit else metric.label: metric for metric in metrics},
    )


def _row(group: RunGroup, view: RunView) -> dict[str, Any]:
    """The data of a run for the templates; there is a heat map for a single world only."""
    paths, map_of_actions = charts.draw_episodes(view.evaluation), action_map(view.policy, view.config.scene)
    heat_map = charts.draw_heat_map(view.evaluation) if len(view.evaluation.scene.spec.worlds) == 1 else None
    return {"group": group, "view": view, "paths": paths, "heat_map": heat_map, "map": map_of_actions}


def _replays_of_best(groups: Sequence[RunGroup]) -> list[dict[str, Any]]:
    """Replays of a few runs: the best run of each group, then the second of each, and so on."""
    ranked = (sorted(group.views, key=lambda view: view.evaluation.score, reverse=True) for group in groups)
    views = [view for views in itertools.zip_longest(*ranked) for view in views if view]
    return [run_replays(view) for view in views[:_MAX_REPLAYED_RUNS]]


def learning_curves(groups: Sequence[RunGroup]) -> list[dict[str, Any]]:
    """The charts of all quantities for which at least one group has curves."""
    rates = [metric for metric in shown_metrics(goal_task=True) if metric.statistic == "rate"]
    evaluation_curves = {rate.key: (f"Evaluations (greedy policy): {rate.label}", "episodes", True) for rate in rates}
    drawn_charts = []
    for key, (title, label, is_rate) in {**TRAINING_CURVES, **evaluation_curves}.items():
        by_group = [(group, [view.curves[key] for view in group.views if key in view.curves]) for group in groups]
        seed_curves = [charts.SeedCurves(group.name, group.colour, curves) for group, curves in by_group if curves]
        if seed_curves:
            picture = charts.draw_curves(seed_curves, label, is_rate)
            drawn_charts.append({"title": title, "groups": seed_curves, "picture": picture, "is_rate": is_rate})
    return drawn_charts


def _title(views: Sequence[RunView]) -> str:
    names = (f"{v.config.agent_name} at {v.config.task_name} in {v.evaluation.scene.worlds_title}" for v in views)
    title = ", ".join(dict.fromkeys(names))
    return title if len(views) == 1 else f"{title}: {len(views)} runs"


def template(name: str, *folders: Path) -> jinja2.Template:
    """Load a template from this folder or others; it escapes all values."""
    loader = jinja2.FileSystemLoader([Path(__file__).parent, *folders])
    options: dict[str, Any] = {"undefined": jinja2.StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    environment = jinja2.Environment(loader=loader, autoescape=True, **options)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    chart_numbers = itertools.count()
    environment.filters.update(
        spaced=_format_spaced,
        percent=lambda share: f"{100 * share:z.1f}\u202f%",
        plain=lambda number: _format_spaced(number) if abs(number) >= 1000 else f"{number:.1f}",
        place=describe_place,
        unique_ids=lambda picture: _make_ids_unique(picture, next(chart_numbers)),
    )
    return environment.get_template(name)


def _make_ids_unique(picture: Markup, chart_number: int) -> Markup:
    """Prefix the ids of an SVG picture, because several charts on a page have the same ids."""
    text = str(picture)  # because `re.sub` would escape the pieces of `Markup` between the matches
    return Markup(re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>chart-{chart_number}-", text))


def _format_spaced(number: float) -> str:
    """Format 600000 as 600 000, with spaces that do not break."""
    return f"{number:,.0f}".replace(",", "\u202f")
