"""The results of suites that a report shows: found by what the user names, and films of some of their drives."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluator import Evaluator
from tb2rl.evaluation.moments import Policy
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.suite_result import JUDGES, NamedDrive, SuiteResult
from tb2rl.evaluation.suites import evaluator_of
from tb2rl.runs.folder import suite_files
from tb2rl.viz.film import write_film

FILMS = 6  # of a result, at most
_SPEED = 4.0  # times as fast as it happened, at least
_LONGEST = 6.0  # [s] of a film, but for its end that stays to be seen: that is a megabyte at most


@dataclass(frozen=True)
class Film:
    """A drive that was driven again.

    Attributes:
        ended: How it ended this time.
        speed: How many times as fast as it happened the film is.
        address: Where a page finds the film: in these characters themselves.
    """

    ended: str
    speed: float
    address: str


@dataclass(frozen=True)
class SuiteSection:
    """What a page says of a result.

    Attributes:
        result: It.
        shown: Some of its drives, see `shown_drives`, each with its film, if there is one.
        judge: Where they were driven again.
        trouble: Why they could not be; "": they were.
    """

    result: SuiteResult
    shown: Sequence[tuple[NamedDrive, Film | None]]
    judge: str = ""
    trouble: str = ""


def result_files(named: Iterable[Path], folders: Iterable[Path]) -> list[Path]:
    """The results of suites that a user names, and those that run folders keep, each once."""
    inside = [file for folder in folders for file in suite_files(folder)]
    return list(dict.fromkeys(file.resolve() for file in [*named, *inside]))


def suite_section(file: Path, result: SuiteResult, progress: bool = False) -> SuiteSection:
    """Drive again what the page shows of a result, if that can be done here.

    Args:
        file: That the result was read from.
        result: It.
        progress: Whether to draw a bar, where there is a terminal.
    """
    shown = shown_drives(result)
    try:
        evaluator, policy = evaluator_of(result, file.parent)
        with evaluator:
            films = [
                _film(evaluator, policy, drive) for drive in progress_bar(shown, "filming", "world", shown=progress)
            ]
    except InputError as error:
        return SuiteSection(result, [(drive, None) for drive in shown], trouble=str(error))
    return SuiteSection(result, list(zip(shown, films, strict=True)), JUDGES[evaluator.simulation])


def shown_drives(result: SuiteResult) -> Sequence[NamedDrive]:
    """The first drives that did not reach their goal; if all did, the one that came nearest to an obstacle.

    Where there are no obstacles, it is the longest one.
    """
    return result.missed[:FILMS] or [min(result.each, key=_room)]


def _room(drive: NamedDrive) -> tuple[float, float]:
    return math.inf if drive.closest is None else drive.closest, -drive.distance


def _film(evaluator: Evaluator, policy: Policy, drive: NamedDrive) -> Film:
    moments = evaluator.moments(policy, drive.world)
    speed = max(_SPEED, len(moments) * evaluator.scene.task.control_period / _LONGEST)
    with TemporaryDirectory() as folder:
        file = Path(folder, "drive.gif")
        write_film(file, [moments], evaluator.scene, speed=speed)
        content = b64encode(file.read_bytes()).decode()
    return Film(moments[-1].info["ended"], speed, f"data:image/gif;base64,{content}")
