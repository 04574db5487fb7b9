"""Many robots in PyBullet, each in a world of its own, shared out among processes.

PyBullet steps one world at a time and lets no other thread run meanwhile. A step is so short that a message for each
world would cost a good part of it: here each process serves several, and their readings come through shared memory.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NoReturn

import cloudpickle
import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import main_hidden, process_context, processors
from tb2rl.core.signals import ignore_ending_signals
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.robot_state import CameraSource, RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import SimulationSpec

_AWAKE = 5e-3  # [s] more than the worlds of a process take for a step
_let_others_run = getattr(os, "sched_yield", lambda: None)  # macOS and Windows have none


class BulletBatch:
    """N robots that do not meet, with what `KinematicSimulator` offers a `ControlLoop`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: How many.
        processes: Among how many processes to share them out, this one among them; None: one for each processor.

    Attributes:
        travelled: How far from where it was the last step took each robot [m], shape (num_envs,).

    Raises:
        InputError: If PyBullet cannot load the robot.
    """

    travelled: np.ndarray

    def __init__(self, spec: SimulationSpec, num_envs: int, processes: int | None = None) -> None:
        self.spec, self.num_envs = spec, num_envs
        shares = np.array_split(np.arange(num_envs), min(processes or processors(), num_envs))
        self._parts = [slice(int(share[0]), int(share[-1]) + 1) for share in shares]
        # The first share is this process's own: it would do nothing while it waits for the others.
        self._share = _Share(spec, len(shares[0]))
        context, kind = process_context(), self._share.record_type
        memory = context.RawArray("b", num_envs * kind.itemsize)
        self._records = np.frombuffer(memory, kind)
        self._share.write_to(self._records[self._parts[0]])
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        pickled = cloudpickle.dumps(spec)
        for part in self._parts[1:]:
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, pickled, memory, part), daemon=True)
            with main_hidden():
                process.start()
            theirs.close()
            self._pipes.append(ours)
            self._processes.append(process)
        try:
            with _deaths_named():
                _unless_failed([_soon(pipe) for pipe in self._pipes])  # they have opened their worlds
        except Exception:
            self.close()
            raise
        self._poses = self._latest().pose

    def __reduce__(self) -> NoReturn:
        raise InputError("PyBullet's worlds in processes cannot be copied or sent; make others")

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        noise = rng.spawn(self.num_envs) if isinstance(rng, np.random.Generator) else list(rng)
        self._records["initial_state"] = initial_state.table
        self._ask("reset", [(noise[part],) for part in self._parts])
        return self._latest()

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        before = self._poses
        self._records["command"] = commands
        skipped = [None if skip is None else skip[part] for part in self._parts]
        self._ask("step", [(duration, each) for each in skipped])
        robot_state = self._latest()
        change = robot_state.pose - before
        self.travelled = np.hypot(change[:, 0], change[:, 1])
        return robot_state

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        robot_state: RobotState,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> tuple[RobotState, RobotState]:
        self._records["initial_state"][indices] = initial_state.table
        among = list(self._among(indices))
        if rng is None:
            noise: list[Any] = [None] * len(among)
        else:
            ends = np.cumsum([len(here) for here in among]).tolist()
            noise = [rng[end - len(here) : end] for end, here in zip(ends, among, strict=True)]
        self._ask("reset_at", [(here, new) if here else None for here, new in zip(among, noise, strict=True)])
        return self._latest(), self._reading(self._records[indices], _Eyes(self, indices))

    def state(self) -> dict[str, Any]:
        """The state of each world, and where the robots were at the last reading."""
        worlds = [world for share in self._ask("state", [()] * len(self._parts)) for world in share]
        return {"worlds": worlds, "poses": self._poses.copy()}

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Go on from a state.

        Raises:
            ValueError: If it names a world that is not there.
        """
        worlds = state["worlds"]
        self._ask("restore", [(worlds[part],) for part in self._parts])
        robot_state = self._latest()
        self._poses = state["poses"].copy()
        return robot_state

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """What the cameras see at the latest reading, see `RobotState.render_camera`."""
        return self.look_from(np.arange(self.num_envs), width, height)

    def look_from(self, indices: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """The same of the robots with indices `robots` (n,) alone, in rising order."""
        seen = self._ask("look", [(here, width, height) if here else None for here in self._among(indices)])
        colours, depth = zip(*(image for images in seen for image in images), strict=True)
        return np.stack(colours), np.stack(depth)

    def close(self) -> None:
        """End the processes and the worlds."""
        for pipe in self._pipes:
            pipe.close()  # the process sees the end and leaves
        for process in self._processes:
            process.join(timeout=5)
            process.kill()
        self._pipes, self._processes = [], []
        self._share.close()

    def _ask(self, method: str, arguments: Sequence[tuple | None]) -> list[Any]:
        """Call a method of the shares, each with arguments of its own, None: not of this one; their answers."""
        mine, *theirs = arguments
        asked = [(pipe, given) for pipe, given in zip(self._pipes, theirs, strict=True) if given is not None]
        with _deaths_named():
            for pipe, given in asked:
                pipe.send((method, given))
            try:
                answers = [] if mine is None else [_answer(self._share, method, mine)]
            finally:  # an answer that nobody reads would be taken for that to the next question
                answers_of_others = [_soon(pipe) for pipe, _ in asked]
        return _unless_failed(answers + answers_of_others)

    def _among(self, indices: np.ndarray) -> Iterator[list[int]]:
        """Of each share: which of the robots with indices `robots` (n,) it has, by their indices in it."""
        wanted = indices.tolist()
        for part in self._parts:
            yield [robot - part.start for robot in wanted if part.start <= robot < part.stop]

    def _latest(self) -> RobotState:
        """What all robots read now."""
        robot_state = self._reading(self._records, self)
        self._poses = robot_state.pose
        return robot_state

    def _reading(self, records: np.ndarray, camera: CameraSource) -> RobotState:
        """The reading of some robots, in arrays of its own."""
        columns: dict[str, Any] = {name: records[name].copy() for name in self._share.names}
        return RobotState(**columns, initial_state=InitialState(records["initial_state"].copy()), camera=camera)


@dataclass(frozen=True)
class _Eyes:
    """What some robots of a batch see."""

    batch: BulletBatch
    indices: np.ndarray  # their indices, in rising order, shape (n,)

    @property
    def spec(self) -> SimulationSpec:
        """The robot, its laser and the worlds."""
        return self.batch.spec

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """See `RobotState.render_camera`."""
        return self.batch.look_from(self.indices, width, height)


class _Share:
    """The worlds of one process.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: How many of them.

    Attributes:
        names: Of the arrays of a `RobotState`.
        record_type: What a robot reads and how its episode began, as one record.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        self._worlds = [BulletSimulator(spec) for _ in range(num_envs)]
        self._noise = [np.random.default_rng() for _ in range(num_envs)]
        initial_state = InitialState.default(spec, 1)
        self._first = [
            world.reset(initial_state, noise) for world, noise in zip(self._worlds, self._noise, strict=True)
        ]
        columns = self._first[0].state()
        self.names = [name for name in columns if name != "initial_state"]
        self.record_type = np.dtype([(name, c.dtype, c.shape[1:]) for name, c in columns.items()], align=True)

    def write_to(self, records: np.ndarray) -> None:
        """Write to these records, shape (num_envs,), from now on."""
        self._records, self._sensed = records, records[self.names]
        for i, robot_state in enumerate(self._first):
            self._write(i, robot_state)

    def reset(self, noise: list[np.random.Generator]) -> None:
        self.reset_at(range(len(noise)), noise)

    def reset_at(self, indices: Sequence[int], noise: Sequence[np.random.Generator] | None = None) -> None:
        """Start new episodes; their initial states stand in the records."""
        for number, i in enumerate(indices):
            if noise is not None:
                self._noise[i] = noise[number]
            initial_state = InitialState(self._records["initial_state"][i : i + 1].copy())
            self._write(i, self._worlds[i].reset(initial_state, self._noise[i]))

    def step(self, duration: float, skip: np.ndarray | None = None) -> None:
        """Drive by the commands in the records."""
        commands = self._records["command"].copy()
        for i, world in enumerate(self._worlds):
            if skip is None or not skip[i]:
                self._sensed[i] = world.drive(commands[i : i + 1], duration)

    def state(self) -> list[dict[str, Any]]:
        return [world.state() for world in self._worlds]

    def restore(self, states: Sequence[Mapping[str, Any]]) -> None:
        for i, (world, state) in enumerate(zip(self._worlds, states, strict=True)):
            self._write(i, world.restore(state))

    def look(self, indices: Iterable[int], width: int, height: int) -> list[tuple[np.ndarray, np.ndarray]]:
        return [self._worlds[i].camera(width, height) for i in indices]

    def close(self) -> None:
        for world in self._worlds:
            world.close()

    def _write(self, robot: int, robot_state: RobotState) -> None:
        self._sensed[robot] = tuple(getattr(robot_state, name)[0] for name in self.names)
        self._records["initial_state"][robot] = robot_state.initial_state.table[0]


def _soon(pipe: Connection) -> Any:
    """What comes next; at first waited for awake: a processor that has gone to sleep may need a millisecond to wake."""
    until = time.perf_counter() + _AWAKE
    while not pipe.poll() and time.perf_counter() < until:
        _let_others_run()
    return pipe.recv()


@contextmanager
def _deaths_named() -> Iterator[None]:
    """Say in one line that a process has ended that is asked something, or is to answer."""
    try:
        yield
    except (EOFError, OSError):
        raise InputError(
            "a process with worlds of PyBullet has ended: something killed it, or the memory is too small"
        ) from None


def _answer(share: _Share, method: str, arguments: tuple) -> Any:
    """The answer to a call, or the exception that it fails with: it is raised again where it was asked for."""
    try:
        return getattr(share, method)(*arguments)
    except Exception as error:
        return error


def _unless_failed(answers: list[Any]) -> list[Any]:
    for answer in answers:
        if isinstance(answer, Exception):
            raise answer
    return answers


def _serve(pipe: Connection, pickled: bytes, memory: Any, part: slice) -> None:
    """The life of another process: answer calls of its share's methods until the pipe closes."""
    ignore_ending_signals()
    try:
        share = _Share(pickle.loads(pickled), part.stop - part.start)
        share.write_to(np.frombuffer(memory, share.record_type)[part])
    except Exception as error:
        pipe.send(error)
        return
    pipe.send(None)
    with closing(share), suppress(EOFError, OSError):  # nobody asks any more, or listens
        while True:
            method, arguments = _soon(pipe)
            pipe.send(_answer(share, method, arguments))
