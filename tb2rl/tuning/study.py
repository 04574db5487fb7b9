"""The folder of a study.

    runs/tune/<name>/
        default.yaml      the settings that the search begins with, a preset
        study.yaml        the search space and the options of the study
        study.db          Optuna's study
        trials/<number>/  the run folders of a trial, one for each seed; evaluation.json: its policies in PyBullet
        best.yaml         the best settings, a preset
        fresh/            run folders of the best and the default settings with seeds that no trial had
        report.html       the page

Processes that share a study share its folder.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from annotated_types import Ge, Le
from filelock import FileLock

from tb2rl.core.errors import InputError
from tb2rl.core.files import read_yaml, write_text
from tb2rl.core.values import build
from tb2rl.runs.config import Config
from tb2rl.runs.layers import as_preset, resolve
from tb2rl.tuning.space import Space, parse_space

TRIAL_SEED = 2_000_000  # first training seed of every trial
FRESH_SEED = 2_100_000  # first training seed of the comparison
DEFAULT, OPTIONS, DATABASE, BEST, PAGE = "default.yaml", "study.yaml", "study.db", "best.yaml", "report.html"


@dataclass(frozen=True)
class StudyOptions:
    """The options of a study; they never change."""

    space: dict[str, Any]
    seeds: Annotated[int, Ge(1), Le(100)] = 2  # trainings of a trial
    sampler: Literal["tpe", "random"] = "tpe"
    pruner: Literal["median", "hyperband", "none"] = "median"
    seed: Annotated[int, Ge(0), Le(2**31 - 1)] = 0  # of the sampler
    storage: str | None = None  # URL of a database; None: SQLite in the folder


@dataclass(frozen=True)
class StudyFolder:
    """The folder of a study."""

    path: Path
    options: StudyOptions

    @classmethod
    def create(cls, path: Path, options: StudyOptions, default: Mapping[str, Any]) -> StudyFolder:
        """Create the folder, or open it if it has the same options and default preset.

        Raises:
            InputError: If they differ.
        """
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path, options)
        trees = {DEFAULT: dict(default), OPTIONS: dataclasses.asdict(options)}
        with folder.lock():
            for name, tree in trees.items():
                text = yaml.safe_dump(tree, sort_keys=False)
                if not (path / name).is_file():
                    write_text(path / name, text)
                elif differing := _differing_keys(read_yaml(path / name), yaml.safe_load(text)):
                    raise InputError(
                        f"{path} was begun with another {', '.join(differing)}; give the same, or another --name"
                    )
        return folder

    @classmethod
    def open(cls, path: Path) -> StudyFolder:
        """Open an existing folder.

        Raises:
            InputError: If it is none of a study.
        """
        if not (path / OPTIONS).is_file():
            raise InputError(f"{path} is not the folder of a study: it has no {OPTIONS}")
        return cls(path, build(StudyOptions, read_yaml(path / OPTIONS), str(path / OPTIONS)))

    @cached_property
    def space(self) -> Space:
        """The search space."""
        return parse_space(self.options.space, OPTIONS)

    @cached_property
    def default(self) -> Config:
        """The config that the search begins with."""
        return self.config({})

    def config(self, settings: Mapping[str, Any], seed: int = TRIAL_SEED) -> Config:
        """The config of a training with other settings, by dotted key.

        Raises:
            InputError: If a setting does not fit.
        """
        return resolve(preset=str(self.path / DEFAULT), settings={**settings, "train.seed": seed})

    def settings(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of a trial's parameters, by dotted key."""
        return {key: entry.decode(params[key]) for key, entry in self.space.items()}

    def preset(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The default preset with other settings."""
        return as_preset(preset=str(self.path / DEFAULT), settings=settings)

    @property
    def seeds(self) -> list[int]:
        """Training seeds of each trial."""
        return [TRIAL_SEED + i for i in range(self.options.seeds)]

    def trial_folder(self, number: int) -> Path:
        """The folder of a finished trial."""
        return self.path / "trials" / f"{number:04d}"

    def staging_folder(self, number: int) -> Path:
        """The folder of a trial while it runs."""
        return self.path / "trials" / f".{number:04d}"

    def run_folder(self, number: int, seed: int) -> Path:
        """The run folder of one training of a trial."""
        return self.trial_folder(number) / f"seed-{seed}"

    def remove_trial(self, number: int) -> None:
        """Remove the files of a trial that was pruned or failed."""
        for folder in (self.trial_folder(number), self.staging_folder(number)):
            shutil.rmtree(folder, ignore_errors=True)

    def lock(self) -> FileLock:
        """Held by the process that creates the study or asks for a trial."""
        return FileLock(self.path / ".lock")

    def selection_lock(self) -> FileLock:
        """Held by the process that evaluates the best trials; others wait, and find its results."""
        return FileLock(self.path / ".selection")


def _differing_keys(one: Any, other: Mapping[str, Any]) -> list[str]:
    """The dotted keys in which two trees differ, down to the second level."""
    if not isinstance(one, Mapping):
        return ["file"]
    keys = []
    for key in dict.fromkeys([*one, *other]):
        here, there = one.get(key), other.get(key)
        if here != there and isinstance(here, Mapping) and isinstance(there, Mapping):
            keys += [f"{key}.{name}" for name in dict.fromkeys([*here, *there]) if here.get(name) != there.get(name)]
        elif here != there:
            keys.append(str(key))
    return keys
