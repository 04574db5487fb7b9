"""Policies that suites compare, and their results."""

import json
import shlex
from argparse import Namespace
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from tb2rl.commands.evaluate import chosen_policy
from tb2rl.commands.evaluate import run as evaluate
from tb2rl.core import InputError, write_text
from tb2rl.evaluate import main as evaluate_command
from tb2rl.evaluation.sim_to_sim import describe_place, physics_simulators
from tb2rl.evaluation.suites import SuiteResult
from tb2rl.runs import Config, config_from, policy_digest
from tb2rl.worlds.suites import SUITES, Suite

_RESULTS = Path("runs", "suites")  # folder of the complete results, with a row for each world


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

    def file(self, suite: str, simulation: str) -> Path:
        """File of the summary in a suite and a simulator."""
        return self.folder / f"{self.name}-{suite}-{simulation}.json"

    def summary(self, suite: str, simulation: str) -> SuiteResult | None:
        """The summary in a suite; None if the file is missing, or stale because policy or task have changed."""
        file = self.file(suite, simulation)
        if not file.is_file():
            return None
        summary = SuiteResult.read(file)
        try:
            config = config_from(summary.config)  # adds defaults of settings that are newer than the file
        except InputError:
            return None
        found = summary.suite, summary.simulation, summary.policy_digest
        # Without `train`, whose defaults depend on the simulators that are installed here.
        settings = [{**each.to_dict(), "train": None} for each in (config, self.config)]
        is_same = found == (suite, simulation, self.digest) and settings[0] == settings[1]
        return summary if is_same else None

    def summaries_of(self, suite: str) -> list[SuiteResult]:
        """The summaries in a suite, one for each physics simulator, without missing and stale ones."""
        summaries = (self.summary(suite, simulator.name) for simulator in physics_simulators())
        return [summary for summary in summaries if summary is not None]

    @property
    def summaries(self) -> list[list[SuiteResult]]:
        """The `summaries_of` all suites that have some."""
        return [summaries for suite in SUITES if (summaries := self.summaries_of(suite))]

    def evaluate_in(self, suite: Suite, simulation: str, options: Namespace) -> None:
        """Evaluate in a suite and write the summary if it is missing or stale; continues an interrupted evaluation.

        Args:
            suite: The suite.
            simulation: Name of the simulator.
            options: Options of `zoo build`: `again` replaces a valid summary, `on` and `workers` select the executor.
        """
        summary, file = self.summary(suite.name, simulation), self.file(suite.name, simulation)
        is_complete = summary is not None and summary.unsuccessful_worlds is not None
        if is_complete and summary.suite_digest == suite.digest and not options.again:
            return
        print(f"{self.name} in suite {suite.name} {describe_place(simulation)}", flush=True)
        result_file = _RESULTS / file.name
        result_file.parent.mkdir(parents=True, exist_ok=True)
        evaluate_options = self.evaluate_options
        evaluate_options.suite = [suite.name, *([] if suite.path is None else [str(suite.path)])]
        evaluate_options.json, evaluate_options.simulation = result_file, simulation
        evaluate_options.on, evaluate_options.workers = options.on, options.workers
        evaluate(evaluate_options)
        self.folder.mkdir(exist_ok=True)
        text = json.dumps(asdict(SuiteResult.read(result_file).summary), indent=1, allow_nan=False)
        write_text(file, text + "\n")
