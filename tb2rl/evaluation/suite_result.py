"""The result of a suite in a file: figures, conditions, and the drive in each world."""

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

ALL = "all"  # key of the figures of all worlds
_MOTION = 0.1  # [m] from the start, where the clock of BARN starts


@dataclass(frozen=True)
class Drive:
    """One drive in a world of a suite; times are whole control steps."""

    world: Annotated[int, Ge(0)]  # its index in the suite
    ended: str  # "goal", "time limit", ...
    success: bool
    failed: bool
    time: NonNegative  # [s]
    moving_time: NonNegative  # [s] after the first 0.1 m; 0: it did not drive so far
    distance: NonNegative  # [m]
    closest: NonNegative | None  # [m] smallest gap between hull and obstacles; None: there is no obstacle

    @classmethod
    def of(cls, episode: Episode, control_period: float) -> Drive:
        """The drive of an episode; `control_period` in [s]."""
        departed = np.hypot(*(episode.path - episode.path[0]).T) >= _MOTION
        moving = episode.length - int(departed.argmax()) if departed.any() else 0
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
    """A drive with the name and the family of its world."""

    name: str
    family: str


@dataclass(frozen=True)
class Figures:
    """Figures of a policy in some worlds; a mean over successes is None if there is none."""

    worlds: Count
    success_rate: Fraction
    success_interval: tuple[Fraction, Fraction]  # 95 %
    failed_rate: Fraction
    time_limit_rate: Fraction
    # Success weighted by path length (Anderson et al. 2018, "On evaluation of embodied navigation agents"). The
    # shortest path ends at the goal's radius, which is a tenth of the path in BARN.
    spl: Fraction
    time_ratio: NonNegative | None  # time to the goal / that of this path at top speed; mean over successes
    mean_speed: NonNegative  # [m/s] total distance / total time
    mean_closest: NonNegative | None  # [m] mean of `Drive.closest` over successes
    # In the tenth of the worlds with the longest shortest paths, where most can fail. The selection does not depend on
    # the policy, so that policies can be compared.
    longest_tenth_success_rate: Fraction
    endings: dict[str, CountOrZero]
    barn_score: NonNegative | None = None  # if the suite has reference paths
    barn_formula: str | None = None


@dataclass(frozen=True)
class SuiteSummary:
    """The result of a policy in a suite, without single worlds and without paths of this machine.

    Attributes:
        suite: Name of the suite.
        suite_digest: Of its worlds, see `Suite`.
        simulation: Name of the simulator.
        policy: Its name, or that of its file.
        policy_digest: Of its file; None for an agent that does not learn.
        figures: Of `ALL` worlds, and of each family.
        config: Of the policy's task.
        versions: Of the packages that the result depends on.
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
        """The guide of the task: "goal", "plan (map known)"; "": none."""
        task = self.config.get("task", {})
        guide, planner = task.get("guide"), task.get("map")
        planned = f" (map {planner})" if guide == "plan" and planner else ""
        return f"{guide}{planned}" if guide else ""

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions: "among 8 people", "strong variation"."""
        task = self.config.get("task", {})
        obstacles = among(find_dynamic_obstacles(task.get("dynamic_obstacles"), "task.dynamic_obstacles"))
        return tuple(filter(None, (obstacles, varied(task.get("variation", "none")))))

    @property
    def title(self) -> str:
        """Policy, guide, conditions, robot, simulator and suite."""
        guide, robot = [f"guide {self.guide}"] if self.guide else [], str(self.config.get("task", {}).get("robot"))
        driven = [self.policy, *guide, *self.conditions, robot, find_simulator(self.simulation).title]
        return f"{', '.join(driven)}: suite {self.suite}"

    @property
    def rows(self) -> dict[str, Figures]:
        """The rows of a table: figures of each family, if there are several, then of `ALL`."""
        return {**(self.families if len(self.families) > 1 else {}), ALL: self.figures[ALL]}

    @property
    def families(self) -> dict[str, Figures]:
        """The figures of each family."""
        return {name: figures for name, figures in self.figures.items() if name != ALL}


@dataclass(frozen=True)
class SuiteResult(SuiteSummary):
    """The result of a policy in a suite, with each world.

    Attributes:
        suite_path: Folder of its worlds; None: they are generated.
        each: The drives in all worlds, in their order.
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
    """Read a result from a file.

    Raises:
        InputError: If it cannot be read, or is not one.
    """
    return _kept(SuiteResult, file, "the result")


def kept_summary(file: Path) -> SuiteSummary:
    """Read a summary from a file.

    Raises:
        InputError: If it cannot be read, or is not one.
    """
    return _kept(SuiteSummary, file, "the summary")


def _kept(kind: type[T], file: Path, what: str) -> T:
    try:
        kept = build(kind, json.loads(read_text(file)), "result")
        if ALL not in kept.figures:
            raise ValueError("the figures of all worlds are missing")
        find_simulator(kept.simulation)
        if isinstance(kept, SuiteResult) and [drive.world for drive in kept.each] != list(range(len(kept.each))):
            raise ValueError("its worlds are not in order")
    except (ValueError, RecursionError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{file} is not {what} of a suite: {error}")) from None
    return kept
