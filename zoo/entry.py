"""Entries of the zoo: trained policies with their recipes, files and evaluations."""

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tb2rl.commands.train import requested_config
from tb2rl.core import InputError, one_line, read_text, read_yaml, top_folder, unknown, write_json, write_text
from tb2rl.envs.worlds import are_generated
from tb2rl.evaluation.metrics import criterion, shown_metrics
from tb2rl.evaluation.sim_to_sim import BY_SIMULATION, SimToSim, load_sim_to_sim, physics_simulators
from tb2rl.runs import EVALUATION, TRAINING_EVALUATIONS, Config, Run, read_lines
from tb2rl.simulation.variation import describe_variation
from tb2rl.tasks.navigate import Navigate
from tb2rl.train import main as train_command
from tb2rl.worlds.dynamic_obstacles import describe_groups
from tb2rl.zoo.suite_policy import SuitePolicy

# Worlds for evaluations; without world `wall`, whose open sides let a robot drive away without collisions.
WORLDS = ("loop", "circuit", "round", "maze", "mixed")
UNSEEN_SUITE = "unseen"  # the suite of worlds that no training uses
UNKNOWN_SUITE = "unknown"  # that of floors, for robots that map online
# File in the folder of an entry: evaluations in those `WORLDS` in which its policy was not trained (no suites).
UNSEEN_WORLDS_FILE = "unseen_worlds.json"
# Promised rates of good episodes (see `Entry.criterion`).
PROMISED, PROMISED_TABULAR, PROMISED_MAPLESS, PROMISED_AMONG_PEOPLE = 0.99, 0.95, 0.96, 0.9
# Promised mean speeds relative to the fastest command; lower in generated worlds, where round posts require more turns.
PROMISED_SPEED, PROMISED_SPEED_GENERATED = 0.75, 0.6


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

    @property
    def sim_to_sim(self) -> SimToSim | None:
        """Records of longer evaluations in the physics simulators; None: there are none."""
        return load_sim_to_sim(Run.open(self.folder))

    @property
    def standard_record(self) -> dict[str, Any]:
        """The standard evaluation as a record of `sim_to_sim`."""
        others = ("policy", "config", "each", BY_SIMULATION)
        figures = {key: figure for key, figure in self.summary.items() if key not in others}
        bad_episodes = [i for i, episode in enumerate(self.summary["each"]) if not self.is_good(episode)]
        return {**figures, "bad_episodes": bad_episodes}

    def is_good(self, episode: Mapping[str, Any]) -> bool:
        """Whether an episode of the standard evaluation, which is under the key "each", is good by the `criterion`."""
        return bool(episode["success"] if self.criterion == "success" else not episode["failed"])

    def has_record(self, simulation: str, episodes: int = 1) -> bool:
        """Whether `sim_to_sim` has a record of at least this number of episodes in a simulator."""
        records = self.sim_to_sim.records if self.sim_to_sim else {}
        return simulation in records and records[simulation]["episodes"] >= episodes

    def add_record(self, simulation: str, record: dict[str, Any]) -> None:
        """Add a record to `sim_to_sim`, also to the file; the records are in the order of the registry."""
        records = {**(self.sim_to_sim.records if self.sim_to_sim else {}), simulation: record}
        in_order = {each.name: records[each.name] for each in physics_simulators() if each.name in records}
        self.summary[BY_SIMULATION] = SimToSim(in_order, self.config.task.goal_task).to_json()
        write_json(self.folder / EVALUATION, self.summary)

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
        return not self.navigates or bool(self.suite_policy.summaries_of(UNSEEN_SUITE))

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
        return criterion(self.config.task.goal_task).name

    @property
    def good_rate(self) -> float:
        """Rate of good episodes in the standard evaluation."""
        return self.summary[f"{self.criterion}_rate"]

    @property
    def worst_summary(self) -> Mapping[str, Any]:
        """The worst record of `sim_to_sim`, or the standard evaluation without records."""
        return self.sim_to_sim.worst() if self.sim_to_sim else self.summary

    @property
    def promised_rate(self) -> float:
        """Rate of good episodes that the zoo promises."""
        if self.config.observation == "discrete":
            return PROMISED_TABULAR
        if self.config.scene.spec.dynamic_obstacles:
            return PROMISED_AMONG_PEOPLE
        task = self.config.task
        return PROMISED_MAPLESS if task.maps_online or getattr(task, "guide", "") == "goal" else PROMISED

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
