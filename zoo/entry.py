"""Entries of the zoo (a trained policy with its recipe, files and evaluations), and policies that suites compare."""

import json
import shlex
from argparse import Namespace
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tb2rl.commands.evaluate import chosen_policy
from tb2rl.commands.evaluate import run as evaluate
from tb2rl.commands.train import requested_config
from tb2rl.core import InputError, one_line, read_text, read_yaml, top_folder, unknown, write_text
from tb2rl.envs.worlds import are_generated
from tb2rl.evaluate import main as evaluate_command
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.suites import SuiteResult
from tb2rl.runs import EVALUATION, TRAINING_EVALUATIONS, Config, Run, config_from, policy_digest, read_lines
from tb2rl.simulation.variation import describe_variation
from tb2rl.tasks.navigate import Navigate
from tb2rl.train import main as train_command
from tb2rl.worlds.dynamic_obstacles import describe_groups
from tb2rl.worlds.suites import SUITES, Suite

_RESULTS = Path("runs", "suites")  # folder of the complete results, with a row for each world
# Worlds for evaluations; without world `wall`, whose open sides let a robot drive away without collisions.
WORLDS = ("loop", "circuit", "round", "maze", "mixed")
UNSEEN_SUITE = "unseen"  # the suite of worlds that no training uses
# File in the folder of an entry: evaluations in those `WORLDS` in which its policy was not trained (no suites).
UNSEEN_WORLDS_FILE = "unseen_worlds.json"
# Promised rates of good episodes (see `Entry.criterion`).
PROMISED, PROMISED_TABULAR, PROMISED_MAPLESS, PROMISED_AMONG_PEOPLE = 0.99, 0.95, 0.96, 0.9
# Promised mean speeds relative to the fastest command; lower in generated worlds, where round posts require more turns.
PROMISED_SPEED, PROMISED_SPEED_GENERATED = 0.75, 0.6


@dataclass(frozen=True)
class SuitePolicy:
    """A policy for suites, and its results."""

    name: str
    arguments: str  # arguments of `python -m tb2rl.evaluate` without `--suite`
    folder: Path  # folder of the summaries

    @property
    def evaluate_options(self) -> Namespace:
        """The parsed arguments, a new object for each call."""
        return evaluate_command.parse(shlex.split(self.arguments))

    @cached_property
    def config(self) -> Config:
        """Config of the evaluation."""
        return chosen_policy(self.evaluate_options)[1]

    @property
    def digest(self) -> str | None:
        """Digest of the checkpoint; None for an agent that does not learn."""
        return policy_digest(policy) if (policy := self.evaluate_options.policy) else None

    def file(self, suite: str) -> Path:
        """File of the summary in a suite."""
        return self.folder / f"{self.name}-{suite}.json"

    def summary(self, suite: str) -> SuiteResult | None:
        """The summary in a suite; None if the file is missing, or stale because policy or task have changed."""
        if not self.file(suite).is_file():
            return None
        summary = SuiteResult.read(self.file(suite))
        try:
            config = config_from(summary.config)  # adds defaults of settings that are newer than the file
        except InputError:
            return None
        is_same = (summary.suite, summary.policy_digest) == (suite, self.digest)
        return summary if is_same and config.to_dict() == self.config.to_dict() else None

    @property
    def summaries(self) -> list[SuiteResult]:
        """The summaries in all suites, without missing and stale ones."""
        return [summary for suite in SUITES if (summary := self.summary(suite)) is not None]

    def evaluate_in(self, suite: Suite, options: Namespace) -> None:
        """Evaluate in a suite and write the summary if it is missing or stale; continues an interrupted evaluation.

        Args:
            suite: The suite.
            options: Options of `zoo build`: `again` replaces a valid summary, `on` and `workers` select the executor.
        """
        summary = self.summary(suite.name)
        if summary is not None and summary.suite_digest == suite.digest and not options.again:
            return
        print(f"{self.name} in suite {suite.name}", flush=True)
        result_file = _RESULTS / self.file(suite.name).name
        result_file.parent.mkdir(parents=True, exist_ok=True)
        evaluate_options = self.evaluate_options
        evaluate_options.suite = [suite.name, *([] if suite.path is None else [str(suite.path)])]
        evaluate_options.json, evaluate_options.on, evaluate_options.workers = result_file, options.on, options.workers
        evaluate(evaluate_options)
        self.folder.mkdir(exist_ok=True)
        text = json.dumps(asdict(SuiteResult.read(result_file).summary), indent=1, allow_nan=False)
        write_text(self.file(suite.name), text + "\n")


