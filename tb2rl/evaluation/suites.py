"""The evaluation of a policy in a suite: one drive in each world, and figures of all worlds and by family."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.evaluator import SEED, Evaluator
from tb2rl.evaluation.spaces import check_observes
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.evaluation.suite_result import ALL, Drive, Figures, NamedDrive, SuiteResult
from tb2rl.execution.executor import Executor
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.hub import HUB
from tb2rl.runs.loading import load, policy_digest
from tb2rl.runs.versions import versions
from tb2rl.simulation import InitialState
from tb2rl.tasks import TIME_LIMIT
from tb2rl.worlds.suites import Suite, find_suite

BARN_SCORE = "BARN 2024: 2 OT to 8 OT"  # the version of the formula; before February 2024 it was 4 OT to 8 OT
_OPTIMAL_SPEED = 2.0  # [m/s] of OT
_LEAST, _MOST = 2.0, 8.0  # limits of the counted time, in OT
_SHORTEST = 1e-3  # [m] path, for a start at its goal


@dataclass(frozen=True)
class SuiteEvaluation:
    """The drives of a policy in a suite.

    Attributes:
        suite: The suite.
        scene: The task in its worlds, see `suite_scene`.
        drives: One for each world, in their order.
        simulation: Name of the simulator.
    """

    suite: Suite
    scene: Scene
    drives: Sequence[Drive]
    simulation: str

    @property
    def families(self) -> list[str]:
        """The families of worlds, in order of appearance."""
        return list(dict.fromkeys(self.suite.families))

    def figures(self, family: str | None = None) -> Figures:
        """The figures of one family; None: of all worlds."""
        worlds = [i for i, each in enumerate(self.suite.families) if family in (None, each)]
        drives, lengths = [self.drives[i] for i in worlds], np.array(self.suite.path_lengths)[worlds]
        reached = [drive.success for drive in drives]
        distances, times = ([getattr(drive, name) for drive in drives] for name in ("distance", "time"))
        longest = np.argsort(-lengths, kind="stable")[: math.ceil(len(worlds) / 10)]
        needed = np.maximum(lengths - getattr(self.scene.task, "goal_radius", 0.0), _SHORTEST)
        ratios = np.array(times) * self.scene.robot.max_speed / needed
        figures = Figures(
            worlds=len(worlds),
            success_rate=float(np.mean(reached)),
            success_interval=wilson_interval(sum(reached), len(worlds)),
            failed_rate=float(np.mean([drive.failed for drive in drives])),
            time_limit_rate=float(np.mean([drive.ended == TIME_LIMIT for drive in drives])),
            spl=float(np.mean(reached * needed / np.maximum(distances, needed))),
            time_ratio=_mean(ratios[reached].tolist()),
            mean_speed=sum(distances) / sum(times),
            mean_closest=_mean([d.closest for d in drives if d.success and d.closest is not None]),
            longest_tenth_success_rate=float(np.mean([reached[i] for i in longest])),
            endings=dict(sorted(Counter(drive.ended for drive in drives).items())),
        )
        if self.suite.references is None:
            return figures
        scored = [barn_score(self.drives[i], self.suite.references[i]) for i in worlds]
        return replace(figures, barn_score=float(np.mean(scored)), barn_formula=BARN_SCORE)

    def result(self, config: Config, policy: str, policy_digest: str | None) -> SuiteResult:
        """The result as plain values for a file.

        Args:
            config: Of the policy's task.
            policy: Its name, or that of its file.
            policy_digest: Of its file; None for an agent that does not learn.
        """
        suite = self.suite
        named = zip(self.drives, suite.worlds, suite.families, strict=True)
        return SuiteResult(
            suite=suite.name,
            suite_digest=suite.digest,
            suite_path=None if suite.path is None else str(suite.path.absolute()),
            simulation=self.simulation,
            policy=policy,
            policy_digest=policy_digest,
            figures={ALL: self.figures(), **{family: self.figures(family) for family in self.families}},
            config=config.to_dict(),
            versions=versions(),
            each=tuple(NamedDrive(**asdict(drive), name=world.name, family=family) for drive, world, family in named),
        )


def barn_score(drive: Drive, reference: float) -> float:
    """The score of BARN in one world, from 0 to 0.5, by the formula `BARN_SCORE`.

    Args:
        drive: In that world.
        reference: Length of the reference path [m].
    """
    optimal = reference / _OPTIMAL_SPEED
    return drive.success * optimal / min(max(drive.moving_time, _LEAST * optimal), _MOST * optimal)


def suite_scene(scene: Scene, suite: Suite) -> Scene:
    """The task of a scene in a suite: from the start of each world to its goal, with the suite's time limit.

    Raises:
        InputError: If the task does not lead to goals of worlds, or does not fit the worlds.
    """
    known = {field.name for field in fields(scene.task)}
    steps = max(1, round(suite.time_limit / scene.task.control_period))
    settings: dict[str, Any] = {"start": "fixed", "episode_steps": steps}
    if "goal" in known:
        settings["goal"] = None  # the goals of the worlds have precedence
    if suite.goal_radius is not None:
        if "goal_radius" not in known:
            raise InputError(
                f"suite {suite.name} sets task.goal_radius, which this task does not have; navigate has it"
            )
        settings["goal_radius"] = suite.goal_radius
    scene = scene.in_worlds(suite.worlds, **settings)
    if not scene.task.goal_task or any(scene.goal_in(i) != world.goal[:2] for i, world in enumerate(suite.worlds)):  # type: ignore[index]
        raise InputError(f"suite {suite.name} needs a task that leads to the goals of its worlds, such as navigate")
    return scene


def suite_evaluator(scene: Scene, workers: int | None = None, simulation: Any = None) -> Evaluator:
    """One episode in each world of a `suite_scene`, from the world's start; arguments as for `Evaluator`."""
    states = InitialState(scene.spec.table)
    return Evaluator(scene, states, scene.task.episode_steps, SEED, workers, simulation)


