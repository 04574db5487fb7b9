"""Evaluations: the episodes of a policy in any simulator, in slots of one process or spread over several.

The standard evaluation has 100 episodes of at most 1500 control steps from frozen random initial states.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from tb2rl.core.processes import processors
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import (
    Episode,
    EpisodeStart,
    Policy,
    draws_random_numbers,
    run_episodes,
    slots_for,
)
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.moments import Moment, moments_of
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.execution.executor import Executor
from tb2rl.execution.local import LocalExecutor
from tb2rl.simulation import InitialState, SimulatorType, default_simulator, find_simulator
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
SEED = 20_180_000  # of the standard evaluation; trainings with small seeds never draw its initial states
TRAINING_SEED = 20_190_000  # of the evaluations while training
PASSED = 0.95  # success rate from which a training counts as one that has learned
_SLOTS, _MANY_SLOTS = 25, 1024  # of a process: where a slot costs a world of its own, and where it is a row of arrays
_BLOCK = 100  # initial states that are drawn together, see `random_initial_states`


class Evaluator:
    """Evaluates policies in episodes that are fixed; control loops stay open between evaluations.

    Args:
        scene: The task and the worlds; its time limit is replaced.
        initial_states: One row for each episode, see `random_initial_states`.
        steps: Time limit of an episode [control steps].
        seed: Episode number n has the seed `seed` + n, for its noise and for the robot's variation.
        workers: Processes; None: what suits the simulator, 1: this process alone.
        simulation: What `find_simulator` takes; None: `default_simulator`.

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
        self.initial_states = [InitialState(row[None]) for row in initial_states.table]
        self._loops = _Loops(self.scene, self.simulator)
        workers = min(workers or (processors() if self.simulator.in_processes else 1), len(self.initial_states))
        self._executor = None
        if workers > 1 and not self.simulator.is_robot:
            # An error of the simulator is raised here, and not in a process.
            ControlLoop.open(self.scene, self.simulator, processes=1).close()
            self._executor = LocalExecutor(workers)

    def run(self, policy: Policy, progress: bool = False) -> Evaluation:
        """Drive all episodes.

        Args:
            policy: The policy.
            progress: Whether to draw a bar, where there is a terminal.
        """
        count = len(self.initial_states)
        shown = progress_bar(self.drive(policy), "evaluating", "episode", total=count, shown=progress)
        return Evaluation(list(shown), self.scene, self.seed, self.simulator.name)

    def drive(self, policy: Policy, first: int = 0, executor: Executor | None = None) -> Iterator[Episode]:
        """Drive the episodes from number `first` on; each comes when it and all before it are over.

        An `executor` drives them in place of the processes of this evaluator.
        """
        numbers = range(first, len(self.initial_states))
        executor = executor or self._executor
        if executor is None:
            starts = self._starts(numbers)
            yield from _in_order(self._loops.drive(policy, starts), starts)
            return
        size = min(_SLOTS, max(1, len(numbers) // (2 * executor.num_workers)))
        parts = [self._starts(numbers[i : i + size]) for i in range(0, len(numbers), size)]
        for episodes in executor.map(_drive, parts, shared=(self._loops, policy)):
            yield from episodes

    def moments(self, policy: Policy, number: int) -> list[Moment]:
        """The control steps of one episode, driven in this process; it is the same one that `drive` drives."""
        with closing(ControlLoop.open(self.scene, self.simulator)) as loop:
            return list(moments_of(loop, policy, self._starts([number])[0]))

    def _starts(self, numbers: Sequence[int]) -> list[EpisodeStart]:
        starts = []
        for number in numbers:
            seed = self.seed + number
            rng = np.random.default_rng(seed)
            initial_state = self.scene.randomized(self.initial_states[number], rng)
            starts.append(EpisodeStart(number, seed, initial_state, rng))
        return starts

    def close(self) -> None:
        """End the processes, and close the loops."""
        if self._executor is not None:
            self._executor.close()
        self._loops.close()

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def random_initial_states(scene: Scene, episodes: int, seed: int) -> InitialState:
    """Random poses in the free space, and random goals if the task draws them; one row for each episode.

    They are drawn in blocks of 100, so that those of an episode do not depend on how many follow.
    """
    blocks = -(-episodes // _BLOCK)
    tables = [_block(scene, [seed, *([block] if block else [])]) for block in range(blocks)]
    return InitialState(np.concatenate(tables)[:episodes])


def _block(scene: Scene, seed: list[int]) -> np.ndarray:
    def drawn(task: Task) -> InitialState:
        rng = np.random.default_rng(seed if len(seed) > 1 else seed[0])
        return task.initial_state(scene.spec, GeneratorDraws(rng, _BLOCK))

    states = drawn(replace(scene.task, start="random"))
    if scene.task.start == "fixed":  # then the goals are those of the worlds
        own = drawn(scene.task)
        states.goal[:], states.goal_path[:] = own.goal, own.goal_path
    return states.table


class _Loops:
    """Control loops of one process, by their number of slots; they open when they are needed first."""

    def __init__(self, scene: Scene, simulator: SimulatorType) -> None:
        self._scene, self._simulator = scene, simulator
        self._open: dict[int, ControlLoop] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_open": {}}

    def drive(self, policy: Policy, starts: Sequence[EpisodeStart]) -> Iterator[tuple[int, Episode]]:
        """Drive episodes, and give number and record of each as it ends."""
        most = _SLOTS if self._simulator.in_processes else _MANY_SLOTS
        slots = 1 if self._simulator.is_robot else slots_for(policy, min(most, len(starts)))
        if slots > 1 and draws_random_numbers(policy, self._scene.observation_space):
            slots = 1
        if slots not in self._open:
            processes = 1 if self._simulator.in_processes else None
            self._open[slots] = ControlLoop.open(self._scene, self._simulator, slots, processes=processes)
        yield from run_episodes(self._open[slots], policy, starts, self._simulator.is_robot)

    def close(self) -> None:
        """Release what the simulators hold."""
        for loop in self._open.values():
            loop.close()
        self._open = {}


def _drive(loops: _Loops, policy: Policy, starts: Sequence[EpisodeStart]) -> list[Episode]:
    """A part of an evaluation in a worker process, whose loops stay open."""
    return list(_in_order(loops.drive(policy, starts), starts))


def _in_order(numbered: Iterator[tuple[int, Episode]], starts: Sequence[EpisodeStart]) -> Iterator[Episode]:
    """Episodes in the order of their starts, each as soon as it and all before it are known."""
    known: dict[int, Episode] = {}
    for start in starts:
        while start.number not in known:
            number, episode = next(numbered)
            known[number] = episode
        yield known.pop(start.number)
