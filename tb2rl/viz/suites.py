"""Sections of the report for suite results, with films of some episodes."""

import math
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import InputError
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.evaluate import Evaluator
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.suite_comparison import suite_sentences
from tb2rl.evaluation.suites import SuiteEpisode, SuiteResult, restore_evaluation
from tb2rl.runs.folder import suite_files
from tb2rl.viz.film import write_film

MAX_FILMS = 6  # maximum number of films of a result
_MIN_SPEED = 4.0  # minimum playback speed of a film; 1 is real time
_MAX_SECONDS = 6.0  # [s] duration of a film without its last frame: about a megabyte


@dataclass(frozen=True)
class SuiteSection:
    """A suite result and films of some of its episodes."""

    result: SuiteResult
    episodes: Sequence[tuple[SuiteEpisode, dict[str, Any] | None]]  # each with its film ("ended", "speed", data "url")
    error: str = ""  # the reason why there are no films
    comparison: Sequence[str] = ()  # sentences about the differences between simulators


def result_files(files: Iterable[Path], folders: Iterable[Path]) -> list[Path]:
    """The given files of suite results and those in run folders, without duplicates."""
    run_files = [file for folder in folders for file in suite_files(folder)]
    return list(dict.fromkeys(file.resolve() for file in [*files, *run_files]))


def suite_section(file: Path, result: SuiteResult, progress: bool = False) -> SuiteSection:
    """Make the section of a result, which was read from `file`, by repeating and filming some episodes."""
    selected = select_episodes(result)
    if not selected:  # a summary has no episodes
        return SuiteSection(result, [])
    try:
        evaluator, policy = restore_evaluation(result, file.parent)
        with evaluator:
            bar = progress_bar(selected, "filming", "world", shown=progress)
            filmed_episodes = [(episode, _film(evaluator, policy, episode.world)) for episode in bar]
    except InputError as error:
        return SuiteSection(result, [(episode, None) for episode in selected], error=str(error))
    return SuiteSection(result, filmed_episodes)


def suite_sections(file: Path, results: Sequence[SuiteResult], progress: bool = False) -> list[SuiteSection]:
    """Make a section of each result of a file; the last one has the comparison."""
    *others, last = (suite_section(file, result, progress) for result in results)
    return [*others, replace(last, comparison=suite_sentences(results))]


def select_episodes(result: SuiteResult) -> Sequence[SuiteEpisode]:
    """The first episodes that missed the goal; if none, the one with the least clearance, on a tie the longest path."""

    def rank(episode: SuiteEpisode) -> tuple[float, float]:
        return math.inf if episode.min_clearance is None else episode.min_clearance, -episode.distance

    return result.unsuccessful_episodes[:MAX_FILMS] or sorted(result.episodes, key=rank)[:1]


def _film(evaluator: Evaluator, policy: Policy, world: int) -> dict[str, Any]:
    steps = evaluator.replay(policy, world)  # the number of an episode is the index of its world
    speed = max(_MIN_SPEED, len(steps) * evaluator.scene.task.control_period / _MAX_SECONDS)
    with TemporaryDirectory() as folder:
        file = Path(folder, "episode.gif")
        write_film(file, [steps], evaluator.scene, speed=speed)
        content = b64encode(file.read_bytes()).decode()
    return {"ended": steps[-1].info["ended"], "speed": speed, "url": f"data:image/gif;base64,{content}"}
