"""Environments in parallel processes, several in each.

Stable-Baselines3's `SubprocVecEnv` gives every environment a process and every step a message of its own; a step of
this physics is so short that the messages cost more than it does. Here each process serves several.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from multiprocessing import spawn
from multiprocessing.connection import Connection
from typing import Any, NoReturn

import cloudpickle
import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from stable_baselines3.common.vec_env.util import dict_to_obs

from tb2rl.errors import InputError

# Imported once, in the server that new processes are forked from.
PRELOADED = ["tb2rl.envs.single", "tb2rl.simulation.bullet", "stable_baselines3.common.monitor", "cloudpickle"]
_AWAKE = 5e-3  # [s] more than the environments of a process take for a step
_let_others_run = getattr(os, "sched_yield", lambda: None)  # macOS and Windows have none


def process_context() -> Any:
    """How processes start: from a clean server (a plain fork would copy torch's threads), elsewhere than on Linux anew.

    macOS has such a server, too, but its libraries do not bear a fork.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


@contextmanager
def main_hidden() -> Iterator[None]:
    """Start processes in this thread without the user's script: they would run it again, from its first line.

    Other threads go on as before, and so does the module `__main__`: they may be asking where it comes from.
    """
    before = getattr(_hiding, "main", False)
    _hiding.main = True
    try:
        yield
    finally:
        _hiding.main = before


_hiding = threading.local()
_preparation_data = spawn.get_preparation_data


def _data_without_main(name: str) -> dict[str, Any]:
    """What `multiprocessing` tells a new process of this name; it has no switch for leaving the script out."""
    data = _preparation_data(name)
    return {k: v for k, v in data.items() if not (getattr(_hiding, "main", False) and k.startswith("init_main_from_"))}


spawn.get_preparation_data = _data_without_main


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ProcessVecEnv(VecEnv):
    """A `VecEnv` over environments in other processes.

    Args:
        makers: Functions that make the environments, called in the processes.
        processes: Among how many processes to share them out, this one among them; None: one for each processor.
    """

    def __init__(self, makers: Sequence[Callable[[], gym.Env]], processes: int | None = None) -> None:
        context = process_context()
        shares = np.array_split(np.arange(len(makers)), min(processes or processors(), len(makers)))
        self._parts = [slice(int(share[0]), int(share[-1]) + 1) for share in shares]
        # The first share is this process's own: it would do nothing while it waits for the others.
        self._pipes: list[Connection | _Here] = [_Here(makers[self._parts[0]])]
        self._processes = []
        for part in self._parts[1:]:
            ours, theirs = context.Pipe()
            pickled = cloudpickle.dumps(list(makers[part]))
            process = context.Process(target=_serve, args=(theirs, pickled), daemon=True)
            with main_hidden():
                process.start()
            theirs.close()
            self._pipes.append(ours)
            self._processes.append(process)
        try:
            observation_space, action_space, render_mode = self._ask("spaces")[0]
        except Exception:
            self.close()
            raise
        self._render_mode = render_mode
        super().__init__(len(makers), observation_space, action_space)

    def __reduce__(self) -> NoReturn:
        raise InputError("environments in processes cannot be copied or sent; make others")

    def reset(self) -> VecEnvObs:
        return _joined(self._ask("reset"))

    def step_async(self, actions: np.ndarray) -> None:
        for pipe, part in zip(self._pipes, self._parts, strict=True):
            pipe.send(("step", (actions[part],)))

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = zip(*self._answers(), strict=True)
        return _joined(observations), np.concatenate(rewards), np.concatenate(dones), list(chain(*infos))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the environments with `seed`, `seed` + 1, ... from their next reset on."""
        if seed is None:
            seed = int(np.random.default_rng().integers(2**31))
        for pipe, part in zip(self._pipes, self._parts, strict=True):
            pipe.send(("seed", (seed + part.start,)))
        return list(chain(*self._answers()))

    def close(self) -> None:
        for pipe in self._pipes:
            pipe.close()  # the process sees the end and leaves
        for process in self._processes:
            process.join(timeout=5)
            process.terminate()
        self._pipes, self._processes = [], []

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        if attr_name == "render_mode":  # asked for before the base class is ready
            return [self._render_mode] * sum(part.stop - part.start for part in self._parts)
        return self._ask_some("get_attr", (attr_name,), indices)

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        self._ask_some("set_attr", (attr_name, value), indices)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        return self._ask_some("env_method", (method_name, *method_args), indices, method_kwargs)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        return self._ask_some("env_is_wrapped", (wrapper_class,), indices)

    def _ask(self, method: str, *arguments: Any) -> list[Any]:
        for pipe in self._pipes:
            pipe.send((method, arguments))
        return self._answers()

    def _ask_some(
        self, method: str, arguments: tuple, indices: int | Iterable[int] | None, named: Any = None
    ) -> list[Any]:
        """Call a method of the environments with `indices`; the answers in their order."""
        wanted = list(self._get_indices(indices))
        asked = []
        for pipe, part in zip(self._pipes, self._parts, strict=True):
            here = [i for i in wanted if part.start <= i < part.stop]
            if here:
                pipe.send((method, arguments, {**(named or {}), "indices": [i - part.start for i in here]}))
                asked.append((pipe, here))
        answers = _unless_failed([pipe.recv() for pipe, _ in asked])
        found: dict[int, Any] = {}
        for (_, here), answer in zip(asked, answers, strict=True):
            found.update(zip(here, answer or [None] * len(here), strict=True))
        return [found[i] for i in wanted]

    def _answers(self) -> list[Any]:
        return _unless_failed([_soon(pipe) for pipe in self._pipes])


def _soon(pipe: Connection | _Here) -> Any:
    """What comes next; at first waited for awake: a processor that has gone to sleep may need a millisecond to wake."""
    until = time.perf_counter() + _AWAKE
    while not pipe.poll() and time.perf_counter() < until:
        _let_others_run()
    return pipe.recv()


def _joined(parts: Sequence[Any]) -> Any:
    """The observations of all processes as one."""
    if isinstance(parts[0], dict):
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return np.concatenate(parts)


def _unless_failed(answers: list[Any]) -> list[Any]:
    for answer in answers:
        if isinstance(answer, Exception):
            raise answer
    return answers


class _Part(DummyVecEnv):
    """The environments of one process.

    What a step comes to is pickled at once, so nothing of it is copied before, as `DummyVecEnv` does: its deep copies
    of the infos take a tenth of the time of a step.
    """

    def step_wait(self) -> VecEnvStepReturn:
        infos: list[dict[str, Any]] = []
        for i, (env, action) in enumerate(zip(self.envs, self.actions, strict=True)):
            observation, self.buf_rews[i], terminated, truncated, info = env.step(action)
            self.buf_dones[i] = terminated or truncated
            info["TimeLimit.truncated"] = truncated and not terminated
            if terminated or truncated:
                info["terminal_observation"] = observation
                observation, self.reset_infos[i] = env.reset()
            self._save_obs(i, observation)
            infos.append(info)
        return dict_to_obs(self.observation_space, self.buf_obs), self.buf_rews, self.buf_dones, infos


class _Here:
    """The share of the process that asks: it answers as the pipe to another one does."""

    def __init__(self, makers: Sequence[Callable[[], gym.Env]]) -> None:
        self._answers = _Answers(makers)

    def send(self, message: tuple[Any, ...]) -> None:
        self._message = message

    def poll(self) -> bool:
        return True

    def recv(self) -> Any:
        return self._answers.to(*self._message)

    def close(self) -> None:
        self._answers.close()


class _Answers:
    """What environments, made when the first question comes, answer to calls of their methods."""

    def __init__(self, makers: Sequence[Callable[[], gym.Env]]) -> None:
        self._makers = makers
        self._env: _Part | None = None

    def to(self, method: str, arguments: tuple, named: Mapping[str, Any] | None = None) -> Any:
        """The answer, or the exception that it fails with: it is raised again where it was asked for."""
        try:
            env = self._env = self._env or _Part(list(self._makers))
            if method == "spaces":
                return env.observation_space, env.action_space, env.render_mode
            return getattr(env, method)(*arguments, **(named or {}))
        except Exception as error:
            return error

    def close(self) -> None:
        if self._env is not None:
            self._env.close()


def _serve(pipe: Connection, pickled: bytes) -> None:
    """The life of another process: answer calls of its environments' methods until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the training decides what it means
    answers: _Answers | None = None
    while True:
        try:
            message = _soon(pipe)
        except (EOFError, OSError):
            break
        try:
            answers = answers or _Answers(pickle.loads(pickled))
            answer = answers.to(*message)
        except Exception as error:  # what came cannot be unpickled here
            answer = error
        try:
            pipe.send(answer)
        except OSError:  # nobody listens any more
            break
    if answers is not None:
        answers.close()
