"""The result of a suite, as its file keeps it: the figures, the conditions, and what a policy did in each world."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from annotated_types import Ge, Len

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import read_text
from tb2rl.core.values import Count, CountOrZero, Fraction, NonNegative, build
from tb2rl.evaluation.episodes import Episode
from tb2rl.simulation import find_simulator
from tb2rl.simulation.variation import varied
from tb2rl.worlds.dynamic_obstacles import among, find_dynamic_obstacles

T = TypeVar("T", bound="SuiteSummary")

ALL = "all"  # what the figures of all families are called
_MOTION = 0.1  # [m] from the start: here the clock of BARN begins


@dataclass(frozen=True)
class Drive:
    """What a policy did in one world of a suite; times are whole control steps."""

    world: Annotated[int, Ge(0)]  # its index in the suite
    ended: str  # "goal", "time limit", ...
    success: bool
    failed: bool
    time: NonNegative  # [s]
    moving_time: NonNegative  # [s] from where it was 0.1 m from its start on; 0: it never was
    distance: NonNegative  # [m]
    closest: NonNegative | None  # [m] from the hull to the nearest obstacle, at worst; None: there is no obstacle

    @classmethod
    def of(cls, episode: Episode, control_period: float) -> Drive:
        """What an episode was, with control steps of `control_period` [s]."""
        gone = np.hypot(*(episode.path - episode.path[0]).T) >= _MOTION
        moving = episode.length - int(gone.argmax()) if gone.any() else 0
        return cls(
            world=episode.world,
            ended=episode.ended,
            success=episode.success,
            failed=episode.failed,
            time=episode.length * control_period,
            moving_time=moving * control_period,
            distance=episode.distance,
            closest=episode.closest,
        )


@dataclass(frozen=True)
class NamedDrive(Drive):
    """The same, with what its world is called."""

    name: str
    family: str


@dataclass(frozen=True)
class Figures:
    """How good a policy is in some worlds; a mean of successes is None where there is none."""

    worlds: Count
    success_rate: Fraction
    success_interval: tuple[Fraction, Fraction]  # of 95 %
    failed_rate: Fraction  # crashes
    time_limit_rate: Fraction  # out of time
    # Success weighted by path length (Anderson et al. 2018, "On evaluation of embodied navigation agents"). The
    # shortest way ends where the goal is reached: at its radius, which is a tenth of the way in BARN.
    spl: Fraction
    time_ratio: NonNegative | None  # time to the goal, over what this way takes at top speed; mean of the successes
    mean_speed: NonNegative  # [m/s] all metres through all seconds
    mean_closest: NonNegative | None  # [m] how near the hull came to an obstacle at worst; mean of the successes
    # In the worst tenth of the worlds: those with the longest shortest ways, for the longer the way, the more there is
    # to fail at. Which they are does not depend on the policy, so that policies can be compared.
    longest_tenth_success_rate: Fraction
    endings: dict[str, CountOrZero]
    barn_score: NonNegative | None = None  # where there are reference paths
    barn_formula: str | None = None


@dataclass(frozen=True)
class SuiteSummary:
    """What a policy did in a suite, without each of its worlds, as plain values; nothing of it names a place on a disk.

    Attributes:
        suite: Name of the suite.
        suite_digest: Of its worlds, see `Suite`.
        simulation: Where it drove.
        policy: Its name, or that of its file.
        policy_digest: Of its file; None: of an agent that does not learn.
        figures: Those of `ALL` worlds, and of each family.
        config: What it was to do.
        versions: Of what this depends on.
    """

    suite: str
    suite_digest: str
    simulation: str
    policy: str
    policy_digest: str | None
    figures: dict[str, Figures]
    config: dict[str, dict[str, Any]]
    versions: dict[str, str]

    @property
    def guide(self) -> str:
        """What guides it: "goal", "plan (map known)"; "": its task knows no guide."""
        task = self.config.get("task", {})
        guide, planner = task.get("guide"), task.get("map")
        planned = f" (map {planner})" if guide == "plan" and planner else ""
        return f"{guide}{planned}" if guide else ""

    @property
    def conditions(self) -> tuple[str, ...]:
        """What makes it harder: "among 8 people", "strong variation"."""
        task = self.config.get("task", {})
        moves = among(find_dynamic_obstacles(task.get("dynamic_obstacles"), "task.dynamic_obstacles"))
        return tuple(filter(None, (moves, varied(task.get("variation", "none")))))

    @property
    def title(self) -> str:
        """What drove where: policy, guide, conditions, robot, simulation."""
        guided, robot = [f"guide {self.guide}"] if self.guide else [], str(self.config.get("task", {}).get("robot"))
        driven = [self.policy, *guided, *self.conditions, robot, find_simulator(self.simulation).title]
        return f"{', '.join(driven)}: suite {self.suite}"

    @property
    def rows(self) -> dict[str, Figures]:
        """The figures as a table has them: those of each family, if there are several, and then those of `ALL`."""
        return {**(self.families if len(self.families) > 1 else {}), ALL: self.figures[ALL]}

    @property
    def families(self) -> dict[str, Figures]:
        """The figures of each family."""
        return {name: figures for name, figures in self.figures.items() if name != ALL}


@dataclass(frozen=True)
class SuiteResult(SuiteSummary):
    """What a policy did in a suite: the summary, and each world.

    Attributes:
        suite_path: Where its worlds were read from; None: they are made.
        each: What it did in each world, in their order.
    """

    suite_path: str | None
    each: Annotated[tuple[NamedDrive, ...], Len(1)]

    @property
    def summary(self) -> SuiteSummary:
        """The result without its worlds."""
        return SuiteSummary(**{field.name: getattr(self, field.name) for field in fields(SuiteSummary)})

    @property
    def missed(self) -> list[NamedDrive]:
        """The drives that did not reach the goal."""
        return [drive for drive in self.each if not drive.success]


def kept_result(file: Path) -> SuiteResult:
    """The result that a file holds.

    Raises:
        InputError: If it does not hold one, or cannot be read.
    """
    return _kept(SuiteResult, file, "the result")


def kept_summary(file: Path) -> SuiteSummary:
    """The summary that a file holds.

    Raises:
        InputError: If it does not hold one, or cannot be read.
    """
    return _kept(SuiteSummary, file, "the summary")


def _kept(kind: type[T], file: Path, what: str) -> T:
    try:
        kept = build(kind, json.loads(read_text(file)), "result")
        if ALL not in kept.figures:
            raise ValueError("it does not have the figures of all worlds")
        find_simulator(kept.simulation)
        if isinstance(kept, SuiteResult) and [drive.world for drive in kept.each] != list(range(len(kept.each))):
            raise ValueError("it does not have one world after the other")
    except (ValueError, RecursionError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{file} is not {what} of a suite: {error}")) from None
    return kept