@dataclass(frozen=True)
class Entry:
    """A policy of the zoo. Its files exist after `zoo build`, and each is read only once."""

    name: str
    recipe: str  # arguments of `python -m tb2rl.train`
    folder: Path

    @cached_property
    def config(self) -> Config:
        """Config of the training, from the files."""
        return Run.open(self.folder).config

    @property
    def recipe_config(self) -> Config:
        """Config of the recipe."""
        return requested_config(train_command.parse(shlex.split(self.recipe)))

    @property
    def matches_recipe(self) -> bool:
        """Whether the policy was trained with the config of its recipe."""
        return (self.folder / "config.yaml").is_file() and self.config.to_dict() == self.recipe_config.to_dict()

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Summary of the standard evaluation, see `Evaluation.summary`; key "each" has the episodes."""
        return _read_json(self.folder / EVALUATION)

    @cached_property
    def unseen_world_summaries(self) -> dict[str, dict[str, Any]]:
        """Summaries of evaluations in unseen worlds, by world."""
        file = self.folder / UNSEEN_WORLDS_FILE
        return _read_json(file) if file.is_file() else {}

    def add_unseen_world(self, world: str, summary: dict[str, Any]) -> None:
        """Add the summary of an evaluation in an unseen world, also to the file."""
        self.unseen_world_summaries[world] = summary
        in_order = {name: self.unseen_world_summaries[name] for name in WORLDS if name in self.unseen_world_summaries}
        write_text(self.folder / UNSEEN_WORLDS_FILE, json.dumps(in_order, indent=1) + "\n")

    @cached_property
    def evaluations(self) -> list[dict[str, Any]]:
        """Evaluations during the training."""
        return read_lines(self.folder / TRAINING_EVALUATIONS)

    @property
    def navigates(self) -> bool:
        """Whether the task is `navigate`, which is evaluated in suites, and not in other `WORLDS`."""
        return isinstance(self.config.task, Navigate)

    @cached_property
    def suite_policy(self) -> SuitePolicy:
        """The policy and its results in suites; only for task `navigate`."""
        return SuitePolicy(self.name, arguments=f"zoo:{self.name}", folder=suites_folder())

    @property
    def is_built(self) -> bool:
        """Whether the training and all evaluations are complete: in `WORLDS` or, for `navigate`, in suite `unseen`."""
        if not (self.folder / EVALUATION).is_file() or self.missing_worlds:
            return False
        return not self.navigates or self.suite_policy.summary(UNSEEN_SUITE) is not None

    @property
    def missing_worlds(self) -> list[str]:
        """Unseen worlds that are still to be evaluated."""
        missing = []
        for world in () if self.navigates else WORLDS:
            if world not in (self.config.task.world, *self.unseen_world_summaries):
                with suppress(InputError):  # worlds without a goal are invalid for some tasks
                    self.config.with_task({"world": world})
                    missing.append(world)
        return missing

    @property
    def conditions(self) -> str:
        """Guide, dynamic obstacles and variation of the task: "guide plan, among 8 people, mild variation"."""
        guide = getattr(self.config.task, "guide", "")
        obstacles = describe_groups(self.config.scene.spec.dynamic_obstacles)
        variation = describe_variation(self.config.task.variation)
        return ", ".join(filter(None, (guide and f"guide {guide}", obstacles, variation)))

    @property
    def criterion(self) -> str:
        """Criterion of a good episode: "success" for tasks with a goal, else "failure_free"."""
        return "success" if self.config.task.goal_task else "failure_free"

    @property
    def good_rate(self) -> float:
        """Rate of good episodes in the standard evaluation."""
        return self.summary[f"{self.criterion}_rate"]

    @property
    def promised_rate(self) -> float:
        """Rate of good episodes that the zoo promises."""
        if self.config.observation == "discrete":
            return PROMISED_TABULAR
        if self.config.scene.spec.dynamic_obstacles:
            return PROMISED_AMONG_PEOPLE
        seeks_goal_without_map = getattr(self.config.task, "guide", "") == "goal"
        return PROMISED_MAPLESS if seeks_goal_without_map else PROMISED

    @property
    def relative_speed(self) -> float:
        """Mean speed, relative to the fastest command."""
        return self.summary["mean_speed"] / self.config.scene.actions.max_speed

    @property
    def promised_speed(self) -> float:
        """Relative speed that the zoo promises; 0 for tasks with a goal, where the path limits the speed."""
        if self.criterion == "success":
            return 0.0
        return PROMISED_SPEED_GENERATED if are_generated(self.config.task.world) else PROMISED_SPEED

    @property
    def metric_rows(self) -> list[tuple[str, str, str]]:
        """Label, value and spread of each metric of the standard evaluation."""
        shown = shown_metrics(self.config.task.goal_task)
        return [metric.row(self.summary) for metric in shown if metric.key in self.summary]  # older files lack some


def _read_json(file: Path) -> dict[str, Any]:
    try:
        return json.loads(read_text(file))
    except ValueError as error:
        raise InputError(one_line(f"{file} is not JSON: {error}")) from None


def zoo_folder() -> Path:
    """Folder of the zoo."""
    return top_folder("zoo")


def suites_folder() -> Path:
    """Folder of the summaries of suites."""
    return zoo_folder() / "suites"


def entries() -> list[Entry]:
    """All entries, built or not."""
    recipes = read_yaml(zoo_folder() / "recipes.yaml")
    return [Entry(name, recipe, zoo_folder() / name) for name, recipe in recipes.items()]


def policies_of_suites_yaml() -> list[SuitePolicy]:
    """The policies of `suites.yaml`, with their arguments of `python -m tb2rl.evaluate`."""
    file = zoo_folder() / "suites.yaml"
    listed = read_yaml(file) if file.is_file() else {}
    return [SuitePolicy(name, arguments, suites_folder()) for name, arguments in listed.items()]


def navigating_policies(trained_entries: Iterable[Entry]) -> list[SuitePolicy]:
    """The policies of the entries for task `navigate`, for suites."""
    return [entry.suite_policy for entry in trained_entries if entry.navigates]


def select(names: Sequence[str]) -> tuple[list[Entry], list[SuitePolicy]]:
    """Find entries and policies of suites.yaml by name; without names return all.

    Raises:
        InputError: If a name is unknown.
    """
    all_entries, policies = entries(), policies_of_suites_yaml()
    known_names = [item.name for item in (*all_entries, *policies)]
    for name in names:
        if name not in known_names:
            raise unknown("zoo policy", name, known_names)
    selected = names or known_names
    return [item for item in all_entries if item.name in selected], [item for item in policies if item.name in selected]
