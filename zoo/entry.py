"""Entries of the zoo: recipe, files and figures of a policy."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tb2rl.commands.train import requested_config
from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import read_text, read_yaml, top_folder
from tb2rl.envs.worlds import are_generated
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.runs.config import Config
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, Run
from tb2rl.simulation.variation import varied
from tb2rl.tasks.navigate import Navigate
from tb2rl.train import parse as parse_training
from tb2rl.worlds.dynamic_obstacles import among
from tb2rl.zoo.suite_policies import SuitePolicy

MAZES = ("loop", "circuit", "round", "maze")  # the closed ones: in `wall` a robot that drives away is safe
WORLDS = (*MAZES, "mixed")
UNSEEN = "unseen"  # the suite of worlds that nothing is trained in
ELSEWHERE = "elsewhere.json"  # figures in unseen worlds, in an entry's folder
# Share of good episodes.
PROMISED, PROMISED_TABULAR, PROMISED_WITHOUT_PLAN, PROMISED_AMONG_PEOPLE = 0.99, 0.95, 0.96, 0.9
GOOD_SPEED, GOOD_SPEED_ANYWHERE = 0.75, 0.6  # of the fastest command; between posts all turn more


@dataclass(frozen=True)
class Entry:
    """A policy of the zoo; its files exist once it is built."""

    name: str
    recipe: str  # arguments of `python -m tb2rl.train`
    folder: Path

    @cached_property
    def config(self) -> Config:
        """The config of its training."""
        return Run.open(self.folder).config

    @property
    def requested(self) -> Config:
        """The config of its recipe."""
        return requested_config(parse_training(shlex.split(self.recipe)))

    @cached_property
    def figures(self) -> dict[str, Any]:
        """The standard evaluation, see `Evaluation.summary`; `each` has its episodes."""
        return _read(self.folder / EVALUATION)[0]

    @cached_property
    def elsewhere(self) -> dict[str, dict[str, Any]]:
        """The same figures by unseen world."""
        file = self.folder / ELSEWHERE
        return _read(file)[0] if file.is_file() else {}

    @property
    def navigates(self) -> bool:
        """Whether it drives to any goal; then it is evaluated in suites instead of unseen worlds."""
        return isinstance(self.config.task, Navigate)

    @property
    def conditions(self) -> str:
        """Guide, dynamic obstacles and variation of its task: "guide plan, among 8 people, mild variation"."""
        guide, moves = getattr(self.config.task, "guide", ""), among(self.config.scene.spec.dynamic_obstacles)
        return ", ".join(filter(None, (guide and f"guide {guide}", moves, varied(self.config.task.variation))))

    @cached_property
    def suite_policy(self) -> SuitePolicy:
        """Its drives through suites, if it navigates."""
        return SuitePolicy(self.name, f"zoo:{self.name}", suites_folder())

    @cached_property
    def notes(self) -> list[dict[str, Any]]:
        """The evaluations while training."""
        return _read(self.folder / EVALUATIONS, lines=True)

    @property
    def is_built(self) -> bool:
        """Whether it is trained, and evaluated in all unseen worlds or in the suite of unseen worlds."""
        if not (self.folder / EVALUATION).is_file() or self.not_driven:
            return False
        return not self.navigates or self.suite_policy.summary(UNSEEN) is not None

    @property
    def not_driven(self) -> list[str]:
        """Unseen worlds that fit its task and lack figures; none if it `navigates`."""
        if self.navigates:
            return []
        others = [world for world in WORLDS if world != self.world and world not in self.elsewhere]
        return [world for world in others if self._fits(world)]

    def _fits(self, world: str) -> bool:
        """Whether its task fits a world, which must have a goal if the task needs one."""
        try:
            self.config.with_task({"world": world})
        except InputError:
            return False
        return True

    @property
    def is_as_requested(self) -> bool:
        """Whether it was trained as its recipe says."""
        return self.config.to_dict() == self.requested.to_dict()

    @property
    def world(self) -> str:
        """The name of the world that it was trained in."""
        return self.config.task.world

    @property
    def place(self) -> str:
        """The world and, if it is not the usual one, the robot that it was trained with."""
        return self.config.scene.place

    @property
    def beams(self) -> int:
        """Number of observed laser beams."""
        return len(self.config.scene.laser.angles)

    @property
    def good(self) -> str:
        """Prefix of the rate of good episodes."""
        return "success" if self.config.task.goal_task else "failure_free"

    @property
    def good_rate(self) -> float:
        """Share of the good episodes in the standard evaluation."""
        return self.figures[f"{self.good}_rate"]

    @property
    def promised(self) -> float:
        """The share of good episodes that the zoo promises."""
        if self.config.observation == "discrete":
            return PROMISED_TABULAR
        if self.config.scene.spec.dynamic_obstacles:
            return PROMISED_AMONG_PEOPLE
        return PROMISED_WITHOUT_PLAN if getattr(self.config.task, "guide", "") == "goal" else PROMISED

    @property
    def promised_speed(self) -> float:
        """The share of the fastest command's speed that the zoo promises; 0 where the way to the goal decides."""
        if self.good == "success":
            return 0.0
        return GOOD_SPEED_ANYWHERE if are_generated(self.config.task.world) else GOOD_SPEED

    @property
    def metric_rows(self) -> list[tuple[str, str, str]]:
        """Label, figure and spread of the metrics in the standard evaluation."""
        shown = shown_metrics(self.config.task.goal_task)
        return [metric.row(self.figures) for metric in shown if metric.key in self.figures]  # older ones lack some

    @property
    def speed_share(self) -> float:
        """Mean speed over that of the fastest command, which no driver can exceed."""
        return self.figures["mean_speed"] / self.config.scene.actions.max_speed

    @property
    def trained(self) -> int:
        """Training steps."""
        return self.notes[-1]["timesteps"]

    @property
    def kept_after(self) -> int:
        """Training steps of the policy that was kept."""
        return next(note["timesteps"] for note in reversed(self.notes) if note["best"])


