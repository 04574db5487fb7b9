"""The report of one run or of several: a page that stands alone, to read in a browser or on paper.

    python -m tb2rl.report runs/maze/ppo/mine
    python -m tb2rl.report runs/maze/qlearn/seeds runs/maze/dqn/seeds --out comparison.html

A folder of runs, as `train --seeds` leaves it, stands for the runs in it. Runs that differ in nothing but their seed
are drawn together. The page shows learning curves, the standard evaluation, where its episodes went, and what the
policy does at each place; it loads nothing from anywhere.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.colors import to_hex
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.actions import HEADINGS, ActionMap, action_map, action_names
from tb2rl.charts import draw_curves, draw_time, draw_ways, with_own_ids
from tb2rl.config import Config
from tb2rl.curves import Curve, Family, read_curves
from tb2rl.errors import ArgumentParser, InputError, command, one_line
from tb2rl.evaluation import EPISODES, Evaluation, bootstrap_interval, evaluate, has_kept, kept
from tb2rl.maze import Maze, load_maze
from tb2rl.render import CRASH, FLOOR, GOAL, START, WALL
from tb2rl.runs import Run, checkpoint_file, config_of, load, write
from tb2rl.settings import read_yaml, room

_HERE = 20  # episodes of an evaluation that is made for the page
# Of groups, and of actions: the colour-blind tell them apart, too; most are Okabe and Ito's.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9", "#8c564b")
_ACTION_COLOURS = ("#9ecae9", "#e69f00", "#4b3a8c", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#6b7280")
_CURVES = (  # tag, title, label of the axis, whether it is a rate
    ("rollout/ep_rew_mean", "Return while training", "return of an episode", False),
    ("rollout/ep_len_mean", "Length while training", "steps of an episode", False),
    ("rollout/crash_rate", "Crashes while training", "episodes that crash", True),
    ("crash_free_rate", "Evaluations on the way: crash-free", "crash-free episodes", True),
    ("success_rate", "Evaluations on the way: goal reached", "episodes that reach the goal", True),
)


@dataclass(frozen=True)
class Subject:
    """A run, read for the page.

    Attributes:
        name: What the page calls it.
        config: What it was trained to do.
        versions: Of what trained it.
        policy: The one that stands for it.
        curves: Figures over its training, by the tags of `_CURVES`; those that it has.
        evaluation: The standard one, or a shorter one.
        kept: Whether the evaluation is the one in the run folder.
    """

    name: str
    config: Config
    versions: Mapping[str, str]
    policy: BaseAlgorithm
    curves: Mapping[str, Curve]
    evaluation: Evaluation
    kept: bool

    @property
    def trained(self) -> int:
        """Control steps of the training, as far as its files tell; an unfinished one has fewer than its config."""
        return int(max([self.policy.num_timesteps, *(curve.steps[-1] for curve in self.curves.values())]))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The figures of the evaluation."""
        return self.evaluation.summary()

    @cached_property
    def maze(self) -> Maze:
        """Where it drives."""
        return load_maze(self.evaluation.task.maze)

    @cached_property
    def ways(self) -> Markup:
        """A picture of the paths of the evaluation."""
        return draw_ways(self.maze, self.evaluation)

    @cached_property
    def time(self) -> Markup:
        """A picture of where the time of the evaluation was spent."""
        return draw_time(self.maze, self.evaluation)

    @cached_property
    def action_shares(self) -> np.ndarray:
        """Share of the evaluation's steps that took each action, shape (actions,)."""
        taken = np.concatenate([episode.actions for episode in self.evaluation.episodes])
        return np.bincount(taken, minlength=len(self.evaluation.task.commands)) / len(taken)

    @property
    def action_names(self) -> list[str]:
        """What the page calls its actions."""
        return action_names(self.evaluation.task.commands)

    @cached_property
    def map(self) -> ActionMap:
        """What the policy does at each place."""
        return action_map(self.policy, self.config)

    @property
    def visits(self) -> np.ndarray | None:
        """Updates of each pair of state and action, shape (states, actions), of a policy that counts them."""
        visits = getattr(self.policy.policy, "visits", None)
        return None if visits is None else visits.numpy()

    @property
    def median_visits(self) -> float:
        """Of the pairs that were updated at all."""
        assert self.visits is not None
        updated = self.visits[self.visits > 0]
        return float(np.median(updated)) if updated.size else 0.0


