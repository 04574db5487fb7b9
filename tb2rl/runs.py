"""The run folder: everything about one training, and how its policies come back.

    runs/<task>/<agent>/<name>/
        config.yaml         the resolved config, and the versions of what trained it
        checkpoints/        step-<timesteps>, the last few: policy, and all that `--resume` needs
        best/policy         the best in an evaluation while training
        final/policy        the last
        evaluations.jsonl   a line for each evaluation while training
        evaluation.json     the standard evaluation; episodes.safetensors: where each of its episodes went
        tensorboard/        event files

A checkpoint holds arrays and plain values only (`tb2rl.checkpoint`): the algorithm is rebuilt from its config through
the registry, which imports the modules that the config names. Files are written beside and renamed, so a folder is
valid at every instant.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch as th
import yaml
from filelock import FileLock, Timeout
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import get_device
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from tb2rl.checkpoint import SUFFIX, read_checkpoint, replacing, write_checkpoint
from tb2rl.config import Config, algorithm_arguments, config_from
from tb2rl.errors import InputError, one_line, unknown
from tb2rl.observations import prepare
from tb2rl.registry import find_agent, import_object
from tb2rl.settings import read_yaml, room

_FOREIGN = (  # what values that fit no better than their types allow lead to, in torch and Stable-Baselines3
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError, ValueError,
)  # fmt: skip
EVALUATION, WAYS = "evaluation.json", f"episodes{SUFFIX}"  # files of the standard evaluation
_LARGEST = 1e9  # of any weight, or moment of one
_PACKAGES = ("tb2rl", "stable-baselines3", "torch", "gymnasium", "pybullet", "numpy", "numba", "safetensors")


@dataclass(frozen=True)
class Run:
    """A run folder that exists."""

    folder: Path
    config: Config

    @classmethod
    def create(cls, folder: Path, config: Config) -> Run:
        """Make the folder and write its config.

        Raises:
            InputError: If there is one already, or it cannot be written.
        """
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists already; choose another --name")
        staging = folder.absolute().with_name(f".{folder.name}.{os.getpid()}")  # it appears with its config in it
        try:
            staging.mkdir(parents=True)
            cls(staging, config).write_config()
            staging.replace(folder)
        except OSError as error:
            raise InputError(f"cannot write the run folder {folder}: {error.strerror}") from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
        return cls(folder, config)

    @classmethod
    def open(cls, folder: Path) -> Run:
        """The run of an existing folder.

        Raises:
            InputError: If it is none, or its config does not fit.
        """
        if not (folder / "config.yaml").is_file():
            raise InputError(f"{folder} is not a run folder: it has no config.yaml")
        tree = read_yaml(folder / "config.yaml")
        try:
            return cls(folder, config_from({key: value for key, value in tree.items() if key != "versions"}))
        except (AttributeError, InputError) as error:
            raise InputError(f"{folder / 'config.yaml'} is not a run's config: {error}") from None

    def write_config(self) -> None:
        """Write the config, and the versions of what trains it."""
        text = yaml.safe_dump({**self.config.to_dict(), "versions": versions()}, sort_keys=False)
        try:
            write(self.folder / "config.yaml", text)
        except OSError as error:
            raise InputError(f"cannot write the run folder {self.folder}: {error.strerror}") from None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes from training in this folder; a process that dies holds no lock.

        Raises:
            InputError: If another process does.
        """
        try:
            with FileLock(self.folder / ".lock", timeout=0):
                yield
        except Timeout:
            raise InputError(f"another process is training in {self.folder}") from None

    def save(self, algorithm: BaseAlgorithm, place: str, **more: Any) -> Path:
        """Write a checkpoint at `place` within the folder, for example "best/policy".

        If it stands for the run now, then the evaluation of what did so before goes.

        Raises:
            InputError: If it cannot be written; what was there before stays.
        """
        path = self.folder / f"{place}{SUFFIX}"
        content = {
            "timesteps": algorithm.num_timesteps,
            "versions": versions(),
            "config": self.config.to_dict(),
            "policy": algorithm.policy.state_dict(),
            **more,
        }
        try:
            path.parent.mkdir(exist_ok=True)
            write_checkpoint(path, content)
            if path == self.policy_file:
                for file in (EVALUATION, WAYS):
                    (self.folder / file).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}") from None
        return path

    def save_training(self, algorithm: BaseAlgorithm, state: Mapping[str, Any]) -> Path:
        """Write a checkpoint that a training can go on from, see `tb2rl.resume`."""
        return self.save(algorithm, f"checkpoints/step-{algorithm.num_timesteps:010d}", training=state)

    @property
    def checkpoints(self) -> list[Path]:
        """The checkpoints of the training itself, latest first."""
        return sorted((self.folder / "checkpoints").glob(f"step-*{SUFFIX}"), reverse=True)

    def prune(self, keep: int) -> None:
        """Remove all but the last `keep` checkpoints of the training."""
        for file in self.checkpoints[keep:]:
            file.unlink(missing_ok=True)

    def note(self, file: str, entry: Mapping[str, Any]) -> None:
        """Append a line of JSON to a file of the folder."""
        with (self.folder / file).open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")

    def forget_notes(self, file: str, after: int) -> None:
        """Drop the lines of a file of the folder whose timesteps are larger than `after`."""
        path = self.folder / file
        if path.is_file():
            lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
            write(path, "".join(line for line in lines if json.loads(line)["timesteps"] <= after))

    @property
    def policy_file(self) -> Path:
        """The checkpoint that stands for the run: the best, else the final, else the latest one.

        Raises:
            InputError: If there is none yet.
        """
        places = (self.folder / place / f"policy{SUFFIX}" for place in ("best", "final"))
        for file in (*places, *self.checkpoints):
            if file.is_file():
                return file
        raise InputError(f"{self.folder} holds no checkpoint yet")


