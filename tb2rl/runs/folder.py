"""The run folder, with all files of one training, and journals, from which interrupted work continues.

    runs/<task>/<agent>/<name>/
        config.yaml         config and versions of packages; config.json in a shared run, which is published on the hub
        checkpoints/        step-<timesteps>, the latest few: policy and training state for `--resume`
        best/policy         best policy of the evaluations during training
        final/policy        last policy
        evaluations.jsonl   one line for each evaluation during training
        evaluation.json     standard evaluation, by `tb2rl.evaluate`: metrics and episodes
        episodes.safetensors  paths and actions of these episodes
        suite-<name>.json   result of a suite of worlds
        tensorboard/        event files
        tracker-*.json      state of an experiment tracker; wandb/: offline files of Weights & Biases

Files are replaced atomically, so that a folder is valid at any time. Policies and step-* end in ".safetensors".
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch as th
import yaml
from filelock import FileLock, Timeout
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core import InputError, block_imports, one_line, untrusted_source
from tb2rl.core.files import read_text, read_yaml, write_json, write_text
from tb2rl.core.values import checked
from tb2rl.runs.algorithm import statistics_of
from tb2rl.runs.checkpoint import SUFFIX, read_checkpoint, write_checkpoint
from tb2rl.runs.config import Config, config_from

CONFIG, SHARED_CONFIG = "config.yaml", "config.json"  # config of a run folder, and of a shared run folder
TRAINING_EVALUATIONS = "evaluations.jsonl"
EVALUATION, EPISODES = "evaluation.json", f"episodes{SUFFIX}"  # the standard evaluation and its episodes
_SUITE_FILE = "suite-{}.json"  # result of a suite, by the name of the suite
_PACKAGES = (
    "tb2rl", "stable-baselines3", "torch", "gymnasium", "pybullet", "mujoco-core", "numpy", "numba", "safetensors",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """An existing run folder.

    Methods raise an `InputError` if a file is missing or damaged. If a file cannot be written, they raise an OSError
    and keep the old file.
    """

    folder: Path
    config: Config

    @classmethod
    def create(cls, folder: Path, config: Config) -> Run:
        """Create the folder with its config."""
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists already; choose another --name")
        run = cls(folder, config)
        run.write_config()
        return run

    @classmethod
    def open(cls, folder: Path, trust: bool = False) -> Run:
        """Open a run folder; with `trust`, the config of a shared run may import any module outside the folder."""
        tree = read_config(folder)
        tree.pop("versions", None)
        try:
            with restrict_imports(folder, trust):
                return cls(folder, config_from(tree))
        except InputError as error:
            raise InputError(f"{config_file(folder)} is not a run's config: {error}") from None

    def write_config(self) -> None:
        """Write the config and the versions of packages."""
        text = yaml.safe_dump({**self.config.to_dict(), "versions": versions()}, sort_keys=False)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / CONFIG, text)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the folder for training; the lock is released even if the process is killed."""
        try:
            with FileLock(self.folder / ".lock", timeout=0):
                yield
        except Timeout:
            raise InputError(f"another process is training in {self.folder}") from None

    def save(self, algorithm: BaseAlgorithm, name: str, **further_content: Any) -> Path:
        """Write a checkpoint; `name` is a path in the folder without suffix, such as "best/policy".

        If the checkpoint becomes `policy_file`, results of the previous policy (evaluation, suites) are removed.
        """
        path = self.folder / f"{name}{SUFFIX}"
        content = {
            "timesteps": algorithm.num_timesteps,
            "versions": versions(),
            "config": self.config.to_dict(),
            "policy": algorithm.policy.state_dict(),
            "normalisation": statistics_of(algorithm),
            **further_content,
        }
        path.parent.mkdir(exist_ok=True)
        write_checkpoint(path, content)
        if path == self.policy_file:
            for file in (self.folder / EVALUATION, self.folder / EPISODES, *suite_files(self.folder)):
                file.unlink(missing_ok=True)
        return path

    def save_training(self, algorithm: BaseAlgorithm, state: Mapping[str, Any]) -> None:
        """Write a checkpoint to resume from, with the state of the training; remove all but the latest `train.keep`."""
        self.save(algorithm, f"checkpoints/step-{algorithm.num_timesteps:010d}", training=state)
        for file in self.checkpoints[self.config.train.keep :]:
            file.unlink(missing_ok=True)

    @property
    def checkpoints(self) -> list[Path]:
        """Checkpoints to resume from, latest first."""
        return sorted((self.folder / "checkpoints").glob(f"step-*{SUFFIX}"), reverse=True)

    @property
    def policy_file(self) -> Path:
        """The policy of the run: the best, else the final, else the latest checkpoint."""
        policies = (self.folder / name / f"policy{SUFFIX}" for name in ("best", "final"))
        for file in (*policies, *self.checkpoints):
            if file.is_file():
                return file
        hint = "wait for its training, or remove the folder and train again"
        raise InputError(f"{self.folder} has no policy yet; {hint}")

    def append_training_evaluation(self, entry: Mapping[str, Any]) -> None:
        """Append an evaluation made during training: plain values by key, including "timesteps"."""
        append_line(self.folder / TRAINING_EVALUATIONS, entry)

    def drop_training_evaluations(self, after: int) -> None:
        """Remove the evaluations later than timestep `after`."""
        path = self.folder / TRAINING_EVALUATIONS
        if path.is_file():
            kept = [json.dumps(entry) + "\n" for entry in read_lines(path) if entry["timesteps"] <= after]
            write_text(path, "".join(kept))

    def write_evaluation(self, tree: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Write the standard evaluation: plain values by key, and arrays or lists of arrays by key."""
        write_checkpoint(self.folder / EPISODES, arrays)
        write_json(self.folder / EVALUATION, tree)

    def suite_file(self, name: str) -> Path:
        """The path for the result of a suite."""
        return self.folder / _SUITE_FILE.format(name)

    @property
    def has_evaluation_episodes(self) -> bool:
        """Whether the folder has the standard evaluation."""
        return all((self.folder / file).is_file() for file in (EVALUATION, EPISODES))

    def read_evaluation(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read the tree and the arrays of the standard evaluation."""
        if not self.has_evaluation_episodes:
            _ = self.policy_file  # raises another error if there is no policy to evaluate
            raise InputError(f"{self.folder} has no standard evaluation: run `python -m tb2rl.evaluate {self.folder}`")
        return self.read_evaluation_tree(), read_checkpoint(self.folder / EPISODES)

    def read_evaluation_tree(self) -> dict[str, Any]:
        """Read the tree of the standard evaluation, which exists without arrays in the zoo; {} if there is none."""
        file = self.folder / EVALUATION
        return _read_json(file) if file.is_file() else {}


def config_file(folder: Path) -> Path:
    """The path of a run's config, which may be missing."""
    return folder / (SHARED_CONFIG if is_shared(folder) else CONFIG)


def is_shared(folder: Path) -> bool:
    """Whether a folder is a shared run (published on the hub, or downloaded from it), which has a "config.json"."""
    return (folder / SHARED_CONFIG).is_file()


def read_config(folder: Path) -> dict[str, Any]:
    """Read the tree of a run's config, with the versions of packages; checks only that it is a mapping."""
    file = config_file(folder)
    if not file.is_file():
        raise InputError(f"{folder} is not a run folder: it has no {CONFIG}")
    return checked(dict[str, Any], _read_json(file) if file.name == SHARED_CONFIG else read_yaml(file), str(file))


def _read_json(file: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(read_text(file)))
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(one_line(f"{file} is not a JSON object: {error}")) from None


@contextmanager
def restrict_imports(folder: Path | None, trust: bool) -> Iterator[None]:
    """Block imports of modules in a run folder; without `trust`, a shared config can import only known packages.

    If `folder` is None, all imports are allowed.
    """
    blocking = block_imports(folder) if folder else nullcontext()
    is_untrusted = folder and is_shared(folder) and not trust
    with blocking, untrusted_source(str(folder)) if is_untrusted else nullcontext():
        yield


def suite_files(folder: Path) -> list[Path]:
    """The existing results of suites in a run folder."""
    return sorted(folder.glob(_SUITE_FILE.format("*")))


def versions() -> dict[str, str]:
    """Versions of Python and of packages."""
    packages = {package: _version(package) for package in _PACKAGES}
    # The metadata of torch may lack the suffix of its build, such as "+cpu".
    return {"python": platform.python_version(), **packages, "torch": str(th.__version__)}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


class Journal:
    """A file of JSON lines: a description of the work, then its results.

    Args:
        path: Path of the file; None: no file.
        work: Description of the work, as plain values; results of other work are discarded.

    Attributes:
        entries: Results of an earlier process, as plain values.
        mismatch: First key of `work` whose value differs in the file, or the word "kind" if all are equal, but the file
            has more keys; for messages such as "from another config". None: no difference, or no file.
    """

    def __init__(self, path: Path | None, work: Mapping[str, Any]) -> None:
        self.path, self.entries, self.mismatch = path, list[Any](), None
        if path is None:
            return
        work = json.loads(json.dumps(work))
        earlier_work, *entries = (read_lines(path) if path.is_file() else []) or [work]
        if earlier_work == work:
            self.entries = entries
        else:
            self.mismatch = next((key for key in work if earlier_work.get(key) != work[key]), "kind")
        write_text(path, "".join(json.dumps(line) + "\n" for line in (work, *self.entries)))

    def append(self, entry: Any) -> None:
        """Append a result, which is kept even if this process is killed afterwards."""
        if self.path is not None:
            append_line(self.path, entry)

    def remove(self) -> None:
        """Remove the file of finished work."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def append_line(path: Path, entry: Any) -> None:
    """Append a line of JSON to a file, and wait until the disk has stored it."""
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")
        stream.flush()
        os.fsync(stream.fileno())


def read_lines(path: Path) -> list[Any]:
    """Read a file of JSON lines; ignore an incomplete last line and zero bytes, which a crash can leave."""
    *lines, last_line = path.read_bytes().split(b"\n")
    try:
        entries = [json.loads(line) for line in lines if line.strip(b"\0 \t\r")]
    except (ValueError, RecursionError) as error:
        raise InputError(one_line(f"{path} is damaged: a line is not JSON: {error}")) from None
    with suppress(ValueError, RecursionError):
        entries.append(json.loads(last_line))
    return entries
