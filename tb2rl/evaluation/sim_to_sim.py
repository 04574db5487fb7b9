"""Compares a policy in several physics simulators: the same episodes, side by side, and the sim-to-sim difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.plugins import simulator_names
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.metrics import criterion, shown_metrics
from tb2rl.evaluation.statistics import Estimate, paired_difference
from tb2rl.runs import EVALUATION, Run, versions
from tb2rl.simulation.simulator import SimulatorType, default_physics, default_simulator, find_simulator

ALL = "all"  # value of `--simulation` for all physics simulators that can run here
BY_SIMULATION = "by_simulation"  # key of the results in files, by name of the simulator


def physics_simulators() -> list[SimulatorType]:
    """All registered physics simulators, in the order of the registry."""
    return [simulator for simulator in map(find_simulator, simulator_names()) if simulator.is_physics]


def available_physics(purpose: str) -> list[SimulatorType]:
    """The physics simulators that can run here.

    Raises:
        InputError: If there is none; `purpose` is their use, for the message.
    """
    default_physics().check(purpose)
    return [simulator for simulator in physics_simulators() if simulator.unavailable() is None]


def describe_unavailable_physics() -> str:
    """The physics simulators that cannot run here, with the reasons; "" if there are none."""
    reasons = ((simulator, simulator.unavailable()) for simulator in physics_simulators())
    return ", ".join(f"{simulator.title} {reason}" for simulator, reason in reasons if reason)


def describe_place(simulation: str) -> str:
    """A simulator in a sentence: "in PyBullet", "in the kinematic simulator"."""
    title = find_simulator(simulation).title
    return f"in {title}" if title[0].isupper() or title.startswith("a ") else f"in the {title}"


def explain_place(simulation: str) -> str:
    """The same with the reason why it is not the first physics: "in MuJoCo, because PyBullet is not installed"."""
    reference, place = physics_simulators()[0], describe_place(simulation)
    problem = reference.unavailable() if simulation == default_simulator().name else None
    return f"{place}, because {reference.title} {problem}" if problem else place


def describe_difference(first: str, second: str, difference: Estimate) -> str:
    """The difference of two simulators, given by their names, in percentage points with its 95 % interval."""
    titles = f"{find_simulator(second).title} - {find_simulator(first).title}"
    value, low, high = (f"{100 * number:z.1f}" for number in (difference.value, difference.low, difference.high))
    return f"{titles}: {value} points (95 % interval {low} to {high})"


def difference_in_json(difference: Estimate) -> dict[str, Any]:
    """The keys of a difference in files, as fractions."""
    return {"difference": difference.value, "difference_interval": (difference.low, difference.high)}


@dataclass(frozen=True)
class SimToSim:
    """Records of a policy in several physics simulators.

    Each simulator has episodes with the same seeds and initial states, so that the records are paired by episode.

    Attributes:
        records: The `Evaluation.summary` in each simulator, by name; "bad_episodes" are the numbers of the episodes
            that are not good by the `criterion` of the task, and "versions" are those of the packages. Differences are
            relative to the first record.
        goal_task: Whether the task has a goal.
    """

    records: Mapping[str, Mapping[str, Any]]
    goal_task: bool

    @classmethod
    def of(cls, evaluations: Sequence[Evaluation]) -> SimToSim:
        """Compare evaluations of the same policy in different simulators.

        Raises:
            InputError: If their seeds or time limits differ, so that their episodes are not paired.
        """
        if len({(evaluation.seed, evaluation.steps) for evaluation in evaluations}) > 1:
            raise InputError("evaluations with different seeds or time limits cannot be paired by episode")
        records = {evaluation.simulation: record(evaluation) for evaluation in evaluations}
        return cls(records, evaluations[0].task.goal_task)

    @classmethod
    def read(cls, tree: Any, goal_task: bool, where: str) -> SimToSim:
        """Read the value of `BY_SIMULATION` in the file `where`.

        Raises:
            InputError: If the value is damaged.
        """
        try:
            found = cls({find_simulator(name).name: dict(each) for name, each in tree.items()}, goal_task)
            _ = found.rows, found.differences
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(one_line(f"{where}: {BY_SIMULATION} is damaged: {error!r}")) from None
        return found

    @property
    def titles(self) -> list[str]:
        """Titles of the simulators."""
        return [find_simulator(name).title for name in self.records]

    @property
    def rows(self) -> list[tuple[str, list[tuple[str, str]]]]:
        """Rows of a table: the label of a metric, and in each simulator its value and its spread."""
        records, rows = list(self.records.values()), []
        for metric in shown_metrics(self.goal_task):
            label = f"{metric.label} [{metric.unit}]" if metric.unit else metric.label
            rows.append((label, [(metric.format(each[metric.key]), metric.spread(each)) for each in records]))
        counts = (", ".join(f"{ended} {count}" for ended, count in each["endings"].items()) for each in records)
        return [*rows, ("endings", [(text, "") for text in counts])]

    @property
    def differences(self) -> dict[str, Estimate]:
        """Rate of good episodes of each other simulator minus that of the first, in the episodes that both have."""
        (_, first), *others = self.records.items()
        differences = {}
        for name, other in others:
            total = min(first["episodes"], other["episodes"])
            differences[name] = paired_difference(_good_episodes(first, total), _good_episodes(other, total))
        return differences

    @property
    def sentences(self) -> list[str]:
        """A sentence about each difference."""
        (first, record), *_ = self.records.items()
        label = criterion(self.goal_task).label
        return [
            f"sim-to-sim difference ({label}) {describe_difference(first, name, difference)}, paired over"
            f" {min(record['episodes'], self.records[name]['episodes'])} episodes"
            for name, difference in self.differences.items()
        ]

    def worst(self) -> Mapping[str, Any]:
        """The record with the lowest rate of good episodes, on a tie the one with the lowest speed."""
        key = criterion(self.goal_task).key
        return min(self.records.values(), key=lambda each: (each[key], each["mean_speed"]))

    def to_json(self) -> dict[str, dict[str, Any]]:
        """The records, with the differences."""
        differences = {name: difference_in_json(each) for name, each in self.differences.items()}
        return {name: {**each, **differences.get(name, {})} for name, each in self.records.items()}


def load_sim_to_sim(run: Run) -> SimToSim | None:
    """Load the comparison of simulators in the standard evaluation of a run folder; None if there is none.

    Raises:
        InputError: If the file is damaged.
    """
    tree = run.read_evaluation_tree().get(BY_SIMULATION)
    return SimToSim.read(tree, run.config.task.goal_task, str(run.folder / EVALUATION)) if tree else None


def _good_episodes(record: Mapping[str, Any], total: int) -> np.ndarray:
    """Whether each of the first episodes of a record is good, bool, shape (total,)."""
    return ~np.isin(np.arange(total), np.array(record["bad_episodes"], dtype=int))


def record(evaluation: Evaluation) -> dict[str, Any]:
    """The record of an evaluation for `SimToSim`."""
    bad_episodes = np.flatnonzero(~evaluation.good).tolist()
    return {**evaluation.summary(), "bad_episodes": bad_episodes, "versions": versions()}
