"""Evaluations: the episodes of a policy in any simulator, in slots of one process or spread over several.

The standard evaluation has 100 episodes of at most 1500 control steps from frozen random initial states.
"""

from __future__ import annotations

import pickle
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cloudpickle
import numpy as np
import torch as th

from tb2rl.core.processes import end_with_parent, main_hidden, process_context, processors
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
from tb2rl.execution.job import Job
from tb2rl.execution.running import in_order
from tb2rl.execution.where import Where
from tb2rl.simulation import InitialState, SimulatorType, default_simulator, find_simulator
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
SEED = 20_180_000  # of the standard evaluation; trainings with small seeds never draw its initial states
TRAINING_SEED = 20_190_000  # of the evaluations while training
PASSED = 0.95  # success rate from which a training counts as successful
_SLOTS, _MANY_SLOTS = 25, 1024  # of a process: where a slot costs a world of its own, and where it is a row of arrays
_BLOCK = 100  # initial states that are drawn together, see `random_initial_states`


class Evaluator:
    """Stands ready to evaluate policies: control loops stay open between evaluations.

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
        self.scene, self.seed = self.simulator.prepare(scene.changed(episode_steps=steps)), seed
        self.initial_states = [InitialState(row[None]) for row in initial_states.table]
        self._loops = _Loops(self.scene, self.simulator)
        ControlLoop.open(self.scene, self.simulator).close() if not self.simulator.is_robot else None
        most = processors() if self.simulator.in_processes else 1
        workers = min(workers or most, len(self.initial_states))
        self._pool = None
        if workers > 1 and not self.simulator.is_robot:
            shared = (cloudpickle.dumps(self._loops),)
            self._pool = ProcessPoolExecutor(workers, process_context(), initializer=_make_ready, initargs=shared)
        self._workers = workers

    def run(self, policy: Policy, progress: bool = False) -> Evaluation:
        """Drive all episodes.

        Args:
            policy: What drives.
            progress: Whether to draw a bar, where there is a terminal.
        """
        count = len(self.initial_states)
        shown = progress_bar(self.drive(policy), "evaluating", "episode", total=count, shown=progress)
        return Evaluation(list(shown), self.scene, self.seed, self.simulator.name)

    def drive(self, policy: Policy, first: int = 0, where: Where | None = None) -> Iterator[Episode]:
        """Drive the episodes from number `first` on; each comes when it and all before it are over.

        With `where`, they are driven there, and not by the processes of this evaluator.
        """
        numbers = range(first, len(self.initial_states))
        if where is None and self._pool is None:
            yield from _in_order(self._loops.drive(policy, self._starts(numbers)), first)
            return
        size = min(_SLOTS, -(-len(numbers) // (2 * max(self._workers, 2)))) or 1
        parts = [numbers[i : i + size] for i in range(0, len(numbers), size)]
        if where is not None:
            jobs = [Job(f"episodes from {part[0]}", _drive_job, (self._starts(part),)) for part in parts]
            for episodes in in_order(jobs, where, (self._loops, policy)):
                yield from episodes
            return
        assert self._pool is not None
        with TemporaryDirectory() as folder:  # a table can have millions of values: through no pipe, each time
            file = Path(folder, "policy")
            file.write_bytes(cloudpickle.dumps(policy))
            with main_hidden():  # processes start as they are needed
                results = [self._pool.submit(_drive_part, file, self._starts(part)) for part in parts]
            for result in results:
                yield from result.result()

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
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
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

    states = drawn(scene.changed(start="random").task)
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
        yield from run_episodes(self._open[slots], policy, starts)

    def close(self) -> None:
        """Release what the simulators hold."""
        for loop in self._open.values():
            loop.close()
        self._open = {}


def _in_order(numbered: Iterator[tuple[int, Episode]], first: int) -> Iterator[Episode]:
    """Episodes by their numbers, which count on from `first`."""
    waiting: dict[int, Episode] = {}
    for number, episode in numbered:
        waiting[number] = episode
        while first in waiting:
            yield waiting.pop(first)
            first += 1


_loops: _Loops  # of a worker process


def _make_ready(loops: bytes) -> None:
    global _loops
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that asked decides
    th.set_num_threads(1)
    _loops = pickle.loads(loops)


def _drive_part(policy: Path, starts: Sequence[EpisodeStart]) -> list[Episode]:
    return list(_in_order(_loops.drive(pickle.loads(policy.read_bytes()), starts), starts[0].number))


def _drive_job(shared: tuple[_Loops, Policy], _: None, starts: Sequence[EpisodeStart]) -> list[Episode]:
    loops, policy = shared  # the same for all jobs of a process: its loops stay open
    return list(_in_order(loops.drive(policy, starts), starts[0].number))