def load(reference: str | Path) -> BaseAlgorithm:
    """A trained agent, ready to `predict`; `make_env` of it gives the environment that it was trained in.

    Args:
        reference: A run folder (its best policy), a checkpoint in it, or "zoo:NAME".

    Raises:
        InputError: If it is none of these, or does not hold what it should.
    """
    file = checkpoint_file(reference)
    content = read_checkpoint(file)
    config = content_config(content, file)
    try:
        algorithm = make_algorithm(config, Spaces.vectorised(config))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    load_parameters(algorithm, {**content, "training": None}, file)
    algorithm.trained_with = config  # type: ignore[attr-defined]
    return algorithm


def content_config(content: Mapping[str, Any], file: Path) -> Config:
    """The config in a checkpoint, which says how many timesteps it has, too.

    Raises:
        InputError: If it is none, or asks for networks that the file's own arrays are too small for.
    """
    try:
        timesteps = content["timesteps"]
        if type(timesteps) is not int or timesteps < 0:
            raise InputError(f"timesteps is {timesteps!r}")
        config = config_from(content["config"])
        _check_network(config, content["policy"])
    except (*_FOREIGN, ImportError, InputError) as error:
        raise InputError(one_line(f"{file} does not hold a config that fits: {error}")) from None
    return config


def _check_network(config: Config, policy: Mapping[str, np.ndarray]) -> None:
    widths = [int(size) for size in _numbers((config.agent_settings.get("policy_kwargs") or {}).get("net_arch"))]
    largest = max((max(array.shape, default=0) for array in policy.values()), default=0)
    if len(widths) > len(policy) or max(widths, default=0) > largest:
        raise InputError("its net_arch is larger than the networks in it")


def _numbers(tree: Any) -> list[float]:
    if isinstance(tree, Mapping):
        return [number for part in tree.values() for number in _numbers(part)]
    if isinstance(tree, list | tuple):
        return [number for part in tree for number in _numbers(part)]
    return [tree] if isinstance(tree, int | float) else []


def load_parameters(algorithm: BaseAlgorithm, content: Mapping[str, Any], file: Path) -> None:
    """Put the parameters of a checkpoint into the algorithm of its config: the policy's, and optimisers' if it has any.

    Raises:
        InputError: If they do not fit.
    """
    try:
        algorithm.num_timesteps = int(content["timesteps"])
        if not all(_are_plausible(array) for array in content["policy"].values()):
            raise ValueError("its weights are no numbers that learning leads to")
        algorithm.policy.load_state_dict(_tensors(content["policy"]))
        if content.get("training"):
            optimizers = content["training"]["optimizers"]
            for name, optimizer in _optimizers(algorithm).items():
                _check_optimizer(optimizers[name], optimizer)
            algorithm.set_parameters(_tensors({"policy": content["policy"], **optimizers}), exact_match=True)
    except _FOREIGN as error:
        raise InputError(one_line(f"{file} does not fit its config: {error or type(error).__name__}")) from None


def _are_plausible(array: np.ndarray) -> bool:
    return array.dtype.kind != "f" or bool((np.abs(array) < _LARGEST).all())


def _optimizers(algorithm: BaseAlgorithm) -> dict[str, th.optim.Optimizer]:
    names = (name for name in algorithm.get_parameters() if name != "policy")
    return {name: attrgetter(name)(algorithm) for name in names}