def drives_of(evaluator: Evaluator, policy: Any, first: int = 0, executor: Executor | None = None) -> Iterator[Drive]:
    """Drive in the worlds from number `first` on, in their order; for `executor` see `Evaluator.drive`."""
    for episode in evaluator.drive(getattr(policy, "policy", policy), first, executor):
        yield Drive.of(episode, evaluator.scene.task.control_period)


def evaluator_of(result: SuiteResult, folder: Path) -> tuple[Evaluator, Policy]:
    """The evaluator and the policy that repeat a result in this process, see `Evaluator.moments`.

    Args:
        result: The result.
        folder: Of its file, which may be the run folder of the policy.

    Raises:
        InputError: If the policy or the worlds are missing or have changed.
    """
    policy, config = _policy_of(result, folder)
    suite = find_suite(result.suite, None if result.suite_path is None else Path(result.suite_path))
    if (suite.digest, len(suite.worlds)) != (result.suite_digest, len(result.each)):
        raise InputError(f"the worlds of suite {suite.name} have changed since")
    scene = suite_scene(config.scene, suite)
    check_observes(policy, scene)
    return suite_evaluator(scene, 1, result.simulation), getattr(policy, "policy", policy)


def _policy_of(result: SuiteResult, folder: Path) -> tuple[Policy, Config]:
    """The policy of a result and its config."""
    try:
        config = config_from(result.config)
    except (*LIBRARY_ERRORS, ImportError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"its config does not fit this installation: {error}")) from None
    if result.policy_digest is None:
        return make_baseline(config), config
    for reference in (result.policy, folder):
        if _is_digest(result.policy_digest, reference):
            return load(reference), config
    raise InputError(f"its policy {result.policy} is missing or has changed since")


def _is_digest(digest: str, reference: str | Path) -> bool:
    if str(reference).startswith(HUB):  # a file must not cause a download
        return False
    try:
        return policy_digest(reference) == digest
    except (InputError, OSError):
        return False


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