@dataclass(frozen=True)
class Group:
    """Runs that differ in nothing but their seed."""

    name: str
    colour: str
    subjects: Sequence[Subject]

    @property
    def config(self) -> Config:
        """What they share; its seed is the first one's."""
        return self.subjects[0].config

    @property
    def seeds(self) -> list[int]:
        """The seed of each."""
        return [subject.config.train.seed for subject in self.subjects]

    @property
    def trained(self) -> list[int]:
        """Control steps of the shortest and of the longest training, once if they are equal."""
        steps = [subject.trained for subject in self.subjects]
        return sorted({min(steps), max(steps)})

    @property
    def settings(self) -> dict[str, str]:
        """Everything that was decided, and the versions that ran it, by dotted key."""
        return {
            **_flat(self.config.to_dict()),
            "train.seed": ", ".join(map(str, self.seeds)),
            **_flat({"version": self.subjects[0].versions}),
        }

    def mean(self, figure: str) -> tuple[float, tuple[float, float]]:
        """Mean and 95 % bootstrap interval of a figure of `Evaluation.summary` over the runs."""
        values = [subject.summary[figure] for subject in self.subjects]
        return float(np.mean(values)), bootstrap_interval(values)


@dataclass(frozen=True)
class Chart:
    """Learning curves of all groups that have them."""

    title: str
    families: Sequence[Family]
    picture: Markup
    rate: bool


def run_folders(reference: str) -> list[Path]:
    """The run folders that a reference means: a run's, those in a folder of runs, or a zoo entry's.

    Raises:
        InputError: If there is none.
    """
    if reference.startswith("zoo:"):
        return [checkpoint_file(reference).parents[1]]
    folder = Path(reference)
    if not folder.is_dir():
        raise InputError(f"there is no run folder {one_line(reference)}")
    if (folder / "config.yaml").is_file():
        return [folder]
    inside = sorted(file.parent for file in folder.glob("*/config.yaml"))
    if not inside:
        raise InputError(f"{folder} is neither a run folder nor a folder of them: there is no config.yaml in it")
    return inside


def read_subject(folder: Path, name: str) -> Subject:
    """Read a run folder; a run that has no standard evaluation with its paths is evaluated.

    Raises:
        InputError: If the folder does not hold what it should.
    """
    config = Run.open(folder).config
    curves = read_curves(folder)
    if not config.task_settings.goal_task:  # without a goal, to succeed is not to crash
        curves.pop("success_rate", None)
    policy = load(folder)
    if _untrained(config_of(policy)) != _untrained(config):
        raise InputError(f"{folder}: config.yaml is not what its policy was trained with")
    found = has_kept(folder)
    evaluation = kept(folder) if found else evaluate(policy, episodes=_HERE)
    if replace(evaluation.task, episode_steps=config.task_settings.episode_steps) != config.task_settings:
        raise InputError(f"{folder}: evaluation.json is not of the task in config.yaml")
    return Subject(name, config, _versions(folder), policy, curves, evaluation, found)


def _untrained(config: Config) -> dict[str, Any]:
    """What resuming a training cannot change."""
    return {key: value for key, value in config.to_dict().items() if key != "train"}


def _versions(folder: Path) -> dict[str, str]:
    versions = read_yaml(folder / "config.yaml").get("versions", {})
    return {str(key): str(value) for key, value in versions.items()} if isinstance(versions, Mapping) else {}


def grouped(subjects: Iterable[Subject]) -> list[Group]:
    """Put runs that differ in nothing but their seed together, in the order of their seeds.

    Raises:
        InputError: If two do not even differ in that: their mean would count one training twice.
    """
    together: dict[str, dict[int, Subject]] = {}
    for subject in subjects:
        seed, unseeded = subject.config.train.seed, replace(subject.config.train, seed=0)
        settings = {**replace(subject.config, train=unseeded).to_dict(), "versions": subject.versions}
        seeds = together.setdefault(json.dumps(settings, sort_keys=True), {})
        if seed in seeds:
            raise InputError(f"{seeds[seed].name} and {subject.name} are the same training: name one of them")
        seeds[seed] = subject
    palette = colours(len(together), _COLOURS)
    names = [subject.name for seeds in together.values() for subject in seeds.values()]
    return [
        Group(
            _name([subject.name for subject in seeds.values()], names), colour, [seeds[seed] for seed in sorted(seeds)]
        )
        for colour, seeds in zip(palette, together.values(), strict=True)
    ]


def _name(names: Sequence[str], everyone: Sequence[str]) -> str:
    """What the names of some runs have in common, and those of no others."""
    shared = os.path.commonpath(names)
    theirs = [name for name in everyone if shared and os.path.commonpath([shared, name]) == shared]
    return shared if len(names) == 1 or theirs == list(names) else f"{names[0]} and {len(names) - 1} more"