def _check_optimizer(state: Mapping[str, Any], optimizer: th.optim.Optimizer) -> None:
    """Raise a ValueError where a state is not one of this optimiser: torch would write past an array's end."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for index, values in state["state"].items():
        for name, array in values.items():
            shape = () if name == "step" else tuple(parameters[index].shape)
            if array.shape != shape or array.dtype != np.float32 or not _are_plausible(array):
                raise ValueError(f"the optimiser's {name} has another shape or type, or no real numbers")
    for group, mine in zip(state["param_groups"], optimizer.state_dict()["param_groups"], strict=True):
        for key in mine.keys() | group.keys():
            value = tuple(group[key]) if isinstance(group[key], list) else group[key]
            present = tuple(mine[key]) if isinstance(mine[key], list) else mine[key]
            if key == "lr" and not (isinstance(value, float) and 0.0 <= value < 1e3):
                raise ValueError("the optimiser's lr is no learning rate")
            if key != "lr" and (value != present or type(value) is not type(present)):
                raise ValueError(f"the optimiser's {key} is not what the config says")


def _tensors(tree: Any) -> Any:
    """The tree with tensors for arrays, as torch wants it."""
    if isinstance(tree, np.ndarray):
        return th.from_numpy(tree)
    if isinstance(tree, Mapping):
        return {key: _tensors(value) for key, value in tree.items()}
    return [_tensors(value) for value in tree] if isinstance(tree, list) else tree


def config_of(policy: Any) -> Config:
    """What a policy from `load` or `train` was trained to do.

    Raises:
        InputError: If it is not one of these.
    """
    config = getattr(policy, "trained_with", None)
    if not isinstance(config, Config):
        raise InputError(f"{type(policy).__name__} does not come from tb2rl.load or tb2rl.train, so it has no config")
    return config


def checkpoint_file(reference: str | Path) -> Path:
    """The file that a reference to a policy means, see `load`."""
    name = str(reference)
    if name.startswith("zoo:"):
        entries = {entry.name: entry for entry in room("zoo").iterdir() if (entry / "config.yaml").is_file()}
        if name[4:] not in entries:
            raise unknown("zoo policy", name[4:], entries)
        return Run.open(entries[name[4:]]).policy_file
    path = Path(reference)
    if path.is_dir():
        return Run.open(path).policy_file
    if not path.is_file():
        raise InputError(f"there is no run folder or checkpoint {name}")
    return path


def make_algorithm(config: Config, env: VecEnv, **arguments: Any) -> BaseAlgorithm:
    """The untrained algorithm of a config.

    Raises:
        InputError: If its agent does not learn, or its settings do not fit together.
    """
    agent = find_agent(config.agent)
    if agent.algorithm is None:
        raise InputError(
            f"agent {config.agent} does not learn; try it with `python -m tb2rl.evaluate --agent {config.agent}`"
        )
    _check_device(config.train.device)
    try:
        return import_object(agent.algorithm)(
            agent.policy,
            env,
            seed=config.train.seed,
            device=config.train.device,
            **algorithm_arguments(config.agent_settings),
            **arguments,
        )
    except _FOREIGN as error:
        given = ", ".join(config.agent_settings)
        refused = f"agent {config.agent} with {config.observation} observations refuses its settings ({given}): {error}"
        raise InputError(one_line(refused)) from None


def _check_device(name: str) -> None:
    try:  # a table has no use for one, and yet it should exist
        kind = get_device(name).type
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError(one_line(f"train.device {name!r} cannot be used: {error}")) from None
    if kind not in ("cpu", "cuda", "mps"):
        raise InputError(f"train.device {name!r} cannot be used: take cpu, cuda or auto")


def make_baseline(config: Config) -> BasePolicy:
    """The policy of an agent that does not learn."""
    if find_agent(config.agent).algorithm is not None:
        raise InputError(f"agent {config.agent} learns; train it with `python -m tb2rl.train --agent {config.agent}`")
    spaces, policy = Spaces(config), import_object(find_agent(config.agent).policy)
    return policy(spaces.observation_space, spaces.action_space, **config.agent_settings)


def write(path: Path, text: str) -> None:
    """Write a text file in one step: a reader sees the old or the new one, never half of it."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def versions() -> dict[str, str]:
    """The versions of what a result depends on."""
    return {"python": platform.python_version(), **{package: _version(package) for package in _PACKAGES}}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # a checkout that is not installed
        return "unknown"


class Spaces(gym.Env):
    """The spaces of a config without a simulation behind them: all that an algorithm needs to be rebuilt."""

    def __init__(self, config: Config) -> None:
        _, task, observe, _ = prepare(config.task_settings, config.observation)
        self.observation_space = observe.space
        self.action_space = gym.spaces.Discrete(len(task.commands))

    @classmethod
    def vectorised(cls, config: Config) -> VecEnv:
        """As many of them as the config has worlds."""
        one = cls(config)
        return DummyVecEnv([partial(copy, one)] * config.train.n_envs)
