"""The evaluation of a policy in a suite, with one episode in each world, and its result file."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from tb2rl.core import InputError, one_line, read_text
from tb2rl.core.values import Count, CountOrZero, Fraction, NonNegative, build
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Episode, Policy, check_spaces
from tb2rl.evaluation.evaluate import SEED, Evaluator
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.execution.executor import Executor
from tb2rl.runs import HUB, LIBRARY_ERRORS, Config, config_from, load, make_baseline, policy_digest, versions
from tb2rl.simulation import InitialState, find_simulator
from tb2rl.simulation.variation import describe_variation
from tb2rl.tasks import TIME_LIMIT
from tb2rl.worlds.dynamic_obstacles import describe_groups, parse_dynamic_obstacles
from tb2rl.worlds.suites import Suite, find_suite

ALL = "all"  # key of the metrics of all worlds
# BARN scores a traversal time relative to the optimal time (OT): length of the reference path / optimal speed.
BARN_FORMULA = "BARN 2024: 2 OT to 8 OT"  # version of the formula, named by its limits of the traversal time
_MIN_OPTIMAL_TIMES, _MAX_OPTIMAL_TIMES = 2.0, 8.0  # [OT] these limits
_OPTIMAL_SPEED = 2.0  # [m/s] of the optimal time
_DEPARTURE_DISTANCE = 0.1  # [m] distance from the start at which BARN's clock starts
_MIN_PATH_LENGTH = 1e-3  # [m] avoids a division by zero if the start is at the goal
_COPIED_FIELDS = ("world", "ended", "success", "failed", "distance", "min_clearance")  # from `Episode`


@dataclass(frozen=True)
class SuiteEpisode:
    """The episode in one world of a suite."""

    world: Annotated[int, Ge(0)]  # index of the world in the suite
    ended: str  # "goal", "time limit", ...
    success: bool
    failed: bool
    time: NonNegative  # [s]
    moving_time: NonNegative  # [s] time after the first 0.1 m from the start; 0: the robot stayed within 0.1 m
    distance: NonNegative  # [m] length of the driven path
    min_clearance: NonNegative | None  # [m] smallest gap between hull and obstacles; None: no obstacle
    world_name: str
    family: str

    @classmethod
    def of(cls, episode: Episode, suite: Suite, control_period: float) -> SuiteEpisode:
        """The record of an episode with control steps of `control_period` [s]."""
        has_departed = np.hypot(*(episode.path - episode.path[0]).T) >= _DEPARTURE_DISTANCE
        moving_steps = episode.length - int(has_departed.argmax()) if has_departed.any() else 0
        if suite.time_limits and episode.length > round(suite.time_limits[episode.world] / control_period):
            episode = replace(episode, ended=TIME_LIMIT, success=False, failed=False)
        return cls(
            **{name: getattr(episode, name) for name in _COPIED_FIELDS},
            time=episode.length * control_period,
            moving_time=moving_steps * control_period,
            world_name=suite.worlds[episode.world].name,
            family=suite.families[episode.world],
        )


@dataclass(frozen=True)
class SuiteMetrics:
    """Metrics of a policy in some worlds of a suite; means over successes are None without successes."""

    worlds: Count  # number of these worlds
    success_rate: Fraction
    success_interval: tuple[Fraction, Fraction]  # 95 %
    failed_rate: Fraction
    time_limit_rate: Fraction
    # Success weighted by path length (Anderson et al. 2018, "On evaluation of embodied navigation agents"). Shortest
    # paths end a goal radius before the goal; in BARN this radius is 1 m, and the paths have about 10 m.
    spl: Fraction
    time_ratio: NonNegative | None  # time to the goal / time of the shortest path at top speed; mean over successes
    mean_speed: NonNegative  # [m/s] total distance / total time
    mean_min_clearance: NonNegative | None  # [m] mean of `SuiteEpisode.min_clearance` over successes
    # Success rate in the tenth of the worlds with the longest shortest paths, a selection of hard worlds that does not
    # depend on the policy.
    longest_tenth_success_rate: Fraction
    endings: dict[str, CountOrZero]
    barn_score: NonNegative | None = None  # None: the suite has no reference paths
    barn_formula: str | None = None


@dataclass(frozen=True)
class SuiteResult:
    """The result of a policy in a suite."""

    suite: str
    suite_digest: str  # digest of the worlds, see `Suite`
    simulation: str  # name of the simulator
    policy: str  # name or file of the policy
    policy_digest: str | None  # digest of the policy's file; None: an agent that does not learn
    figures: dict[str, SuiteMetrics]  # metrics by family of worlds, and of `ALL` worlds
    config: dict[str, dict[str, Any]]  # config with the policy's task
    versions: dict[str, str]  # versions of the packages on which the result depends
    suite_path: str | None = None  # file or folder of the worlds; None: generated worlds
    episodes: tuple[SuiteEpisode, ...] = ()  # one for each world, in the order of the suite; empty in a summary
    unsuccessful_worlds: tuple[CountOrZero, ...] | None = None  # indices; None: a summary from before this field

    def __post_init__(self) -> None:
        if ALL not in self.figures or [episode.world for episode in self.episodes] != [*range(len(self.episodes))]:
            raise ValueError("it lacks the figures of all worlds, or its worlds are not in order")
        find_simulator(self.simulation)  # raises an InputError for an unknown name

    @classmethod
    def read(cls, file: Path) -> SuiteResult:
        """Read a result from a file.

        Raises:
            InputError: If the file cannot be read, or is not a result.
        """
        try:
            return build(cls, json.loads(read_text(file)), "result")
        except (ValueError, RecursionError) as error:  # an InputError is a ValueError
            raise InputError(one_line(f"{file} is not the result of a suite: {error}")) from None

    @property
    def summary(self) -> SuiteResult:
        """The result without `episodes` and `suite_path`."""
        return replace(self, suite_path=None, episodes=())

    @property
    def unsuccessful_episodes(self) -> list[SuiteEpisode]:
        return [episode for episode in self.episodes if not episode.success]

    @property
    def guide(self) -> str:
        """The setting `task.guide` in words: "goal", "plan (map known)"; "" if the task has no guide."""
        guide, map_kind = (self.config.get("task", {}).get(name) for name in ("guide", "map"))
        return f"{guide} (map {map_kind})" if guide == "plan" and map_kind else guide or ""

    @property
    def disturbances(self) -> tuple[str, ...]:
        """The task's dynamic obstacles and domain randomisation in words: "among 8 people", "strong variation"."""
        task = self.config.get("task", {})
        obstacles = describe_groups(parse_dynamic_obstacles(task.get("dynamic_obstacles"), "task.dynamic_obstacles"))
        return tuple(filter(None, (obstacles, describe_variation(task.get("variation", "none")))))

    @property
    def title(self) -> str:
        """Policy, guide, disturbances, robot, simulator and suite."""
        return self.title_with(find_simulator(self.simulation).title)

    def title_with(self, simulator: str) -> str:
        """The `title` with another name of the simulator."""
        guide, robot = self.guide and f"guide {self.guide}", str(self.config.get("task", {}).get("robot"))
        parts = [self.policy, guide, *self.disturbances, robot, simulator]
        return f"{', '.join(filter(None, parts))}: suite {self.suite}"

    @property
    def rows(self) -> dict[str, SuiteMetrics]:
        """Rows of a table: metrics of each family if there are several families, then of `ALL` worlds."""
        families = {name: metrics for name, metrics in self.figures.items() if name != ALL}
        return {**(families if len(families) > 1 else {}), ALL: self.figures[ALL]}


