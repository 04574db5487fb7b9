"""The folder of a study.

    runs/tune/<name>/
        default.yaml      preset with the settings that are not searched, and the default values of the others
        study.yaml        search space and options of the study
        study.db          Optuna's database
        trials/<number>/  run folder of each seed of a trial; evaluation.json: evaluation of its policies in PyBullet
        best.yaml         preset with the best settings
        fresh/            run folders of trainings with fresh seeds, with the best and with the default settings
        report.html       report page

Several processes can run trials of the same study in the same folder.
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

from tb2rl.core import InputError, read_yaml, write_text
from tb2rl.runs import Config, as_preset, flatten, resolve
from tb2rl.tuning.space import Space, parse_space

TRIAL_SEED = 2_000_000  # first training seed of every trial
FRESH_SEED = 2_100_000  # first training seed of the comparison
DEFAULT, OPTIONS, DATABASE, BEST, PAGE = "default.yaml", "study.yaml", "study.db", "best.yaml", "report.html"


@dataclass(frozen=True)
class StudyOptions:
    """The options of a study, which cannot change after its creation."""

    space: dict[str, Any]  # see `parse_space`
    seeds: Annotated[int, Ge(1), Le(100)] = 2  # number of trainings per trial
    sampler: Literal["tpe", "random"] = "tpe"
    pruner: Literal["median", "hyperband", "none"] = "median"
    seed: Annotated[int, Ge(0), Le(2**31 - 1)] = 0  # seed of the sampler
    storage: str | None = None  # URL of the database; None: SQLite in the folder


@dataclass(frozen=True)
class StudyFolder:
    """The folder of a study."""

    path: Path
    options: StudyOptions

    @classmethod
    def create(cls, path: Path, options: StudyOptions, default: Mapping[str, Any]) -> StudyFolder:
        """Create the folder, or open an existing folder with the same options and default preset.

        Raises:
            InputError: If the options or the default preset of the existing folder differ.
        """
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path, options)
        with folder.lock():
            for name, tree in {DEFAULT: default, OPTIONS: dataclasses.asdict(options)}.items():
                text = yaml.safe_dump(dict(tree), sort_keys=False)
                if not (path / name).is_file():
                    write_text(path / name, text)
                elif differing := _differing_keys(read_yaml(path / name), yaml.safe_load(text)):
                    hint = "use the same value, or choose another --name"
                    raise InputError(f"{path} was created with another {', '.join(differing)}; {hint}")
        return folder

    @cached_property
    def space(self) -> Space:
        """The search space."""
        return parse_space(self.options.space, OPTIONS)

    @cached_property
    def default(self) -> Config:
        """The config with the default settings."""
        return self.config({})

    @property
    def num_evaluations(self) -> int:
        """Number of evaluations during a training with the default settings."""
        settings = self.default.train
        return -(-settings.total_timesteps // settings.eval_freq) if settings.eval_freq else 0

    def config(self, settings: Mapping[str, Any], seed: int = TRIAL_SEED) -> Config:
        """Make the config of a training; `settings` by dotted key override the default ones.

        Raises:
            InputError: If a setting is invalid.
        """
        return resolve(preset=str(self.path / DEFAULT), settings={**settings, "train.seed": seed})

    def settings(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Convert the parameters of a trial to settings by dotted key."""
        return {key: entry.decode(params[key]) for key, entry in self.space.items()}

    def preset(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Make a preset; `settings` by dotted key override the default ones."""
        return as_preset(preset=str(self.path / DEFAULT), settings=settings)

    @property
    def seeds(self) -> list[int]:
        """Training seeds of each trial."""
        return [TRIAL_SEED + i for i in range(self.options.seeds)]

    def trial_folder(self, number: int) -> Path:
        """The folder of a trial."""
        return self.path / "trials" / f"{number:04d}"

    def remove_trial(self, number: int) -> None:
        """Remove the files of a trial that was pruned or failed."""
        shutil.rmtree(self.trial_folder(number), ignore_errors=True)

    def lock(self) -> FileLock:
        """A lock for creating the study and for asking for trials."""
        return FileLock(self.path / ".lock")

    def selection_lock(self) -> FileLock:
        """A lock for evaluating the best trials; processes that wait for it then read the results."""
        return FileLock(self.path / ".selection")


def _differing_keys(old: Any, new: Mapping[str, Any]) -> list[str]:
    """The dotted keys whose values differ in two trees."""
    old_leaves, new_leaves = flatten(old if isinstance(old, Mapping) else {}), flatten(new)
    keys = {**old_leaves, **new_leaves}
    return [key for key in keys if key not in old_leaves or key not in new_leaves or old_leaves[key] != new_leaves[key]]