def colours(count: int, first: Sequence[str]) -> Sequence[str]:
    """So many colours: the first ones, or hues all around if these are too few."""
    hues = colormaps["turbo"](np.linspace(0, 1, count))
    return first[:count] if count <= len(first) else [to_hex(hue) for hue in hues]


def differences(groups: Sequence[Group]) -> dict[str, list[str]]:
    """The settings in which groups differ, by dotted key, with the value in each group."""
    trees = [group.settings for group in groups]
    keys = sorted({key for tree in trees for key in tree} - {"train.seed"})
    rows = {key: [tree.get(key, "") for tree in trees] for key in keys}
    return {key: values for key, values in rows.items() if len(set(values)) > 1}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = "none" if value is None else str(value)
    return flat


def charts(groups: Sequence[Group]) -> list[Chart]:
    """The learning curves that at least one group has."""
    made = []
    for tag, title, label, rate in _CURVES:
        families = []
        for group in groups:
            curves = [subject.curves[tag] for subject in group.subjects if tag in subject.curves]
            if curves:
                families.append(Family(group.name, group.colour, curves))
        if families:
            made.append(Chart(title, families, draw_curves(families, label, rate), rate))
    return made


def title(groups: Sequence[Group]) -> str:
    """What was trained."""
    subjects = [subject for group in groups for subject in group.subjects]
    trained = dict.fromkeys(f"{s.config.agent} at {s.config.task} in {s.maze.name}" for s in subjects)
    text = ", ".join(trained)
    return text if len(subjects) == 1 else f"{text}: {len(subjects)} runs"


def page(groups: Sequence[Group]) -> str:
    """The report as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("assets")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    numbers, actions = itertools.count(), max(len(s.action_names) for group in groups for s in group.subjects)
    environment.filters.update(
        spaced=_spaced, percent=_percent, plain=_plain, own=lambda picture: with_own_ids(picture, next(numbers))
    )
    return environment.get_template("report.html").render(
        title=title(groups),
        groups=groups,
        rows=[(group, subject) for group in groups for subject in group.subjects],
        subjects=[subject for group in groups for subject in group.subjects],
        charts=charts(groups),
        differences=differences(groups),
        action_colours=colours(actions, _ACTION_COLOURS),
        colours={"start": START, "crash": CRASH, "goal": GOAL, "wall": WALL, "floor": FLOOR},
        headings=HEADINGS,
        standard_episodes=EPISODES,
    )


def _spaced(number: float) -> str:
    """600000 as 600 000, with spaces that do not break."""
    return f"{number:,.0f}".replace(",", "\u202f")


def _percent(share: float) -> str:
    return f"{100 * share:.1f}\u202f%"


def _plain(number: float) -> str:
    """A number with as many decimals as its size asks for."""
    return _spaced(number) if abs(number) >= 1000 else f"{number:.1f}"


@command
def main(arguments: list[str] | None = None) -> None:
    """Read the runs, write the page, say where it is."""
    parser = ArgumentParser(prog="python -m tb2rl.report", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN", help="run folder, folder of run folders, or zoo:NAME")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="the page (default: report.html, in RUN if it is one folder)"
    )
    options = parser.parse_args(arguments)
    folders = list(dict.fromkeys(folder.resolve() for run in options.runs for folder in run_folders(run)))
    out = _page_file(options)
    groups = grouped(read_subject(folder, name) for folder, name in zip(folders, _names(folders), strict=True))
    text = page(groups)
    try:
        write(out, text)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}") from None
    count = "1 run" if len(folders) == 1 else f"{len(folders)} runs"
    print(f"{out}: {count}, {len(text.encode()) / 1e6:.1f} MB")


def _page_file(options: argparse.Namespace) -> Path:
    """Where the page goes; an `InputError` if it cannot, before any work is done."""
    alone = Path(options.runs[0]) if len(options.runs) == 1 else Path()
    out = options.out or (alone if alone.is_dir() else Path()) / "report.html"
    if out.is_dir() or not out.absolute().parent.is_dir() or not os.access(out.absolute().parent, os.W_OK):
        raise InputError(f"cannot write {out}: name a file in a folder that exists and takes files")
    return out


def _names(folders: Sequence[Path]) -> list[str]:
    """What the page calls runs: the names of zoo entries, of other folders what their paths do not have in common."""
    zoo = room("zoo").resolve()
    others = [folder for folder in folders if folder.parent != zoo]
    shared = os.path.commonpath([folder.parent for folder in others]) if others else ""
    return [f"zoo:{folder.name}" if folder.parent == zoo else os.path.relpath(folder, shared) for folder in folders]


if __name__ == "__main__":
    main()
