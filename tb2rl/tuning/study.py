"""The folder of a study: what is searched, every trial of it, and what it found.

    runs/tune/<name>/
        default.yaml      the settings that the search begins with, a preset
        study.yaml        what is searched, and how
        study.db          Optuna's study
        trials/<number>/  the run folders of a trial, one for each seed; judged.json: how good it is in PyBullet
        best.yaml         the best settings, a preset
        fresh/            run folders of the best and the default settings with seeds that no trial had
        report.html       the page

Processes that share a study share its folder. What they must not do at once they do under its lock, and each trial
has a lock that its process holds while it runs: one that dies holds none, so its trial is known to be lost.
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
from tb2rl.tuning.space import Space, space_from

TRIAL_SEED = 2_000_000  # of the first training of every trial, counted on from there
FRESH_SEED = 2_100_000  # of the first training afterwards
DEFAULT, PLAN, DATABASE, BEST, PAGE = "default.yaml", "study.yaml", "study.db", "best.yaml", "report.html"


@dataclass(frozen=True)
class Plan:
    """What is searched, and how; it stays the same for the whole study."""

    space: dict[str, Any]
    seeds: Annotated[int, Ge(1), Le(100)] = 2  # trainings a trial
    sampler: Literal["tpe", "random"] = "tpe"
    pruner: Literal["median", "hyperband", "none"] = "median"
    seed: Annotated[int, Ge(0), Le(2**31 - 1)] = 0  # of the sampler
    storage: str | None = None  # URL of a database; None: SQLite in the folder


@dataclass(frozen=True)
class Search:
    """The folder of a study that was begun."""

    folder: Path
    plan: Plan

    @classmethod
    def begin(cls, folder: Path, plan: Plan, default: Mapping[str, Any]) -> Search:
        """Make the folder, or go on with the study that is there.

        Args:
            folder: Of the study.
            plan: What is searched, and how.
            default: The preset that the search begins with.

        Raises:
            InputError: If the study there was begun with other settings.
        """
        folder.mkdir(parents=True, exist_ok=True)
        search = cls(folder, plan)
        trees = {DEFAULT: dict(default), PLAN: dataclasses.asdict(plan)}
        with search.lock():
            for file, tree in trees.items():
                if not (folder / file).is_file():
                    write_text(folder / file, yaml.safe_dump(tree, sort_keys=False))
                elif differing := _differing(read_yaml(folder / file), yaml.safe_load(yaml.safe_dump(tree))):
                    raise InputError(
                        f"{folder} was begun with another {', '.join(differing)}; give the same, or another --name"
                    )
        return search

    @classmethod
    def open(cls, folder: Path) -> Search:
        """The study of a folder.

        Raises:
            InputError: If there is none.
        """
        if not (folder / PLAN).is_file():
            raise InputError(f"{folder} is not the folder of a study: it has no {PLAN}")
        return cls(folder, build(Plan, read_yaml(folder / PLAN), str(folder / PLAN)))

    @cached_property
    def space(self) -> Space:
        """What is searched."""
        return space_from(self.plan.space, PLAN)

    @cached_property
    def default(self) -> Config:
        """The config that the search begins with."""
        return self.config({})

    def config(self, settings: Mapping[str, Any], seed: int = TRIAL_SEED) -> Config:
        """The config of a training with other settings, by dotted key.

        Raises:
            InputError: If they do not fit.
        """
        return resolve(preset=str(self.folder / DEFAULT), settings={**settings, "train.seed": seed})

    def settings(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The settings, by dotted key, that the parameters of a trial stand for."""
        return {key: entry.value(parameters[key]) for key, entry in self.space.items()}

    def preset(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The preset that these settings make of the default one."""
        return as_preset(preset=str(self.folder / DEFAULT), settings=settings)

    @property
    def seeds(self) -> list[int]:
        """Of the trainings of each trial."""
        return [TRIAL_SEED + i for i in range(self.plan.seeds)]

    def trial_folder(self, number: int) -> Path:
        """Where the run folders of a trial belong."""
        return self.folder / "trials" / f"{number:04d}"

    def run_folder(self, number: int, seed: int) -> Path:
        """The run folder of one training of a trial."""
        return self.trial_folder(number) / f"seed-{seed}"

    def lock(self) -> FileLock:
        """Held by the one process that may begin the study or a trial of it."""
        return FileLock(self.folder / ".lock")

    def finishing(self) -> FileLock:
        """Held by the process that judges the best trials; others wait, and find what it found."""
        return FileLock(self.folder / ".finishing")

    def trial_lock(self, number: int) -> FileLock:
        """Held by the process that runs a trial."""
        self.trial_folder(number).mkdir(parents=True, exist_ok=True)
        return FileLock(self.trial_folder(number) / ".lock", timeout=0)

    def forget(self, number: int) -> None:
        """Remove what a trial left that did not come to its end."""
        shutil.rmtree(self.trial_folder(number), ignore_errors=True)


def _differing(one: Any, other: Mapping[str, Any]) -> list[str]:
    """The dotted keys in which two trees differ, down to the second level."""
    if not isinstance(one, Mapping):
        return ["file"]
    keys = []
    for key in dict.fromkeys([*one, *other]):
        here, there = one.get(key), other.get(key)
        if here != there and isinstance(here, Mapping) and isinstance(there, Mapping):
            inner = [name for name in dict.fromkeys([*here, *there]) if here.get(name) != there.get(name)]
            keys += [f"{key}.{name}" for name in inner]
        elif here != there:
            keys.append(str(key))
    return keys
