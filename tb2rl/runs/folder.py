"""The run folder: all files of one training.

    runs/<task>/<agent>/<name>/
        config.yaml         resolved config and versions of packages; config.json in a shared run
        checkpoints/        step-<timesteps>, the latest few: policy and training state for `--resume`
        best/policy         best policy of the evaluations while training
        final/policy        last policy
        evaluations.jsonl   one line for each evaluation while training
        evaluation.json     standard evaluation; episodes.safetensors: the paths of its episodes
        suite-unseen.json   result of a suite of worlds
        tensorboard/        event files
        tracker-*.json      state of a tracker, by its class; wandb/: offline files of Weights & Biases

Files are replaced atomically, so a folder is valid at any time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, UnwritableError, one_line
from tb2rl.core.files import read_text, read_yaml, write_text
from tb2rl.core.trust import block_imports, untrusted_source
from tb2rl.runs.checkpoint import SUFFIX, read_checkpoint, write_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.journal import read_lines
from tb2rl.runs.normalisation import statistics_of
from tb2rl.runs.versions import versions

CONFIG, SHARED = "config.yaml", "config.json"  # of a run folder, and of one that somebody shared
EVALUATIONS = "evaluations.jsonl"
EVALUATION, PATHS = "evaluation.json", f"episodes{SUFFIX}"  # of the standard evaluation
_SUITE = "suite-{}.json"


@dataclass(frozen=True)
class Run:
    """An existing run folder.

    Its methods raise an `InputError` if a file cannot be written (the old file stays), is missing or damaged.
    """

    folder: Path
    config: Config

    @classmethod
    def create(cls, folder: Path, config: Config) -> Run:
        """Create the folder with its config."""
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists already; choose another --name")
        run = cls(folder, config)
        with _writing(f"the run folder {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
        run.write_config()
        return run

    @classmethod
    def open(cls, folder: Path, trust: bool = False) -> Run:
        """The run of a folder; `trust` allows a shared config to name any module."""
        tree = read_config(folder)
        try:
            with restrict_imports(folder, trust):
                return cls(folder, config_from({key: value for key, value in tree.items() if key != "versions"}))
        except InputError as error:
            raise InputError(f"{config_file(folder)} is not a run's config: {error}") from None

    def write_config(self) -> None:
        """Write the config and the versions of packages."""
        text = yaml.safe_dump({**self.config.to_dict(), "versions": versions()}, sort_keys=False)
        with _writing(f"the run folder {self.folder}"):
            write_text(self.folder / CONFIG, text)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the folder for training; the lock of a process that dies is released.

        Raises:
            InputError: If another process holds it.
        """
        try:
            with FileLock(self.folder / ".lock", timeout=0):
                yield
        except Timeout:
            raise InputError(f"another process is training in {self.folder}") from None

    def save(self, algorithm: BaseAlgorithm, place: str, **more: Any) -> Path:
        """Write a checkpoint at `place` within the folder, for example "best/policy".

        If it becomes the policy of the run, evaluations of the previous one are removed.
        """
        path = self.folder / f"{place}{SUFFIX}"
        content = {
            "timesteps": algorithm.num_timesteps,
            "versions": versions(),
            "config": self.config.to_dict(),
            "policy": algorithm.policy.state_dict(),
            "normalisation": statistics_of(algorithm),
            **more,
        }
        with _writing(path):
            path.parent.mkdir(exist_ok=True)
            write_checkpoint(path, content)
            if path == self.policy_file:
                for file in (self.folder / EVALUATION, self.folder / PATHS, *suite_files(self.folder)):
                    file.unlink(missing_ok=True)
        return path

    def save_training(self, algorithm: BaseAlgorithm, state: Mapping[str, Any]) -> Path:
        """Write a checkpoint to resume from; `state` is the training's state without the policy."""
        return self.save(algorithm, f"checkpoints/step-{algorithm.num_timesteps:010d}", training=state)

    @property
    def checkpoints(self) -> list[Path]:
        """Checkpoints to resume from, latest first."""
        return sorted((self.folder / "checkpoints").glob(f"step-*{SUFFIX}"), reverse=True)

    def prune(self, keep: int) -> None:
        """Remove all but the latest `keep` checkpoints."""
        for file in self.checkpoints[keep:]:
            file.unlink(missing_ok=True)

    @property
    def policy_file(self) -> Path:
        """The policy of the run: the best, else the final, else the latest checkpoint."""
        places = (self.folder / place / f"policy{SUFFIX}" for place in ("best", "final"))
        for file in (*places, *self.checkpoints):
            if file.is_file():
                return file
        hint = "if its training has ended, it ended before the first: remove the folder, and train again"
        raise InputError(f"{self.folder} holds no checkpoint yet; {hint}")

    def append_evaluation(self, entry: Mapping[str, Any]) -> None:
        """Append an evaluation while training, plain values with "timesteps"."""
        with (self.folder / EVALUATIONS).open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")
            stream.flush()
            os.fsync(stream.fileno())

    def drop_evaluations(self, after: int) -> None:
        """Remove the evaluations while training at more than `after` timesteps."""
        path = self.folder / EVALUATIONS
        if path.is_file():
            kept = [json.dumps(entry) + "\n" for entry in read_lines(path) if entry["timesteps"] <= after]
            write_text(path, "".join(kept))

    def write_evaluation(self, tree: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Write the standard evaluation: plain values, and arrays or lists of arrays by name."""
        with _writing(self.folder / PATHS):
            write_checkpoint(self.folder / PATHS, arrays)
        with _writing(self.folder / EVALUATION):
            write_text(self.folder / EVALUATION, json.dumps(tree, indent=1) + "\n")

    def suite_file(self, name: str) -> Path:
        """The file for the result of a suite."""
        return self.folder / _SUITE.format(name)

    @property
    def has_evaluation(self) -> bool:
        """Whether the folder has the standard evaluation."""
        return all((self.folder / file).is_file() for file in (EVALUATION, PATHS))

    def read_evaluation(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The tree and the arrays that `write_evaluation` wrote.

        Raises:
            InputError: If there is none, or its files are damaged.
        """
        if not self.has_evaluation:
            _ = self.policy_file  # raises for a run without a policy, which cannot be evaluated
            raise InputError(f"{self.folder} has no standard evaluation: run `python -m tb2rl.evaluate {self.folder}`")
        file = self.folder / EVALUATION
        try:
            return dict(_read_json(file)), read_checkpoint(self.folder / PATHS)
        except (TypeError, ValueError) as error:
            raise InputError(one_line(f"{file} is not an evaluation: {error}")) from None


def config_file(folder: Path) -> Path:
    """The path of a run's config, whether it exists or not."""
    return folder / (SHARED if is_shared(folder) else CONFIG)


def is_shared(folder: Path) -> bool:
    """Whether a folder is a shared run, as on the hub."""
    return (folder / SHARED).is_file()


def read_config(folder: Path) -> dict[str, Any]:
    """The unchecked config of a run, with the versions of packages."""
    file = config_file(folder)
    if not file.is_file():
        raise InputError(f"{folder} is not a run folder: it has no {CONFIG}")
    tree = _read_json(file) if file.name == SHARED else read_yaml(file)
    if not isinstance(tree, dict):
        raise InputError(one_line(f"{file} is not a run's config: expected a mapping, got {tree!r}"))
    return tree


def _read_json(file: Path) -> Any:
    try:
        return json.loads(read_text(file))
    except (ValueError, RecursionError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{file} is not JSON: {error}")) from None


@contextmanager
def restrict_imports(folder: Path | None, trust: bool) -> Iterator[None]:
    """Import nothing from a run folder, nor what a shared config must not name, while its config is read.

    Args:
        folder: The run folder; None: the config is from elsewhere and unrestricted.
        trust: Whether a shared config may name any module.
    """
    with ExitStack() as limits:
        if folder is not None:
            limits.enter_context(block_imports(folder))
            if is_shared(folder) and not trust:
                limits.enter_context(untrusted_source(str(folder)))
        yield


def suite_files(folder: Path) -> list[Path]:
    """The results of suites in a run folder."""
    return sorted(folder.glob(_SUITE.format("*")))


@contextmanager
def _writing(what: object) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UnwritableError(f"cannot write {what}: {error.strerror or error}") from None
