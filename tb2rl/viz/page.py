"""The report: one HTML page that stands alone, made from runs, results of suites, drives and the templates here."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
from markupsafe import Markup

from tb2rl.evaluation.evaluator import EPISODES
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.rendering.colours import FAILED, FLOOR, GOAL, START, WALL
from tb2rl.viz.action_map import HEADINGS, ActionMap, action_map
from tb2rl.viz.charts import draw_curves, draw_time, draw_ways, shown_worlds, with_own_ids
from tb2rl.viz.curves import Family
from tb2rl.viz.drives import LINES, DriveSection
from tb2rl.viz.groups import Group, differences
from tb2rl.viz.palettes import ACTIONS, colours
from tb2rl.viz.subjects import Subject
from tb2rl.viz.suites import SuiteSection

_CURVES = (  # tag, title, label of the axis, whether it is a rate
    ("rollout/ep_rew_mean", "Return while training", "return of an episode", False),
    ("rollout/ep_len_mean", "Length while training", "steps of an episode", False),
    ("rollout/failure_rate", "Failures while training", "episodes that fail", True),
    ("failure_free_rate", "Evaluations on the way: failure-free", "failure-free episodes", True),
    ("success_rate", "Evaluations on the way: goal reached", "episodes that reach the goal", True),
)


@dataclass(frozen=True)
class Chart:
    """Learning curves of all groups that have them."""

    title: str
    families: Sequence[Family]
    picture: Markup
    rate: bool


@dataclass(frozen=True)
class Row:
    """A run with the pictures of it."""

    group: Group
    subject: Subject
    ways: Markup  # the paths of the evaluation
    time: Markup | None  # where its time was spent; None: in several worlds
    map: ActionMap | None  # what the policy does at each place; None: see `action_map`

    @classmethod
    def drawn(cls, group: Group, subject: Subject) -> Row:
        """Draw the pictures."""
        evaluation = subject.evaluation
        time = draw_time(evaluation) if len(subject.scene.spec.worlds) == 1 else None
        return cls(group, subject, draw_ways(evaluation), time, action_map(subject.policy, subject.config.scene))

    @property
    def worlds(self) -> tuple[int, int]:
        """How many worlds the paths are shown in, and how many there were episodes in."""
        evaluation = self.subject.evaluation
        return len(shown_worlds(evaluation)), len({episode.world for episode in evaluation.episodes})


def page(
    groups: Sequence[Group],
    suites: Sequence[SuiteSection] = (),
    drives: Sequence[DriveSection] = (),
    progress: bool = False,
) -> str:
    """The report as HTML.

    Args:
        groups: The runs that it shows.
        suites: The results of suites that it shows.
        drives: The drives of bags that it shows.
        progress: Whether to draw a bar, where there is a terminal.
    """
    pairs = [(group, subject) for group in groups for subject in group.subjects]
    rows = [Row.drawn(*pair) for pair in progress_bar(pairs, "drawing", "run", shown=progress)]
    subjects = [subject for _, subject in pairs]
    others = [*(suite.result.title for suite in suites), *(shown.drive.name for shown in drives)]
    return template("page.html").render(
        title=title(groups) if groups else "; ".join(others),
        groups=groups,
        suites=suites,
        drives=drives,
        rows=rows,
        subjects=subjects,
        charts=charts(groups),
        differences=differences(groups),
        action_colours=colours(max((len(subject.action_names) for subject in subjects), default=0), ACTIONS),
        colours={"start": START, "failed": FAILED, "goal": GOAL, "wall": WALL, "floor": FLOOR, **LINES},
        headings=HEADINGS,
        standard_episodes=EPISODES,
    )


def charts(groups: Sequence[Group]) -> list[Chart]:
    """The learning curves that at least one group has."""
    made = []
    for tag, title, label, rate in _CURVES:
        families = [family for group in groups if (family := _family(group, tag)).curves]
        if families:
            made.append(Chart(title, families, draw_curves(families, label, rate), rate))
    return made


def _family(group: Group, tag: str) -> Family:
    curves = [subject.curves[tag] for subject in group.subjects if tag in subject.curves]
    return Family(group.name, group.colour, curves)


def title(groups: Sequence[Group]) -> str:
    """What was trained."""
    subjects = [subject for group in groups for subject in group.subjects]
    trained = dict.fromkeys(f"{s.config.agent_name} at {s.config.task_name} in {s.scene.place}" for s in subjects)
    text = ", ".join(trained)
    return text if len(subjects) == 1 else f"{text}: {len(subjects)} runs"


def template(name: str, *folders: Path) -> jinja2.Template:
    """A template of this folder or of others, in which all values are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, *folders]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    numbers = itertools.count()
    environment.filters.update(
        spaced=_spaced, percent=_percent, plain=_plain, own=lambda picture: with_own_ids(picture, next(numbers))
    )
    return environment.get_template(name)


def _spaced(number: float) -> str:
    """600000 as 600 000, with spaces that do not break."""
    return f"{number:,.0f}".replace(",", "\u202f")


def _percent(share: float) -> str:
    return f"{100 * share:.1f}\u202f%"


def _plain(number: float) -> str:
    """A number with as many decimals as its size asks for."""
    return _spaced(number) if abs(number) >= 1000 else f"{number:.1f}"
