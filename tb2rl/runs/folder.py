"""The run folder: everything about one training.

    runs/<task>/<agent>/<name>/
        config.yaml         the resolved config, and the versions of what trained it; config.json, if it was shared
        checkpoints/        step-<timesteps>, the last few: policy, and all that `--resume` needs
        best/policy         the best in an evaluation while training
        final/policy        the last
        evaluations.jsonl   a line for each evaluation while training
        evaluation.json     the standard evaluation; episodes.safetensors: where each of its episodes went
        suite-unseen.json   what it did in a suite of worlds
        tensorboard/        event files
        tracker-*.json      what a tracker remembers, by its class; wandb/: what Weights & Biases has offline

Files are written beside and renamed, so a folder is valid at every instant.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, UnwritableError, one_line
from tb2rl.core.files import read_text, read_yaml, write_text
from tb2rl.core.trust import distrusting, nothing_from
from tb2rl.runs.checkpoint import SUFFIX, read_checkpoint, write_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.journal import read_lines
from tb2rl.runs.normalisation import statistics_of
from tb2rl.runs.versions import versions

CONFIG, SHARED = "config.yaml", "config.json"  # the second is that of a run folder which somebody shared
EVALUATIONS = "evaluations.jsonl"
EVALUATION, PATHS = "evaluation.json", f"episodes{SUFFIX}"  # files of the standard evaluation
_SUITE = "suite-{}.json"


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
            if folder.exists():
                folder.rmdir()  # it is empty; Windows replaces no folder
            staging.replace(folder)
        except OSError as error:
            raise UnwritableError(f"cannot write the run folder {folder}: {error.strerror}") from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
        return cls(folder, config)

    @classmethod
    def open(cls, folder: Path, trust: bool = False) -> Run:
        """The run of an existing folder.

        Args:
            folder: The folder.
            trust: Whether to import whatever the config names, if somebody shared it.

        Raises:
            InputError: If it is not a run folder, or its config does not fit.
        """
        tree = read_config(folder)
        try:
            with imports_limited(folder, trust):
                return cls(folder, config_from({key: value for key, value in tree.items() if key != "versions"}))
        except InputError as error:
            raise InputError(f"{config_file(folder)} is not a run's config: {error}") from None

    def write_config(self) -> None:
        """Write the config, and the versions of what trains it.

        Raises:
            InputError: If it cannot be written; what was there before stays.
        """
        text = yaml.safe_dump({**self.config.to_dict(), "versions": versions()}, sort_keys=False)
        with _writing(f"the run folder {self.folder}"):
            write_text(self.folder / CONFIG, text)

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

    # ---- checkpoints

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
        """Write a checkpoint that a training can go on from; `state` is all that the policy is not."""
        return self.save(algorithm, f"checkpoints/step-{algorithm.num_timesteps:010d}", training=state)

    @property
    def checkpoints(self) -> list[Path]:
        """The checkpoints of the training itself, latest first."""
        return sorted((self.folder / "checkpoints").glob(f"step-*{SUFFIX}"), reverse=True)

    def prune(self, keep: int) -> None:
        """Remove all but the last `keep` checkpoints of the training."""
        for file in self.checkpoints[keep:]:
            file.unlink(missing_ok=True)

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
        stopped = "if its training has ended, it ended before the first: remove the folder, and train again"
        raise InputError(f"{self.folder} holds no checkpoint yet; {stopped}")

    # ---- evaluations, as plain values

    def note_evaluation(self, entry: Mapping[str, Any]) -> None:
        """Append an evaluation while training, which says its "timesteps"."""
        with (self.folder / EVALUATIONS).open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")
            stream.flush()
            os.fsync(stream.fileno())

    def forget_evaluations(self, after: int) -> None:
        """Drop the evaluations while training at more than `after` timesteps.

        Raises:
            InputError: If the file with them is damaged elsewhere than at its end.
        """
        path = self.folder / EVALUATIONS
        if path.is_file():
            try:
                kept = [json.dumps(entry) + "\n" for entry in read_lines(path) if entry["timesteps"] <= after]
            except (LookupError, TypeError):
                raise InputError(f"{path} is damaged: a line has no timesteps") from None
            write_text(path, "".join(kept))

    def write_evaluation(self, tree: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Put the standard evaluation into the folder.

        Args:
            tree: Plain values, for `evaluation.json`.
            arrays: By name, or lists of them, for the file beside it.

        Raises:
            InputError: If it cannot be written.
        """
        with _writing(self.folder / PATHS):
            write_checkpoint(self.folder / PATHS, arrays)
        with _writing(self.folder / EVALUATION):
            write_text(self.folder / EVALUATION, json.dumps(tree, indent=1) + "\n")

    def suite_file(self, name: str) -> Path:
        """Where the result of a suite with this name belongs."""
        return self.folder / _SUITE.format(name)

    @property
    def has_evaluation(self) -> bool:
        """Whether the standard evaluation is in the folder."""
        return all((self.folder / file).is_file() for file in (EVALUATION, PATHS))

    def read_evaluation(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The tree and the arrays that `write_evaluation` wrote.

        Raises:
            InputError: If there is none, or its files are damaged.
        """
        if not self.has_evaluation:
            _ = self.policy_file  # a run without a policy cannot be evaluated, and says so
            raise InputError(f"{self.folder} has no standard evaluation: run `python -m tb2rl.evaluate {self.folder}`")
        file = self.folder / EVALUATION
        try:
            return dict(_read_json(file)), read_checkpoint(self.folder / PATHS)
        except (TypeError, ValueError) as error:
            raise InputError(one_line(f"{file} is not an evaluation: {error}")) from None


def config_file(folder: Path) -> Path:
    """The file with the config of a run, whether it is there or not."""
    return folder / (SHARED if is_shared(folder) else CONFIG)


def is_shared(folder: Path) -> bool:
    """Whether a folder is a run that somebody shared, as on the hub."""
    return (folder / SHARED).is_file()


def read_config(folder: Path) -> dict[str, Any]:
    """The config of a run and the versions of what trained it, plain values that nobody has checked.

    Raises:
        InputError: If it is not a run folder.
    """
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
def imports_limited(folder: Path | None, trust: bool) -> Iterator[None]:
    """Read the config of a run: nothing in its folder is imported, nor what a stranger names, see `tb2rl.core.trust`.

    Args:
        folder: Of the run; None: a config from elsewhere, which has no such limits.
        trust: Whether to import what a stranger names.
    """
    limited = folder is not None and is_shared(folder) and not trust
    with nothing_from(folder) if folder else nullcontext(), distrusting(str(folder)) if limited else nullcontext():
        yield


def suite_files(folder: Path) -> list[Path]:
    """The results of suites that a run folder keeps."""
    return sorted(folder.glob(_SUITE.format("*")))


@contextmanager
def _writing(what: object) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UnwritableError(f"cannot write {what}: {error.strerror or error}") from None
