"""Policies that are compared in suites: policies of the zoo for task `navigate`, and agents that do not learn."""

import json
import shlex
from argparse import Namespace
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from tb2rl.commands.evaluate import run as evaluate
from tb2rl.commands.policy import chosen_policy
from tb2rl.core import InputError, write_text
from tb2rl.evaluate import main as evaluate_command
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
    def options(self) -> Namespace:
        """The parsed arguments."""
        return evaluate_command.parse(shlex.split(self.arguments))

    @cached_property
    def config(self) -> Config:
        """Config of the evaluation."""
        return chosen_policy(self.options)[1]

    @property
    def digest(self) -> str | None:
        """Digest of the checkpoint; None for an agent that does not learn."""
        return policy_digest(self.options.policy) if self.options.policy else None

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
        is_same_policy = (summary.suite, summary.policy_digest) == (suite, self.digest)
        return summary if is_same_policy and config.to_dict() == self.config.to_dict() else None

    @property
    def summaries(self) -> list[SuiteResult]:
        """The summaries in all suites, without missing and stale ones."""
        return [summary for suite in SUITES if (summary := self.summary(suite)) is not None]

    def evaluate_in(self, suite: Suite, options: Namespace) -> None:
        """Evaluate the policy in a suite, or continue an interrupted evaluation, and write the summary.

        Args:
            suite: The suite.
            options: Options of the command `zoo build`: `again` replaces a valid summary; `on` and `workers`.
        """
        summary = self.summary(suite.name)
        if summary is not None and summary.suite_digest == suite.digest and not options.again:
            return
        print(f"{self.name} in suite {suite.name}", flush=True)
        result_file = _RESULTS / self.file(suite.name).name
        result_file.parent.mkdir(parents=True, exist_ok=True)
        arguments = self.options
        arguments.suite, arguments.json = [suite.name, *([] if suite.path is None else [str(suite.path)])], result_file
        arguments.on, arguments.workers = options.on, options.workers
        evaluate(arguments)
        self.folder.mkdir(exist_ok=True)
        text = json.dumps(asdict(SuiteResult.read(result_file).summary), indent=1, allow_nan=False)
        write_text(self.file(suite.name), text + "\n")


def stale_results(files: Iterable[Path], policies: Iterable[SuitePolicy]) -> list[str]:
    """Messages for files that are not valid summaries of these policies."""
    valid = {policy.file(summary.suite) for policy in policies for summary in policy.summaries}
    stale = sorted(file for file in files if file not in valid)
    return [f"suites/{file.name} is stale: its policy or task has changed or is gone" for file in stale]
