"""What drives through suites: the zoo's policies that navigate, and agents that do not learn; a summary of each."""

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

_RESULTS = Path("runs", "suites")  # here the results stay with what was done in each world


@dataclass(frozen=True)
class Contestant:
    """What drives through suites."""

    name: str
    arguments: str  # of `python -m tb2rl.evaluate`, without a suite
    folder: Path  # of the summaries

    @property
    def options(self) -> Namespace:
        """The arguments, parsed."""
        return parse(shlex.split(self.arguments))

    @cached_property
    def config(self) -> Config:
        """What it is to do."""
        return chosen_policy(self.options)[1]

    @property
    def is_policy_of_zoo(self) -> bool:
        """Whether it is the entry of its name, at the task that it was trained at."""
        return self.arguments == f"zoo:{self.name}"

    @property
    def digest(self) -> str | None:
        """Of its policy's file; None: it does not learn."""
        return policy_digest(self.options.policy) if self.options.policy else None

    def file(self, suite: str) -> Path:
        """Where the summary of its result in a suite belongs."""
        return self.folder / f"{self.name}-{suite}.json"

    def summary(self, suite: str) -> SuiteSummary | None:
        """That of its result in a suite; None: there is none, or it is of another policy or task by now."""
        if not self.file(suite).is_file():
            return None
        kept = kept_summary(self.file(suite))
        is_its_own = (kept.suite, kept.policy_digest) == (suite, self.digest) and self._is_task_of(kept)
        return kept if is_its_own else None

    @property
    def files(self) -> list[Path]:
        """Those of its summaries that there are, whatever they hold."""
        return [file for suite in SUITES if (file := self.file(suite)).is_file()]

    @property
    def summaries(self) -> list[SuiteSummary]:
        """Those of it as it is now."""
        return [kept for suite in SUITES if (kept := self.summary(suite)) is not None]

    def _is_task_of(self, kept: SuiteSummary) -> bool:
        try:
            before = config_from(kept.config)  # settings that came later have their default
        except InputError:
            return False
        return before.to_dict() == self.config.to_dict()

    def drive(self, suite: Suite, again: bool, where: Sequence[str] = ()) -> None:
        """Drive through a suite and keep the summary, unless it is there already; what was interrupted goes on.

        Args:
            suite: The suite.
            again: Whether to drive anew what is there.
            where: Arguments of the command that say where it is driven, see `executor_arguments`.
        """
        kept = self.summary(suite.name)
        if kept is not None and kept.suite_digest == suite.digest and not again:
            return
        print(f"{self.name} in suite {suite.name}", flush=True)
        whole = _RESULTS / self.file(suite.name).name
        whole.parent.mkdir(parents=True, exist_ok=True)
        named = [suite.name, *([] if suite.path is None else [str(suite.path)])]
        evaluate([*shlex.split(self.arguments), "--suite", *named, "--json", str(whole), *where])
        self.folder.mkdir(exist_ok=True)
        summary = asdict(kept_result(whole).summary)
        write_text(self.file(suite.name), json.dumps(summary, indent=1, allow_nan=False) + "\n")


def astray(files: Iterable[Path], contestants: Iterable[Contestant]) -> list[str]:
    """Which of these files are not summaries of one of these contestants as it is now, in sentences."""
    now = {contestant.file(kept.suite) for contestant in contestants for kept in contestant.summaries}
    found = sorted(file for file in files if file not in now)
    return [f"suites/{file.name} is not of a policy and a task that are there now" for file in found]
