"""Driving the episodes of an evaluation, spread over processes; the standard one is the judge of every policy.

They drive in PyBullet, or in its fast twin where PyBullet is missing: an `Evaluation` says in which.
"""

from __future__ import annotations

import pickle
import signal
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.errors import InputError
from tb2rl.core.processes import end_with_parent, main_hidden, process_context, processors
from tb2rl.deploy.ros.robot import RosRobot
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.evaluation.evaluation import Episode, Evaluation, episode_of
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.robot import evaluate_on_robot
from tb2rl.evaluation.rollout import Moment, Policy, roll_out, roll_out_together, time_limit
from tb2rl.evaluation.spaces import check_observes
from tb2rl.execution.job import Job
from tb2rl.execution.running import in_order
from tb2rl.execution.where import Where
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import SIMULATIONS, InitialState, Judge, judging_simulation
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
TOGETHER = 5  # episodes in lockstep in a process, so that a network is asked once for all of them
SEED = 20_180_000  # of the standard start poses; trainings with small seeds never draw them
TRAINING_SEED = 20_190_000  # of the evaluations while training
PASSED = 0.95  # success rate from which a training counts as one that has learned


class Evaluator:
    """Environments that stand ready to evaluate policies, spread over processes.

    Args:
        scene: Where and what to do; its start poses and time limit are replaced.
        episodes: How many, each in a world that is drawn for it, from a start pose of its own.
        steps: Control steps at most in an episode.
        seed: Of the start poses and of all noise.
        workers: Processes; None: one for each processor, 1: this one alone.
        each_world: Instead of `episodes`, one in each of the scene's worlds in their order, from the world's start.
        only: Of all these, drive only the first so many; None: all.
        simulation: "bullet" or "kinematic"; None: see `judging_simulation`.

    Raises:
        InputError: If an environment of the scene cannot be opened, for example because of its robot's URDF file.
    """

    def __init__(
        self,
        scene: Scene,
        episodes: int = EPISODES,
        steps: int = STEPS,
        seed: int = SEED,
        workers: int | None = None,
        each_world: bool = False,
        only: int | None = None,
        simulation: Judge | None = None,
    ) -> None:
        self.scene, self.seed = scene.changed(episode_steps=steps), seed
        self.simulation = simulation or judging_simulation()
        starts = InitialState(scene.spec.table) if each_world else _random_starts(scene, episodes, seed)
        self.starts = [InitialState(row[None]) for row in starts.table[:only]]
        workers = min(workers or processors(), len(self.starts))
        self._pool = None
        if workers > 1:
            # Says here, and not in a process that then breaks, what cannot be opened.
            TurtleBot2Env(self.scene, simulation=self.simulation).close()
            arguments = (cloudpickle.dumps(self.scene), self.simulation)
            self._pool = ProcessPoolExecutor(workers, process_context(), initializer=_make_ready, initargs=arguments)

    def run(self, policy: Policy, progress: bool = False) -> Evaluation:
        """Drive all episodes.

        Args:
            policy: What drives.
            progress: Whether to draw a bar, where there is a terminal.
        """
        shown = progress_bar(self.drive(policy), "evaluating", "episode", total=len(self.starts), shown=progress)
        return Evaluation(list(shown), self.scene, self.seed, self.simulation)

    def drive(self, policy: Policy, first: int = 0, where: Where | None = None) -> Iterator[Episode]:
        """Drive the episodes from number `first` on; each comes when it and all before it are over.

        With `where`, they are driven there, and not by the processes of this evaluator.
        """
        together = _together(policy)
        begun = first - first % together
        groups = [self._group(i, together) for i in range(begun, len(self.starts), together)]
        if where is not None:
            driven = self._drive_at(where, policy, groups)
        elif self._pool is not None:
            driven = self._drive_in(self._pool, policy, groups)
        else:
            driven = self._drive_here(policy, groups)
        return islice(driven, first - begun, None)

    def moments(self, policy: Policy, number: int) -> list[Moment]:
        """Drive one episode, here, and say all that happened in it; it is the same one that `drive` drives."""
        together = _together(policy)
        place = number % together
        with closing(_Envs(self.scene, self.simulation)) as envs:
            return envs.moments(policy, self._group(number - place, together))[place]

    def _group(self, first: int, together: int) -> _Group:
        starts = self.starts[first : first + together]
        return _Group([self.seed + first + i for i in range(len(starts))], starts)

    def _drive_here(self, policy: Policy, groups: Sequence[_Group]) -> Iterator[Episode]:
        with closing(_Envs(self.scene, self.simulation)) as envs:
            for group in groups:
                yield from envs.drive(policy, group)

    def _drive_in(self, pool: ProcessPoolExecutor, policy: Policy, groups: Sequence[_Group]) -> Iterator[Episode]:
        with TemporaryDirectory() as folder:  # a table can have millions of values: through no pipe, each time
            file = Path(folder, "policy")
            file.write_bytes(cloudpickle.dumps(policy))
            with main_hidden():  # processes start as they are needed
                jobs = [pool.submit(_drive_some, file, group) for group in groups]
            for job in jobs:
                yield from job.result()

    def _drive_at(self, where: Where, policy: Policy, groups: Sequence[_Group]) -> Iterator[Episode]:
        jobs = [Job(f"episodes from {group.seeds[0] - self.seed}", _drive_job, (group,)) for group in groups]
        for episodes in in_order(jobs, where, (_Envs(self.scene, self.simulation), policy)):
            yield from episodes

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _random_starts(scene: Scene, episodes: int, seed: int) -> InitialState:
    """From random poses; to random goals if the task draws them."""

    def begun(task: Task) -> InitialState:
        return task.initial_state(scene.spec, GeneratorDraws(np.random.default_rng(seed), episodes))

    starts = begun(scene.changed(start="random").task)
    if scene.task.start == "fixed":  # then the goals are those of the worlds
        own = begun(scene.task)
        starts.goal[:], start.goal_path[:] = own.goal, own.way
    return starts