def suite_result(
    suite: Suite, scene: Scene, episodes: Sequence[SuiteEpisode], config: Config, **origin: Any
) -> SuiteResult:
    """The result of a policy.

    Args:
        suite: The suite.
        scene: A `suite_scene`.
        episodes: One for each world, in the order of the suite.
        config: A config with the policy's task.
        origin: `policy`, `policy_digest` and `simulation` of the `SuiteResult`.
    """
    families = dict.fromkeys(suite.families)
    groups = {family: [episode for episode in episodes if episode.family == family] for family in families}
    return SuiteResult(
        suite=suite.name,
        suite_digest=suite.digest,
        suite_path=None if suite.path is None else str(suite.path.absolute()),
        figures={name: suite_metrics(suite, scene, group) for name, group in {ALL: episodes, **groups}.items()},
        config=config.to_dict(),
        versions=versions(),
        episodes=tuple(episodes),
        unsuccessful_worlds=tuple(episode.world for episode in episodes if not episode.success),
        **origin,
    )


def suite_metrics(suite: Suite, scene: Scene, episodes: Sequence[SuiteEpisode]) -> SuiteMetrics:
    """The metrics of episodes in some worlds of a suite."""
    worlds, success = [e.world for e in episodes], np.array([e.success for e in episodes])
    distances, times = (np.array([getattr(episode, name) for episode in episodes]) for name in ("distance", "time"))
    path_lengths, references_by_world = np.array(suite.path_lengths)[worlds], suite.reference_lengths
    longest_tenth = np.argsort(-path_lengths, kind="stable")[: math.ceil(len(worlds) / 10)]
    shortest_distances = np.maximum(path_lengths - getattr(scene.task, "goal_radius", 0.0), _MIN_PATH_LENGTH)
    clearances = [e.min_clearance for e in episodes if e.success and e.min_clearance is not None]
    scores = [barn_score(e, references_by_world[e.world]) for e in episodes] if references_by_world else []
    return SuiteMetrics(
        worlds=len(worlds),
        success_rate=float(success.mean()),
        success_interval=wilson_interval(int(success.sum()), len(worlds)),
        failed_rate=float(np.mean([episode.failed for episode in episodes])),
        time_limit_rate=float(np.mean([episode.ended == TIME_LIMIT for episode in episodes])),
        spl=float(np.mean(success * shortest_distances / np.maximum(distances, shortest_distances))),
        time_ratio=_mean((times * scene.robot.max_speed / shortest_distances)[success]),
        mean_speed=sum(distances.tolist()) / sum(times.tolist()),
        mean_min_clearance=_mean(clearances),
        longest_tenth_success_rate=float(success[longest_tenth].mean()),
        endings=dict(sorted(Counter(episode.ended for episode in episodes).items())),
        barn_score=_mean(scores),
        barn_formula=BARN_FORMULA if scores else None,
    )


