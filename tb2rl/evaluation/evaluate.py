"""Evaluates policies in any simulator, in one process or several.

The standard evaluation has 100 episodes of at most 1500 control steps, from random initial states of a fixed seed.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.errors import InputError
from tb2rl.core.processes import processors
from tb2rl.core.values import Count, checked
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.evaluation.episodes import Episode, EpisodeStart, EpisodeStep, Policy, check_spaces, run_episodes, run_single
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.progress import progress
from tb2rl.execution.executor import Executor
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs import Config, config_of, load
from tb2rl.runs.algorithm import torch_settings
from tb2rl.simulation import InitialState
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.simulation.simulator import default_simulator, find_simulator
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500  # number and time limit [control steps] of the standard evaluation's episodes
SEED = 20_180_000  # seed of the standard evaluation, far from the seeds that trainings use
VALIDATION_SEED = 20_190_000  # seed of the evaluations during training
SOLVED_RATE = 0.95  # minimum success rate of a solved task
# Maximum slots (environments, see `run_steps`) in a process, for simulators that need processes and for others.
_FEW_SLOTS, _MANY_SLOTS = 25, 1024
_BLOCK_SIZE = 100  # number of initial states that are drawn with one seed, see `random_initial_states`


def evaluate(
    policy: Policy | str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    task: str | Task | type[Task] | None = None,
    observation: str | None = None,
    simulation: Any = None,
    progress_bar: bool = False,
    **options: Any,
) -> Evaluation:
    """Evaluate a policy; the default is the standard evaluation at the task of its training.

    Generated worlds are test worlds, which no training draws.

    Args:
        policy: A loaded policy, a reference for `load`, or an object with `predict`, such as a Stable-Baselines3 model
            that was trained without tb2rl.
        config: A config with the task; None: `task` if given, else the config that the policy was trained with.
        settings: Task settings to change, for example {"world": "circuit"}.
        task: A task in place of `config`: a name, "module:Class", a `Task` or its class.
        observation: Mode of `task`; None: "raw" if the policy's observation space is a Box or a Dict, else "discrete".
        simulation: An argument of `find_simulator`, such as a name or a `RosRobot`; None: `default_simulator`.
        progress_bar: Whether to show a progress bar if there is a terminal.
        options: `steps` is the time limit of an episode [control steps]; its default is `episode_steps` in `settings`,
            or else 1500. `episodes` is the number of episodes; its default is 100, or 1 with an external simulator or
            a real robot. See `Evaluator` for `seed` and `workers`.

    Raises:
        InputError: If the policy does not exist, a setting is invalid, or the policy has other spaces than the task.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    settings = settings or {}
    steps, seed = time_limit(options.pop("steps", None), settings, STEPS), options.pop("seed", SEED)
    scene = _find_scene(policy, config, task, observation, settings)
    check_spaces(policy, scene)
    simulator = default_simulator() if simulation is None else find_simulator(simulation)
    if simulator.is_external:
        scene = simulator.prepare(scene)
        states = InitialState.default(scene.spec, options.pop("episodes", 1))
    else:
        scene = scene.for_purpose("test")
        states = random_initial_states(scene, options.pop("episodes", EPISODES), seed)
    with Evaluator(scene, states, steps, seed, simulation=simulator, **options) as evaluator:
        return evaluator.run(policy, progress_bar)


def _find_scene(
    policy: Any, config: Config | None, task: Any, observation: str | None, settings: Mapping[str, Any]
) -> Scene:
    """The scene of an evaluation; arguments as for `evaluate`."""
    if task is None:
        if observation is not None:
            raise InputError("observation= needs task=; without task=, the observation mode is that of the training")
        if config is None and not hasattr(policy, "trained_with"):
            name = type(policy).__name__
            raise InputError(f"{name} does not come from tb2rl.load or tb2rl.train: pass its task, such as task='maze'")
        return (config or config_of(policy)).with_task(settings).scene
    if config is not None:
        raise InputError("config= and task= both select a task; give one of them")
    is_raw = isinstance(getattr(policy, "observation_space", None), spaces.Box | spaces.Dict)
    return make_scene(make_task(task, settings), observation or ("raw" if is_raw else "discrete"))


def time_limit(steps: int | None, settings: Mapping[str, Any], default: int) -> int:
    """The time limit of an episode [control steps].

    Args:
        steps: The time limit that the caller chose, or None.
        settings: Task settings, which may contain `episode_steps`.
        default: The time limit without `steps` and `episode_steps`.

    Raises:
        InputError: If `steps` and `episode_steps` are both given, or the time limit is not a positive integer.
    """
    if steps is not None and "episode_steps" in settings:
        raise InputError("--steps (steps=) and task.episode_steps set the same time limit; give one of them")
    limit = settings.get("episode_steps", default if steps is None else steps)
    return checked(Count, limit, "task.episode_steps")


