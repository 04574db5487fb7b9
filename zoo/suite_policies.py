"""Policies that drive through suites: those of the zoo that navigate, and agents that do not learn."""

from __future__ import annotations

import json
import shlex
from argparse import Namespace
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from tb2rl.commands.policy import chosen_policy
from tb2rl.core.errors import InputError
from tb2rl.core.files import write_text
from tb2rl.evaluate import main as evaluate
from tb2rl.evaluate import parse
from tb2rl.evaluation.suite_result import SuiteSummary, kept_result, kept_summary
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.loading import policy_digest
from tb2rl.worlds.suites import SUITES, Suite

_RESULTS = Path("runs", "suites")  # whole results, with every world


@dataclass(frozen=True)
class SuitePolicy:
    """A policy that drives through suites."""

    name: str
    arguments: str  # of `python -m tb2rl.evaluate`, without a suite
    folder: Path  # of the summaries

    @property
    def options(self) -> Namespace:
        """The parsed arguments."""
        return parse(shlex.split(self.arguments))

    @cached_property
    def config(self) -> Config:
        """The config of its evaluation."""
        return chosen_policy(self.options)[1]

    @property
    def is_entry(self) -> bool:
        """Whether it is the entry of the zoo with its name, at the task that it was trained at."""
        return self.arguments == f"zoo:{self.name}"

    @property
    def digest(self) -> str | None:
        """Digest of its checkpoint; None: an agent that does not learn."""
        return policy_digest(self.options.policy) if self.options.policy else None

    def file(self, suite: str) -> Path:
        """The file of its summary in a suite."""
        return self.folder / f"{self.name}-{suite}.json"

    @property
    def files(self) -> list[Path]:
        """The files of its summaries that exist, stale ones included."""
        return [file for suite in SUITES if (file := self.file(suite)).is_file()]

    def summary(self, suite: str) -> SuiteSummary | None:
        """Its summary in a suite; None: there is none, or it is stale, because the policy or the task changed."""
        if not self.file(suite).is_file():
            return None
        summary = kept_summary(self.file(suite))
        try:
            config = config_from(summary.config)  # new settings have their defaults
        except InputError:
            return None
        same_policy = (summary.suite, summary.policy_digest) == (suite, self.digest)
        return summary if same_policy and config.to_dict() == self.config.to_dict() else None

    @property
    def summaries(self) -> list[SuiteSummary]:
        """Its summaries that are not stale."""
        return [summary for suite in SUITES if (summary := self.summary(suite)) is not None]

    def drive(self, suite: Suite, again: bool, arguments: Sequence[str] = ()) -> None:
        """Drive through a suite and write the summary, unless it exists; an interrupted drive continues.

        Args:
            suite: The suite.
            again: Whether to replace an existing summary.
            arguments: Further arguments of `python -m tb2rl.evaluate`.
        """
        summary = self.summary(suite.name)
        if summary is not None and summary.suite_digest == suite.digest and not again:
            return
        print(f"{self.name} in suite {suite.name}", flush=True)
        result = _RESULTS / self.file(suite.name).name
        result.parent.mkdir(parents=True, exist_ok=True)
        names = [suite.name, *([] if suite.path is None else [str(suite.path)])]
        evaluate([*shlex.split(self.arguments), "--suite", *names, "--json", str(result), *arguments])
        self.folder.mkdir(exist_ok=True)
        text = json.dumps(asdict(kept_result(result).summary), indent=1, allow_nan=False)
        write_text(self.file(suite.name), text + "\n")


def stale_results(files: Iterable[Path], policies: Iterable[SuitePolicy]) -> list[str]:
    """A sentence for each file that is not a valid summary of one of these policies."""
    valid = {policy.file(summary.suite) for policy in policies for summary in policy.summaries}
    stale = sorted(file for file in files if file not in valid)
    return [f"suites/{file.name} is stale: its policy or task has changed or is gone" for file in stale]