class _Group(NamedTuple):
    """Episodes that are driven together: the seed of each, and how it begins."""

    seeds: list[int]
    starts: list[InitialState]


class _Envs:
    """Environments that stand ready, one for each episode of a group; they open when they are needed first."""

    def __init__(self, scene: Scene, simulation: str) -> None:
        self._scene, self._simulation = scene, simulation
        self._open: list[TurtleBot2Env] = []

    def drive(self, policy: Policy, group: _Group) -> list[Episode]:
        """Drive a group of episodes."""
        return [episode_of(self._scene, moments) for moments in self.moments(policy, group)]

    def moments(self, policy: Policy, group: _Group) -> list[list[Moment]]:
        """The same, and all that happened in each."""
        while len(self._open) < len(group.starts):
            self._open.append(TurtleBot2Env(self._scene, simulation=self._simulation))
        envs = self._open[: len(group.starts)]
        if len(envs) == 1:
            return [list(roll_out(envs[0], policy, group.seeds[0], initial_state=group.starts[0]))]
        return roll_out_together(envs, policy, *group)

    def close(self) -> None:
        """Free what the simulations hold."""
        for env in self._open:
            env.close()


def _together(policy: Policy) -> int:
    """How many episodes are driven in lockstep.

    The groups are the same whoever drives them, and so is what a policy draws and how its sums are rounded.
    """
    return TOGETHER if isinstance(policy, BasePolicy) else 1


def evaluate(
    policy: Policy | str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    task: str | Task | type[Task] | None = None,
    observation: str | None = None,
    steps: int | None = None,
    progress: bool = False,
    simulation: RosRobot | str | None = None,
    **conditions: Any,
) -> Evaluation:
    """Evaluate a policy; the standard evaluation unless the settings or `conditions` say otherwise.

    Where worlds are generated, it is in test worlds, which no training draws.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`, such as a model of
            Stable-Baselines3 that was trained without tb2rl.
        config: What it is to do; None: the task, else what it was trained to do.
        settings: Changes to the task by name, for example {"world": "circuit"}.
        task: What it is to do: a task's name, "module:Class", a `Task` or its class; in place of `config`.
        observation: How it observes that task, "discrete" or "raw"; None: as its observation space says.
        steps: Control steps at most in an episode; None: `episode_steps` of the settings, else 1500.
        progress: Whether to draw a bar, where there is a terminal.
        simulation: "bullet" or "kinematic"; "ros" or a `RosRobot`: a robot to drive instead, and conditions are those
            of `evaluate_on_robot`; None: PyBullet's physics, or where PyBullet is missing or broken its fast twin.
        conditions: Arguments of `Evaluator`: episodes, seed, workers, only.

    Raises:
        InputError: If there is no such policy, a setting does not fit, or the policy knows other observations or
            actions than the task has.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    conditions["steps"] = time_limit(steps, settings or {}, STEPS)
    scene = _scene(policy, config, task, observation, settings or {})
    check_observes(policy, scene)
    if not (simulation is None or simulation in SIMULATIONS):
        conditions = {"seed": SEED, **conditions}
        return evaluate_on_robot(getattr(policy, "policy", policy), scene, simulation, progress=progress, **conditions)
    scene = scene.worlds_for("test")
    with Evaluator(scene, **conditions, simulation=simulation) as evaluator:  # type: ignore[arg-type]
        return evaluator.run(getattr(policy, "policy", policy), progress)


def _scene(
    policy: Any,
    config: Config | None,
    task: str | Task | type[Task] | None,
    observation: str | None,
    settings: Mapping[str, Any],
) -> Scene:
    """What a policy is to do, see `evaluate`."""
    if task is None:
        if observation is not None:
            raise InputError("observation= goes with task=; else a policy observes as it was trained to")
        if config is None and not hasattr(policy, "trained_with"):
            name = type(policy).__name__
            raise InputError(f"{name} does not come from tb2rl.load or tb2rl.train: name its task, such as task='maze'")
        return (config or config_of(policy)).with_task(settings).scene
    if config is not None:
        raise InputError("name either a config or a task")
    if observation is None:
        numbers = isinstance(getattr(policy, "observation_space", None), spaces.Box | spaces.Dict)
        observation = "raw" if numbers else "discrete"
    return make_scene(make_task(task, settings), observation)


_envs: _Envs  # of a worker process


def _make_ready(scene: bytes, simulation: str) -> None:
    global _envs
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that asked decides
    th.set_num_threads(1)
    _envs = _Envs(pickle.loads(scene), simulation)


def _drive_job(shared: tuple[_Envs, Policy], _: None, group: _Group) -> list[Episode]:
    return shared[0].drive(shared[1], group)  # the same for all jobs of a process: its environments stay open


def _drive_some(policy: Path, group: _Group) -> list[Episode]:
    return _envs.drive(pickle.loads(policy.read_bytes()), group)
