"""Search spaces, options and the folder of a study.

    runs/tune/<name>/
        default.yaml      preset that all trials override: agent, task, the user's preset and the fixed settings
        study.yaml        search space and options of the study
        study.db          Optuna's database
        trials/<number>/  run folder of each seed; evaluation.json: all seeds in physics, for the best trials
        best.yaml         preset with the best settings
        fresh/            run folders of trainings with fresh seeds, with the best and with the default settings
        report.html       report page

Several processes can run trials of the same study in the same folder.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from annotated_types import Ge, Le, Len
from filelock import FileLock
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from tb2rl.core import InputError, find_file, one_line, read_yaml, top_folder, write_text
from tb2rl.core.values import build
from tb2rl.runs import Config, as_preset, flatten, resolve

TRIAL_SEED = 2_000_000  # first training seed of every trial
FRESH_SEED = 2_100_000  # first training seed of the comparison of best and default settings
DEFAULT, OPTIONS, DATABASE, BEST, PAGE = "default.yaml", "study.yaml", "study.db", "best.yaml", "report.html"


@dataclass(frozen=True)
class Range:
    """A part of a search space: numbers from `low` to `high`, which are integers if both limits are integers."""

    low: int | float
    high: int | float
    log: bool = False  # sample logarithms uniformly

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError("low must be less than high, and greater than 0 if log is true")

    @property
    def distribution(self) -> BaseDistribution:
        if isinstance(self.low, int) and isinstance(self.high, int):
            return IntDistribution(self.low, self.high, log=self.log)
        return FloatDistribution(self.low, self.high, log=self.log)

    def decode(self, param: Any) -> Any:
        """Convert the value of Optuna's parameter to a setting."""
        return param

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}{', logarithmic' if self.log else ''}"


@dataclass(frozen=True)
class Choices:
    """Alternative values of any type."""

    choices: Annotated[tuple[Any, ...], Len(2, 1000)]

    def __post_init__(self) -> None:
        if len(self._by_param) < len(self.choices):
            raise ValueError("the choices must differ")

    @property
    def _by_param(self) -> dict[bool | int | float | str | None, Any]:
        """The choices by the value of Optuna's parameter, which is JSON for lists and mappings."""
        plain_types = bool | int | float | str | None
        return {choice if isinstance(choice, plain_types) else json.dumps(choice): choice for choice in self.choices}

    @property
    def distribution(self) -> CategoricalDistribution:
        return CategoricalDistribution(list(self._by_param))

    def decode(self, param: Any) -> Any:
        """Convert the value of Optuna's parameter to a setting."""
        return self._by_param[param]

    def __str__(self) -> str:
        return ", ".join(map(str, self._by_param))


Space = Mapping[str, Range | Choices]  # entries by dotted key of a setting, such as "agent.gamma"


def parse_space(tree: Any, source: str) -> Space:
    """Parse a search space.

    Args:
        tree: Content of a file.
        source: Name of the file, for messages.

    Raises:
        InputError: If an entry is invalid.
    """
    if not isinstance(tree, Mapping) or not tree:
        raise InputError(f"{source}: expected settings to search, such as agent.gamma: {{low: 0.9, high: 1}}")
    space: dict[str, Range | Choices] = {}
    for key, entry in tree.items():
        entry_type: Any = Choices if isinstance(entry, Mapping) and "choices" in entry else Range
        space[str(key)] = build(entry_type, entry, f"{source}: {key}")
    return space


def read_space(name: str, fixed: Mapping[str, Any], check: Callable[[Mapping[str, Any]], object]) -> dict[str, Any]:
    """Read the file of a search space, and check every choice and the limits of every range.

    Args:
        name: Name of a file in `configs/tuning`, such as "ppo", or a path.
        fixed: Fixed settings by dotted key; these settings, their parts and their parents are not searched.
        check: Function that checks settings by dotted key, and raises an `InputError` if they are invalid.

    Returns:
        The content of the file, without the fixed settings.

    Raises:
        InputError: If the file is missing, or a key or a value is invalid.
    """
    file = find_file(name, top_folder("configs") / "tuning", "search space")
    tree = read_yaml(file)
    if isinstance(tree, Mapping):
        tree = {key: entry for key, entry in tree.items() if not any(_overlap(key, other) for other in fixed)}
    for key, entry in parse_space(tree, file.name).items():
        for value in entry.choices if isinstance(entry, Choices) else (entry.low, entry.high):
            try:
                check({key: value})
            except InputError as error:
                raise InputError(one_line(f"{file.name}: {key}: {error}", 600)) from None
    return tree


def _overlap(key: str, other: str) -> bool:
    """Whether two dotted keys are equal, or one is a prefix of the other."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


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
        return parse_space(self.options.space, OPTIONS)

    @cached_property
    def default(self) -> Config:
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
        return self.path / "trials" / f"{number:04d}"

    def remove_files(self, number: int) -> None:
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
