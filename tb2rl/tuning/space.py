"""Where to search: ranges and choices for some settings, as the files of `configs/tuning` say them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Len
from optuna.distributions import (
    BaseDistribution,
    CategoricalChoiceType,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import find_file, read_yaml, top_folder
from tb2rl.core.values import build


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`; whole ones if both are."""

    low: int | float
    high: int | float
    log: bool = False  # whether their logarithms are spread evenly

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError("low must be less than high, and greater than 0 where log is true")

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that stand for all, for a check."""
        return self.low, self.high

    @property
    def distribution(self) -> BaseDistribution:
        """As Optuna has it."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return IntDistribution(self.low, self.high, log=self.log)
        return FloatDistribution(self.low, self.high, log=self.log)

    def value(self, parameter: Any) -> Any:
        """The setting that Optuna's parameter stands for."""
        return parameter

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}{', logarithmic' if self.log else ''}"


@dataclass(frozen=True)
class Choices:
    """Some values of any kind that a config takes."""

    choices: Annotated[tuple[Any, ...], Len(2, 1000)]

    def __post_init__(self) -> None:
        if len({*map(_label, self.choices)}) < len(self.choices):
            raise ValueError("the choices must differ")

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that stand for all, for a check."""
        return self.choices

    @property
    def distribution(self) -> BaseDistribution:
        """As Optuna has it."""
        return CategoricalDistribution([_label(choice) for choice in self.choices])

    def value(self, parameter: Any) -> Any:
        """The setting that Optuna's parameter stands for."""
        return next(choice for choice in self.choices if _label(choice) == parameter)

    def __str__(self) -> str:
        return ", ".join(map(str, map(_label, self.choices)))


Space = Mapping[str, Range | Choices]  # by dotted key of a config, such as "agent.gamma"


def _label(choice: Any) -> CategoricalChoiceType:
    """A choice as Optuna stores it: lists and mappings as text."""
    return choice if isinstance(choice, bool | int | float | str | None) else json.dumps(choice)


def space_from(tree: Any, where: str) -> Space:
    """The checked space of a tree as a file holds it; its keys are held against a config by `check_space`.

    Raises:
        InputError: For a key or a value that does not fit.
    """
    if not isinstance(tree, Mapping) or not tree:
        raise InputError(f"{where}: expected settings with what to search, such as agent.gamma: {{low: 0.9, high: 1}}")
    return {str(key): _entry(entry, f"{where}: {key}") for key, entry in tree.items()}


def _entry(entry: Any, where: str) -> Range | Choices:
    kind: Any = Choices if isinstance(entry, Mapping) and "choices" in entry else Range
    made: Range | Choices = build(kind, entry, where)
    return made


def find_space(name: str) -> tuple[dict[str, Any], str]:
    """The tree of a search space, and the file that it stands in.

    Args:
        name: The path of a file, or the name of one in `configs/tuning`, such as "ppo".

    Raises:
        InputError: If there is no such file, or it is not YAML.
    """
    file = find_file(name, top_folder("configs") / "tuning", "search space")
    return read_yaml(file), file.name


def check_space(space: Space, where: str, resolved: Callable[[Mapping[str, Any]], object]) -> None:
    """Try the ends of every range, and every choice.

    Args:
        space: What to search.
        where: Its file, for the message.
        resolved: Makes the config of such settings, by dotted key, or says what does not fit.

    Raises:
        InputError: If a key is not one of a config, or a value of it does not fit.
    """
    for key, entry in space.items():
        for value in entry.ends:
            try:
                resolved({key: value})
            except InputError as error:
                raise InputError(one_line(f"{where}: {key}: {error}", 600)) from None


def without_fixed(tree: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """The tree of a space without the settings that a user fixed: those, what they contain, and what contains them."""
    inside = [f"{key}." for key in fixed]
    return {
        key: entry
        for key, entry in tree.items()
        if not any(f"{key}.".startswith(other) or other.startswith(f"{key}.") for other in inside)
    }
