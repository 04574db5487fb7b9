"""Sections of the report for suite results, with replays of some episodes."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.suite_comparison import suite_sentences
from tb2rl.evaluation.suites import SuiteEpisode, SuiteResult, restore_evaluation
from tb2rl.runs.folder import suite_files
from tb2rl.viz.replay import make_replay

MAX_REPLAYS = 6  # maximum number of replays of a result


@dataclass(frozen=True)
class SuiteSection:
    """A suite result and replays of some of its episodes."""

    result: SuiteResult
    episodes: Sequence[tuple[SuiteEpisode, dict[str, Any] | None]]  # each with its replay
    error: str = ""  # the reason why there are no replays
    comparison: Sequence[str] = ()  # sentences about the differences between simulators


def result_files(files: Iterable[Path], folders: Iterable[Path]) -> list[Path]:
    """The given files of suite results and those in run folders, without duplicates."""
    run_files = [file for folder in folders for file in suite_files(folder)]
    return list(dict.fromkeys(file.resolve() for file in [*files, *run_files]))


def suite_section(file: Path, result: SuiteResult, progress_bar: bool = False) -> SuiteSection:
    """Make the section of a result, which was read from `file`, by repeating some episodes."""
    selected = select_episodes(result)
    if not selected:  # a summary has no episodes
        return SuiteSection(result, [])
    try:
        evaluator, policy = restore_evaluation(result, file.parent)
        with evaluator:
            bar = progress(selected, "replaying", "world", shown=progress_bar)
            # The number of an episode is the index of its world.
            steps = ((episode, evaluator.replay(policy, episode.world)) for episode in bar)
            replays = [(episode, make_replay(each, evaluator.scene)) for episode, each in steps]
    except InputError as error:
        return SuiteSection(result, [(episode, None) for episode in selected], error=str(error))
    return SuiteSection(result, replays)


def suite_sections(file: Path, results: Sequence[SuiteResult], progress_bar: bool = False) -> list[SuiteSection]:
    """Make a section of each result of a file; the last one has the comparison."""
    *others, last = (suite_section(file, result, progress_bar) for result in results)
    return [*others, replace(last, comparison=suite_sentences(results))]


def select_episodes(result: SuiteResult) -> Sequence[SuiteEpisode]:
    """The first episodes that missed the goal; if none, the one with the least clearance, on a tie the longest path."""

    def rank(episode: SuiteEpisode) -> tuple[float, float]:
        return math.inf if episode.min_clearance is None else episode.min_clearance, -episode.distance

    return result.unsuccessful_episodes[:MAX_REPLAYS] or sorted(result.episodes, key=rank)[:1]