def _read(file: Path, lines: bool = False) -> list[Any]:
    """The JSON in a file, or in each line of it."""
    text = read_text(file)
    try:
        return [json.loads(part) for part in (text.splitlines() if lines else [text])]
    except ValueError as error:
        raise InputError(one_line(f"{file} is not JSON: {error}")) from None


def zoo_folder() -> Path:
    """The folder of the zoo."""
    return top_folder("zoo")


def suites_folder() -> Path:
    """The folder of the summaries of suites."""
    return zoo_folder() / "suites"


def entries() -> list[Entry]:
    """All policies."""
    recipes = read_yaml(zoo_folder() / "recipes.yaml")
    return [Entry(name, recipe, zoo_folder() / name) for name, recipe in recipes.items()]


def other_suite_policies() -> list[SuitePolicy]:
    """The policies of `suites.yaml`."""
    file = zoo_folder() / "suites.yaml"
    listed = read_yaml(file) if file.is_file() else {}
    return [SuitePolicy(name, arguments, suites_folder()) for name, arguments in listed.items()]


def suite_policies_of(built: Iterable[Entry]) -> list[SuitePolicy]:
    """The entries that navigate."""
    return [entry.suite_policy for entry in built if entry.navigates]


def select(names: Sequence[str]) -> tuple[list[Entry], list[SuitePolicy]]:
    """The entries and the other suite policies of these names; without names all.

    Raises:
        InputError: If a name is unknown.
    """
    policies, others = entries(), other_suite_policies()
    known = [each.name for each in (*policies, *others)]
    for name in names:
        if name not in known:
            raise unknown("zoo policy", name, known)
    wanted = names or known
    return [entry for entry in policies if entry.name in wanted], [other for other in others if other.name in wanted]