class Evaluator(AbstractContextManager["Evaluator"]):
    """Evaluates any number of policies, all in the same episodes; its control loops stay open between evaluations.

    Args:
        scene: The task and the worlds.
        initial_states: One row for each episode, see `random_initial_states`.
        steps: Time limit of an episode [control steps], in place of the scene's time limit.
        seed: Episode n uses the seed `seed + n` for its noise and for domain randomisation of the robot.
        workers: Number of processes; None: one per processor if the simulator needs processes, else 1.
        simulation: An argument of `find_simulator`; None: `default_simulator`.

    Raises:
        InputError: If the simulator cannot run here, or cannot load the robot.
    """

    def __init__(
        self,
        scene: Scene,
        initial_states: InitialState,
        steps: int = STEPS,
        seed: int = SEED,
        workers: int | None = None,
        simulation: Any = None,
    ) -> None:
        self.simulator = default_simulator() if simulation is None else find_simulator(simulation)
        self.scene, self.seed = self.simulator.prepare(scene.with_time_limit(steps)), seed
        self.initial_states = initial_states
        self._loops: dict[int, ControlLoop] = {}  # by number of slots, opened when first needed
        workers = min(workers or (processors() if self.simulator.needs_processes else 1), len(initial_states.table))
        self._executor: Executor | None = None
        if workers > 1 and not self.simulator.is_external:
            ControlLoop.open(self.scene, self.simulator, processes=1).close()  # raises errors before a worker does
            self._executor = LocalExecutor(workers)

    def __getstate__(self) -> dict[str, Any]:
        """State for a worker process, which opens its own control loops."""
        return {**vars(self), "_loops": {}, "_executor": None}

    def run(self, policy: Policy, progress_bar: bool = False) -> Evaluation:
        """Run all episodes; `progress_bar` shows a progress bar if there is a terminal."""
        count = len(self.initial_states.table)
        episodes = progress(self.run_from(policy), "evaluating", "episode", total=count, shown=progress_bar)
        return Evaluation(list(episodes), self.scene, self.seed, self.simulator.name)

    def run_from(self, policy: Policy, first: int = 0, executor: Executor | None = None) -> Iterator[Episode]:
        """Run the episodes from number `first` on, and yield each in order, once it and all before it have ended.

        If there is an `executor`, it runs the episodes in place of this evaluator's processes.
        """
        policy, numbers = _unwrap(policy), range(first, len(self.initial_states.table))
        executor = executor or self._executor
        if executor is None:
            yield from self._run_here(policy, numbers)
            return
        size = min(_FEW_SLOTS, max(1, len(numbers) // (2 * executor.num_workers)))
        parts = [numbers[i : i + size] for i in range(0, len(numbers), size)]
        for episodes in executor.map(lambda *args: list(Evaluator._run_here(*args)), parts, shared=(self, policy)):
            yield from episodes

    def _run_here(self, policy: Policy, numbers: Sequence[int]) -> Iterator[Episode]:
        """Run episodes in this process, and yield them in the order of `numbers`."""
        max_slots = _FEW_SLOTS if self.simulator.needs_processes else _MANY_SLOTS
        can_batch = not self.simulator.is_external and _can_predict_batches(policy, self.scene.observation_space)
        num_slots = min(max_slots, len(numbers)) if can_batch else 1
        if num_slots not in self._loops:
            self._loops[num_slots] = ControlLoop.open(self.scene, self.simulator, num_slots, processes=1)
        starts = [self._episode_start(number) for number in numbers]
        ended = run_episodes(self._loops[num_slots], policy, starts, clearance_from_laser=self.simulator.is_external)
        finished: dict[int, Episode] = {}  # by number; episodes may end in another order
        with torch_settings(num_threads=1):  # the networks are small, and more threads only wait for each other
            for number in numbers:
                while number not in finished:
                    finished.update([next(ended)])
                yield finished.pop(number)

    def replay(self, policy: Policy, number: int) -> list[EpisodeStep]:
        """Run one episode in this process, and return its control steps; it is the same episode as in `run`."""
        with closing(ControlLoop.open(self.scene, self.simulator)) as loop:
            return list(run_single(loop, _unwrap(policy), self._episode_start(number)))

    def _episode_start(self, number: int) -> EpisodeStart:
        seed = self.seed + number
        rng = np.random.default_rng(seed)
        initial_state = InitialState(self.initial_states.table[[number]])
        return EpisodeStart(number, seed, self.scene.vary_initial_state(initial_state, rng), rng)

    def close(self) -> None:
        """End the worker processes, and close the control loops."""
        if self._executor is not None:
            self._executor.close()
        while self._loops:
            self._loops.popitem()[1].close()

    def __exit__(self, *_: object) -> None:
        self.close()


def _unwrap(policy: Any) -> Policy:
    """The policy of a Stable-Baselines3 algorithm, whose pickle is small and which predicts batches; else `policy`."""
    return getattr(policy, "policy", policy)


def _can_predict_batches(policy: Policy, observation_space: spaces.Space) -> bool:
    """Whether a policy predicts for several observations at once, with the same actions as one by one.

    Stable-Baselines3's policies do, unless they draw random numbers from torch's generator.
    """
    if not isinstance(policy, BasePolicy):
        return False
    with th.random.fork_rng(devices=[]):
        before = th.get_rng_state()
        policy.predict(observation_space.sample(), deterministic=True)
        return th.equal(before, th.get_rng_state())


def random_initial_states(scene: Scene, episodes: int, seed: int) -> InitialState:
    """Random poses in the free space, and random goals if the task draws them; one row for each episode.

    Each block of 100 rows has a seed of its own, so that a row does not depend on `episodes`.
    """
    tables = []
    for block in range(math.ceil(episodes / _BLOCK_SIZE)):
        block_seed = [seed, block] if block else seed
        states = _draw_block(scene, block_seed, "random")
        if scene.task.start == "fixed":  # such a task has fixed goals, too, so only the poses are random
            fixed = _draw_block(scene, block_seed, "fixed")
            states.goal[:], states.records["goal_path"] = fixed.goal, fixed.records["goal_path"]
        tables.append(states.table)
    return InitialState(np.concatenate(tables)[:episodes])


def _draw_block(scene: Scene, seed: int | list[int], start: Literal["random", "fixed"]) -> InitialState:
    random = GeneratorSource(np.random.default_rng(seed), _BLOCK_SIZE)
    return replace(scene.task, start=start).initial_state(scene.spec, random)