def barn_score(episode: SuiteEpisode, reference_length: float) -> float:
    """BARN's score of an episode, from 0 to 0.5, for the length of the reference path [m]; see `BARN_FORMULA`."""
    optimal_time = reference_length / _OPTIMAL_SPEED
    limits = _MIN_OPTIMAL_TIMES * optimal_time, _MAX_OPTIMAL_TIMES * optimal_time
    return episode.success * optimal_time / min(max(episode.moving_time, limits[0]), limits[1])


def suite_scene(scene: Scene, suite: Suite) -> Scene:
    """The scene of a task in a suite: from the start of each world to its goal, with the suite's time limit.

    Args:
        scene: A scene of the task, whose worlds are replaced.
        suite: The suite.

    Raises:
        InputError: If the task lacks goals or the suite's goal radius, has other goals, or is invalid in the worlds.
    """
    setting_names = {field.name for field in fields(scene.task)}
    settings: dict[str, Any] = {"goal": None} if "goal" in setting_names else {}  # None selects the goals of the worlds
    if suite.goal_radius is not None:
        settings["goal_radius"] = suite.goal_radius
    if settings.keys() <= setting_names:
        steps = max(1, round(suite.time_limit / scene.task.control_period))
        scene = scene.in_worlds(suite.worlds, start="fixed", episode_steps=steps, **settings)
        goals = [world.goal[:2] if world.goal else None for world in suite.worlds]
        if scene.task.goal_task and [scene.goal_in(i) for i in range(len(goals))] == goals:
            return scene
    hint = "" if suite.goal_radius is None else ", with a task.goal_radius"
    raise InputError(f"suite {suite.name} needs a task that leads to the goals of its worlds{hint}, such as navigate")


def suite_evaluator(scene: Scene, workers: int | None = None, simulation: Any = None) -> Evaluator:
    """An evaluator with one episode in each world of a `suite_scene`; other arguments as for `Evaluator`."""
    states = InitialState(scene.spec.table)
    return Evaluator(scene, states, scene.task.episode_steps, SEED, workers, simulation)


def run_suite(
    evaluator: Evaluator, policy: Any, suite: Suite, first: int = 0, executor: Executor | None = None
) -> Iterator[SuiteEpisode]:
    """Run the episodes in the worlds from index `first` on, in order; arguments as for `Evaluator.run_from`."""
    for episode in evaluator.run_from(policy, first, executor):
        yield SuiteEpisode.of(episode, suite, evaluator.scene.task.control_period)


def restore_evaluation(result: SuiteResult, folder: Path) -> tuple[Evaluator, Policy]:
    """Restore the evaluator and the policy of a result, to repeat its episodes with `Evaluator.replay`.

    Args:
        result: The result.
        folder: The folder of the result file, which may be the run folder of the policy.

    Raises:
        InputError: If the config is invalid, the policy or the worlds are missing or changed, or episodes are missing.
    """
    try:
        config = config_from(result.config)
    except (*LIBRARY_ERRORS, ImportError) as error:  # LIBRARY_ERRORS contain ValueError, and so InputError
        raise InputError(one_line(f"the config of the result is invalid in this installation: {error}")) from None
    policy = make_baseline(config) if result.policy_digest is None else _find_policy(result, folder)
    suite = find_suite(result.suite, None if result.suite_path is None else Path(result.suite_path))
    if (suite.digest, len(suite.worlds)) != (result.suite_digest, len(result.episodes)):
        raise InputError(f"the worlds of suite {suite.name} have changed since the evaluation, or episodes are missing")
    scene = suite_scene(config.scene, suite)
    check_spaces(policy, scene)
    return suite_evaluator(scene, workers=1, simulation=result.simulation), policy


def _find_policy(result: SuiteResult, folder: Path) -> Policy:
    for reference in (result.policy, folder):
        if not str(reference).startswith(HUB):  # a result file must not cause a download
            with suppress(InputError, OSError):
                if policy_digest(reference) == result.policy_digest:
                    return load(reference)
    raise InputError(f"the policy {result.policy} is missing or has changed since the evaluation")


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None
