"""Many robots in PyBullet, each in a client of its own, distributed among processes.

PyBullet steps one client at a time and holds the interpreter lock meanwhile. A step is so short that a message for each
client would be expensive. Therefore each process has several clients, and robot states are in shared memory.
"""

import multiprocessing
import os
import pickle
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from multiprocessing.connection import Connection
from typing import Any, NoReturn

import cloudpickle
import numpy as np

from tb2rl.core import InputError, ignore_termination_signals
from tb2rl.core.processes import hide_main_script, process_context, processors
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.simulation.robot_state import ARRAYS, RobotState
from tb2rl.simulation.simulator import Generators, ResetGenerators, ResetStates
from tb2rl.simulation.spec import InitialState, SimulationSpec

_SPIN_TIME = 5e-3  # [s] of polling before `_receive` sleeps; longer than a step of the simulators of a process
_yield_processor = getattr(os, "sched_yield", lambda: None)  # macOS and Windows have no such function


class SimulatorGroup:
    """The simulators of one process, each with one environment.

    Attributes:
        record_type: Type of a record with the arrays of a `RobotState` of one environment.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        self._simulators = [BulletSimulator(spec) for _ in range(num_envs)]
        self._default_states = [each.reset_values(InitialState.default(spec, 1), None) for each in self._simulators]
        columns = [(name, np.array(values)) for name, values in zip(ARRAYS, self._default_states[0], strict=False)]
        self.record_type = np.dtype([(name, column.dtype, column.shape) for name, column in columns], align=True)

    def set_records(self, records: np.ndarray) -> None:
        """Set the records, shape (num_envs,), to which `call` writes robot states, and write the default states."""
        self._records, records[:] = records, self._default_states

    def call(self, method: str, indices: Sequence[int], arguments: Sequence[tuple]) -> list[Any]:
        """Call a method of the simulators `indices`, each with its own arguments; robot states go to the records."""
        results = [getattr(self._simulators[i], method)(*args) for i, args in zip(indices, arguments, strict=True)]
        if method not in ("reset_values", "step_values", "restore_values"):
            return results
        for i, robot_state in zip(indices, results, strict=True):
            self._records[i] = robot_state
        return []

    def close(self) -> None:
        for simulator in self._simulators:
            simulator.close()


class BulletBatch:
    """Many robots, each in a PyBullet client of its own; implements `tb2rl.simulation.simulator.Simulator`.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
        processes: Number of processes, including this process; None: one for each processor.

    Raises:
        InputError: If PyBullet cannot load the robot.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int, processes: int | None = None) -> None:
        self.spec, self.num_envs, self._all_indices = spec, num_envs, np.arange(num_envs)
        parts = np.array_split(self._all_indices, min(processes or processors(), num_envs))
        self._parts = [slice(int(part[0]), int(part[-1]) + 1) for part in parts]  # environments of each process
        # The first part belongs to this process, which would otherwise be idle while the other processes step.
        self._group = SimulatorGroup(spec, len(parts[0]))
        # A worker process has a batch in one process, and should not start another fork server for it.
        context, record_type = process_context() if parts[1:] else multiprocessing, self._group.record_type
        self._columns = record_type.names or ()
        memory = context.RawArray("b", num_envs * record_type.itemsize)
        self._records = np.frombuffer(memory, record_type)
        self._group.set_records(self._records[self._parts[0]])
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        pickled_spec = cloudpickle.dumps(spec)
        for part in self._parts[1:]:
            pipe, child_pipe = context.Pipe()
            process = context.Process(target=_serve, args=(child_pipe, pickled_spec, memory, part), daemon=True)
            with hide_main_script():
                process.start()
            child_pipe.close()
            self._pipes.append(pipe)
            self._processes.append(process)
        try:
            _raise_errors([_receive(pipe) for pipe in self._pipes])  # each process has made its simulators, or failed
        except Exception:
            self.close()
            raise
        self._initial_states = InitialState.default(spec, num_envs).table
        self._poses = self._robot_state().pose

    def __reduce__(self) -> NoReturn:
        raise InputError("a batch of PyBullet environments cannot be copied or pickled; make a new one")

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        generators = rng.spawn(self.num_envs) if isinstance(rng, np.random.Generator) else rng
        return self.reset_at(self._all_indices, initial_state, generators)[0]

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        before, indices = self._poses, self._all_indices if inactive is None else np.flatnonzero(~inactive)
        self._call("step_values", indices, [(command, duration) for command in commands[indices].tolist()])
        robot_state = self._robot_state()
        change = robot_state.pose - before
        self.travelled = np.hypot(change[:, 0], change[:, 1])
        return robot_state

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        initial_states = [InitialState(initial_state.table[i : i + 1].copy()) for i in range(len(indices))]
        generators = [None] * len(indices) if rng is None else rng
        self._call("reset_values", indices, list(zip(initial_states, generators, strict=True)))
        self._initial_states = self._initial_states.copy()
        self._initial_states[indices] = initial_state.table
        columns: dict[str, Any] = {name: self._records[name][indices] for name in self._columns}
        self._last_reset = indices
        return self._robot_state(), RobotState(**columns, initial_state=initial_state, simulator=self)

    def state(self) -> dict[str, Any]:
        """The state of each environment's simulator, and the poses of the latest robot state."""
        return {"worlds": self._call("state", self._all_indices, [()] * self.num_envs), "poses": self._poses.copy()}

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a state.

        Raises:
            ValueError: If an initial state is impossible, or the dynamic obstacles differ.
        """
        self._call("restore_values", self._all_indices, [(simulator_state,) for simulator_state in state["worlds"]])
        self._initial_states = np.concatenate([simulator_state["initial_state"] for simulator_state in state["worlds"]])
        robot_state = self._robot_state()
        self._poses = state["poses"].copy()  # not those of `_robot_state`, which PyBullet has rounded
        return robot_state

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Camera images for the latest robot state of all environments, or of those that were reset last."""
        indices = self._all_indices if len(robot_state.pose) == self.num_envs else self._last_reset
        colours, depth = zip(*self._call("camera", indices, [(width, height)] * len(indices)), strict=True)
        return np.stack(colours), np.stack(depth)

    def close(self) -> None:
        """End the processes, and close the simulators of this process."""
        for pipe in self._pipes:
            pipe.close()  # ends the loop of `_serve`
        for process in self._processes:
            process.join(timeout=5)
            process.kill()
        self._pipes, self._processes = [], []
        self._group.close()

    def _call(self, method: str, indices: np.ndarray, arguments: list[tuple]) -> list[Any]:
        """Call a method of the simulators with these ascending indices in all processes, see `SimulatorGroup.call`."""
        calls = []
        for part in self._parts:
            first, end = np.searchsorted(indices, (part.start, part.stop)).tolist()
            calls.append((method, (indices[first:end] - part.start).tolist(), arguments[first:end]))
        remote_calls = [(pipe, call) for pipe, call in zip(self._pipes, calls[1:], strict=True) if call[1]]
        for pipe, call in remote_calls:
            with suppress(OSError):  # the process has ended; `_receive` returns the error
                pipe.send(call)
        try:
            results = [_call_group(self._group, *calls[0])]
        finally:  # a result that stays in a pipe would be received by the next call
            results_of_others = [_receive(pipe) for pipe, _ in remote_calls]
        return [value for result in _raise_errors(results + results_of_others) for value in result]

    def _robot_state(self) -> RobotState:
        """Robot state of all environments, with copies of the records; its poses become `_poses`."""
        columns: dict[str, Any] = {name: self._records[name].copy() for name in self._columns}
        self._poses = columns["pose"]
        return RobotState(**columns, initial_state=InitialState(self._initial_states), simulator=self)


