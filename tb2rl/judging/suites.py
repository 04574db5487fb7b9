"""How good a policy is in a suite: what it did in each world, and the figures, of all worlds and by family."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from tb2rl.envs.scene import Scene
from tb2rl.errors import InputError
from tb2rl.judging.evaluation import Episode
from tb2rl.judging.evaluator import SEED, Evaluator
from tb2rl.judging.statistics import wilson_interval
from tb2rl.runs.config import Config
from tb2rl.runs.folder import versions
from tb2rl.tasks import TIME_LIMIT
from tb2rl.values import NonNegative
from tb2rl.worlds.suites import Suite

BARN_SCORE = "BARN 2024: 2 OT to 8 OT"  # the version of the formula; before February 2024 it was 4 OT to 8 OT
_OPTIMAL_SPEED = 2.0  # [m/s] of OT
_LEAST, _MOST = 2.0, 8.0  # times OT: what is faster or slower counts as if it took so long
_SHORTEST = 1e-3  # [m] of a way, if a start is at its goal already
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
class SuiteEvaluation:
    """What a policy did in a suite.

    Attributes:
        suite: Its worlds.
        scene: The task in these worlds, see `suite_scene`.
        drives: One for each world, in their order.
        simulation: "bullet" or "kinematic".
    """

    suite: Suite
    scene: Scene
    drives: Sequence[Drive]
    simulation: str

    @property
    def families(self) -> list[str]:
        """What kinds of worlds there are, in the order in which they come first."""
        return list(dict.fromkeys(self.suite.families))

    def figures(self, family: str | None = None) -> dict[str, Any]:
        """The figures of one family, or of all worlds.

        - `success_rate`, with its 95 % interval; `failed_rate`: crashes; `time_limit_rate`: out of time.
        - `spl`: success weighted by path length (Anderson et al. 2018, "On evaluation of embodied navigation agents").
          The shortest way ends where the goal is reached: at its radius, which is a tenth of the way in BARN.
        - `time_ratio`: the time to the goal, times what this way takes at the robot's top speed; mean of the successes.
        - `mean_speed`: all metres through all seconds [m/s].
        - `mean_closest`: how near the hull came to an obstacle at worst [m]; mean of the successes.
        - `longest_tenth_success_rate`: in the worst tenth of the worlds: those with the longest shortest ways, for the
          longer the way, the more there is to fail at. Which they are does not depend on the policy, so that policies
          can be compared.
        - `barn_score`, by the formula `BARN_SCORE`, where there are reference paths.

        A mean of successes is None where there is none.
        """
        worlds = [i for i, each in enumerate(self.suite.families) if family in (None, each)]
        drives, ways = [self.drives[i] for i in worlds], np.array(self.suite.ways)[worlds]
        reached = [drive.success for drive in drives]
        distances, times = ([getattr(drive, name) for drive in drives] for name in ("distance", "time"))
        longest = np.argsort(-ways, kind="stable")[: math.ceil(len(worlds) / 10)]
        needed = np.maximum(ways - getattr(self.scene.task, "goal_radius", 0.0), _SHORTEST)
        ratios = np.array(times) * self.scene.robot.max_speed / needed
        figures = {
            "worlds": len(worlds),
            "success_rate": float(np.mean(reached)),
            "success_interval": wilson_interval(sum(reached), len(worlds)),
            "failed_rate": float(np.mean([drive.failed for drive in drives])),
            "time_limit_rate": float(np.mean([drive.ended == TIME_LIMIT for drive in drives])),
            "spl": float(np.mean(reached * needed / np.maximum(distances, needed))),
            "time_ratio": _mean(ratios[reached].tolist()),
            "mean_speed": sum(distances) / sum(times),
            "mean_closest": _mean([d.closest for d in drives if d.success and d.closest is not None]),
            "longest_tenth_success_rate": float(np.mean([reached[i] for i in longest])),
            "endings": dict(sorted(Counter(drive.ended for drive in drives).items())),
        }
        if self.suite.references is not None:
            scored = [barn_score(self.drives[i], self.suite.references[i]) for i in worlds]
            figures |= {"barn_score": float(np.mean(scored)), "barn_formula": BARN_SCORE}
        return figures

    def tree(self, config: Config, about: dict[str, Any]) -> dict[str, Any]:
        """All of it as plain values, for a JSON file.

        Args:
            config: What the policy was trained to do.
            about: What else the file is to say.
        """
        names = [world.name for world in self.suite.worlds]
        each = [{**asdict(drive), "name": name} for drive, name in zip(self.drives, names, strict=True)]
        figures = {"all": self.figures(), **{family: self.figures(family) for family in self.families}}
        said = {"suite": self.suite.name, "suite_digest": self.suite.digest, "simulation": self.simulation}
        return {**said, **about, "figures": figures, "config": config.to_dict(), "versions": versions(), "each": each}


def barn_score(drive: Drive, reference: float) -> float:
    """The score of BARN in one world, from 0 to 0.5, by the formula `BARN_SCORE`.

    Args:
        drive: What the policy did there.
        reference: Length of the reference path [m].
    """
    optimal = reference / _OPTIMAL_SPEED
    return drive.success * optimal / min(max(drive.moving_time, _LEAST * optimal), _MOST * optimal)


def suite_scene(scene: Scene, suite: Suite) -> Scene:
    """The task of a scene in a suite: each episode from the start of a world to its goal, until the suite's time limit.

    Raises:
        InputError: If the task has no such goals, or does not fit the worlds.
    """
    known = {field.name for field in fields(scene.task)}
    steps = max(1, round(suite.time_limit / scene.task.control_period))
    settings: dict[str, Any] = {"start": "fixed", "episode_steps": steps}
    if "goal" in known:
        settings["goal"] = None  # a task's own goal gives way to those of the worlds
    if suite.goal_radius is not None:
        if "goal_radius" not in known:
            raise InputError(
                f"suite {suite.name} says task.goal_radius, which this task does not have; navigate has it"
            )
        settings["goal_radius"] = suite.goal_radius
    there = scene.in_worlds(suite.worlds, **settings)
    if not there.task.goal_task or any(there.goal_in(i) != world.goal[:2] for i, world in enumerate(suite.worlds)):  # type: ignore[index]
        raise InputError(f"suite {suite.name} needs a task that leads to the goals of its worlds, such as navigate")
    return there


def suite_evaluator(scene: Scene, workers: int | None = None) -> Evaluator:
    """What drives a policy through the worlds of a `suite_scene`, see `drives_of`; `workers` as for `Evaluator`."""
    return Evaluator(scene, steps=scene.task.episode_steps, seed=SEED, workers=workers, each_world=True)


def drives_of(evaluator: Evaluator, policy: Any, first: int = 0) -> Iterator[Drive]:
    """Drive through the worlds from number `first` on, in their order."""
    for episode in evaluator.drive(getattr(policy, "policy", policy), first):
        yield Drive.of(episode, evaluator.scene.task.control_period)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
