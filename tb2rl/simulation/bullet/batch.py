"""Many robots in PyBullet, each in a world of its own, distributed among processes.

PyBullet steps one world at a time and holds the interpreter meanwhile. A step is so short that a message for each world
would cost a good part of it. Therefore each process serves several, and robot states come through shared memory.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NoReturn

import cloudpickle
import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import main_hidden, process_context, processors
from tb2rl.core.signals import ignore_ending_signals
from tb2rl.simulation.bullet.share import Share
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.robot_state import CameraSource, RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import SimulationSpec

_SPIN = 5e-3  # [s] more than the worlds of a process take for a step
_let_others_run = getattr(os, "sched_yield", lambda: None)  # macOS and Windows have none


class BulletBatch:
    """Robots in worlds of their own; see `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
        processes: Number of processes, with this one; None: one for each processor.

    Raises:
        InputError: If PyBullet cannot load the robot.
    """

    travelled: np.ndarray

    def __init__(self, spec: SimulationSpec, num_envs: int, processes: int | None = None) -> None:
        self.spec, self.num_envs = spec, num_envs
        shares = np.array_split(np.arange(num_envs), min(processes or processors(), num_envs))
        self._parts = [slice(int(share[0]), int(share[-1]) + 1) for share in shares]
        # The first share is this process's own, which would have nothing to do while the others step.
        self._share = Share(spec, len(shares[0]))
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
            with _translate_errors():
                _raise_errors([_receive(pipe) for pipe in self._pipes])  # they have opened their worlds
        except Exception:
            self.close()
            raise
        self._poses = self._latest().pose

    def __reduce__(self) -> NoReturn:
        raise InputError("PyBullet's worlds in processes cannot be copied or sent; make others")

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        each = rng.spawn(self.num_envs) if isinstance(rng, np.random.Generator) else list(rng)
        self._records["initial_state"] = initial_state.table
        self._call("reset", [(each[part],) for part in self._parts])
        return self._latest()

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        before = self._poses
        self._records["command"] = commands
        skipped = [None if skip is None else skip[part] for part in self._parts]
        self._call("step", [(duration, each) for each in skipped])
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
        places = list(self._places_of(indices))
        sources: list[Any] = [None] * len(places)
        if rng is not None:
            ends = np.cumsum([len(each) for each in places]).tolist()
            sources = [rng[end - len(each) : end] for end, each in zip(ends, places, strict=True)]
        self._call("reset_at", [(each, own) if each else None for each, own in zip(places, sources, strict=True)])
        return self._latest(), self._robot_state(self._records[indices], _SelectedCameras(self, indices))

    def state(self) -> dict[str, Any]:
        """The state of each world, and the poses of the latest robot state."""
        worlds = [world for share in self._call("state", [()] * len(self._parts)) for world in share]
        return {"worlds": worlds, "poses": self._poses.copy()}

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a state.

        Raises:
            ValueError: If it names a world that does not exist.
        """
        worlds = state["worlds"]
        self._call("restore", [(worlds[part],) for part in self._parts])
        robot_state = self._latest()
        self._poses = state["poses"].copy()
        return robot_state

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Images from the latest poses, see `RobotState.render_camera`."""
        return self.render_cameras(np.arange(self.num_envs), width, height)

    def render_cameras(self, indices: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """The same of some environments, ascending, shape (n,)."""
        images = self._call(
            "render_cameras", [(each, width, height) if each else None for each in self._places_of(indices)]
        )
        colours, depth = zip(*(image for share in images for image in share), strict=True)
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

    def _call(self, method: str, arguments: Sequence[tuple | None]) -> list[Any]:
        """Call a method of the shares, with arguments for each (None: do not call it), and return the results."""
        mine, *theirs = arguments
        called = [(pipe, given) for pipe, given in zip(self._pipes, theirs, strict=True) if given is not None]
        with _translate_errors():
            for pipe, given in called:
                pipe.send((method, given))
            try:
                results = [] if mine is None else [_result(self._share, method, mine)]
            finally:  # a result left in a pipe would be taken for that of the next call
                others = [_receive(pipe) for pipe, _ in called]
        return _raise_errors(results + others)

    def _places_of(self, indices: np.ndarray) -> Iterator[list[int]]:
        """For each share, the places in it of these environments, shape (n,)."""
        for part in self._parts:
            yield [i - part.start for i in indices.tolist() if part.start <= i < part.stop]

    def _latest(self) -> RobotState:
        robot_state = self._robot_state(self._records, self)
        self._poses = robot_state.pose
        return robot_state

    def _robot_state(self, records: np.ndarray, camera: CameraSource) -> RobotState:
        """The robot state in some records, in arrays of its own."""
        columns: dict[str, Any] = {name: records[name].copy() for name in self._share.names}
        return RobotState(**columns, initial_state=InitialState(records["initial_state"].copy()), camera=camera)


@dataclass(frozen=True)
class _SelectedCameras:
    """The cameras of some environments of a batch."""

    batch: BulletBatch
    indices: np.ndarray  # ascending, shape (n,)

    @property
    def spec(self) -> SimulationSpec:
        """The robot, its laser and the worlds."""
        return self.batch.spec

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """See `RobotState.render_camera`."""
        return self.batch.render_cameras(self.indices, width, height)


def _receive(pipe: Connection) -> Any:
    """Receive the next message; spin at first, because a sleeping processor may need a millisecond to wake."""
    until = time.perf_counter() + _SPIN
    while not pipe.poll() and time.perf_counter() < until:
        _let_others_run()
    return pipe.recv()


@contextmanager
def _translate_errors() -> Iterator[None]:
    """Turn the end of a process that should answer into one line."""
    try:
        yield
    except (EOFError, OSError):
        raise InputError(
            "a process with worlds of PyBullet has ended: something killed it, or the memory is too small"
        ) from None


def _result(share: Share, method: str, arguments: tuple) -> Any:
    """The result of a call, or its exception, which the caller raises again."""
    try:
        return getattr(share, method)(*arguments)
    except Exception as error:
        return error


def _raise_errors(results: list[Any]) -> list[Any]:
    for result in results:
        if isinstance(result, Exception):
            raise result
    return results


def _serve(pipe: Connection, pickled: bytes, memory: Any, part: slice) -> None:
    """Answer calls of a share's methods until the pipe closes; runs in a process of its own."""
    ignore_ending_signals()
    try:
        share = Share(pickle.loads(pickled), part.stop - part.start)
        share.write_to(np.frombuffer(memory, share.record_type)[part])
    except Exception as error:
        pipe.send(error)
        return
    pipe.send(None)
    with closing(share), suppress(EOFError, OSError):  # the other end has closed
        while True:
            method, arguments = _receive(pipe)
            pipe.send(_result(share, method, arguments))