def _receive(pipe: Connection) -> Any:
    """Receive the next message; return an `InputError` if the other process has ended.

    The function polls at first, because a sleeping processor may need a millisecond to wake up.
    """
    deadline = time.perf_counter() + _SPIN_TIME
    try:
        while not pipe.poll() and time.perf_counter() < deadline:
            _yield_processor()
        return pipe.recv()
    except (EOFError, OSError):
        return InputError("a process with PyBullet environments has ended: it was killed, or ran out of memory")


def _call_group(group: SimulatorGroup, *call: Any) -> Any:
    """Return the result of `SimulatorGroup.call`, or its exception."""
    try:
        return group.call(*call)
    except Exception as error:
        return error


def _raise_errors(results: list[Any]) -> list[Any]:
    """Return the results, or raise the first exception among them."""
    for result in results:
        if isinstance(result, Exception):
            raise result
    return results


def _serve(pipe: Connection, pickled_spec: bytes, memory: Any, part: slice) -> None:
    """Main function of another process: make simulators, and answer calls until the pipe closes."""
    ignore_termination_signals()
    try:
        group = SimulatorGroup(pickle.loads(pickled_spec), part.stop - part.start)
        group.set_records(np.frombuffer(memory, group.record_type)[part])
    except Exception as error:
        pipe.send(error)
        return
    pipe.send(None)
    with closing(group), suppress(OSError):  # raised if the other end has closed
        while not isinstance(call := _receive(pipe), InputError):
            pipe.send(_call_group(group, *call))
