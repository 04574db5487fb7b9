"""Suite results on a report's page, with films of some episodes."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tb2rl.core.errors import InputError
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.evaluator import Evaluator
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.suite_result import NamedDrive, SuiteResult
from tb2rl.evaluation.suites import evaluator_of
from tb2rl.runs.folder import suite_files
from tb2rl.viz.film import write_film

FILMS = 6  # of a result, at most
_MIN_SPEED = 4.0  # playback speed of a film
_MAX_SECONDS = 6.0  # [s] of a film, without its last frame: about a megabyte


@dataclass(frozen=True)
class SuiteFilm:
    """The film of a repeated episode."""

    ended: str
    speed: float  # playback speed
    url: str  # a data URL


@dataclass(frozen=True)
class SuiteSection:
    """A result and films of some of its episodes.

    Attributes:
        result: The result.
        shown: Some of its drives, see `shown_drives`, each with its film if there is one.
        simulator: The simulator of the films.
        trouble: The reason why there are no films; "": there are.
    """

    result: SuiteResult
    shown: Sequence[tuple[NamedDrive, SuiteFilm | None]]
    simulator: str = ""
    trouble: str = ""


def result_files(files: Iterable[Path], folders: Iterable[Path]) -> list[Path]:
    """Suite results: files, and those in run folders, without duplicates."""
    inside = [file for folder in folders for file in suite_files(folder)]
    return list(dict.fromkeys(file.resolve() for file in [*files, *inside]))


def suite_section(file: Path, result: SuiteResult, progress: bool = False) -> SuiteSection:
    """Repeat and film the episodes that the page shows.

    Args:
        file: The file of the result.
        result: Its content.
        progress: Whether to show a progress bar if there is a terminal.
    """
    shown = shown_drives(result)
    try:
        evaluator, policy = evaluator_of(result, file.parent)
        with evaluator:
            bar = progress_bar(shown, "filming", "world", shown=progress)
            films = [(drive, _film(evaluator, policy, drive)) for drive in bar]
    except InputError as error:
        return SuiteSection(result, [(drive, None) for drive in shown], trouble=str(error))
    return SuiteSection(result, films, evaluator.simulator.title)


def shown_drives(result: SuiteResult) -> Sequence[NamedDrive]:
    """The first drives that missed the goal; else the one nearest to an obstacle, or without obstacles the longest."""
    nearest = min(result.each, key=lambda d: (math.inf if d.closest is None else d.closest, -d.distance))
    return result.missed[:FILMS] or [nearest]


def _film(evaluator: Evaluator, policy: Policy, drive: NamedDrive) -> SuiteFilm:
    moments = evaluator.moments(policy, drive.world)
    speed = max(_MIN_SPEED, len(moments) * evaluator.scene.task.control_period / _MAX_SECONDS)
    with TemporaryDirectory() as folder:
        file = Path(folder, "drive.gif")
        write_film(file, [moments], evaluator.scene, speed=speed)
        content = b64encode(file.read_bytes()).decode()
    return SuiteFilm(moments[-1].info["ended"], speed, f"data:image/gif;base64,{content}")
