"""Search spaces: ranges and choices of settings, as in the files of `configs/tuning`."""

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
    """Numbers from `low` to `high`; integers if both are."""

    low: int | float
    high: int | float
    log: bool = False  # sample logarithms uniformly

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError("low must be less than high, and greater than 0 where log is true")

    @property
    def extremes(self) -> tuple[Any, ...]:
        """The values to check."""
        return self.low, self.high

    @property
    def distribution(self) -> BaseDistribution:
        """Optuna's distribution."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return IntDistribution(self.low, self.high, log=self.log)
        return FloatDistribution(self.low, self.high, log=self.log)

    def decode(self, param: Any) -> Any:
        """The setting of Optuna's parameter."""
        return param

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}{', logarithmic' if self.log else ''}"


@dataclass(frozen=True)
class Choices:
    """Alternative values of any type."""

    choices: Annotated[tuple[Any, ...], Len(2, 1000)]

    def __post_init__(self) -> None:
        if len({*map(_encode, self.choices)}) < len(self.choices):
            raise ValueError("the choices must differ")

    @property
    def extremes(self) -> tuple[Any, ...]:
        """The values to check."""
        return self.choices

    @property
    def distribution(self) -> BaseDistribution:
        """Optuna's distribution."""
        return CategoricalDistribution([_encode(choice) for choice in self.choices])

    def decode(self, param: Any) -> Any:
        """The setting of Optuna's parameter."""
        return next(choice for choice in self.choices if _encode(choice) == param)

    def __str__(self) -> str:
        return ", ".join(map(str, map(_encode, self.choices)))


Space = Mapping[str, Range | Choices]  # by dotted key of a config, such as "agent.gamma"


def _encode(choice: Any) -> CategoricalChoiceType:
    """A choice that Optuna can store: lists and mappings as JSON."""
    return choice if isinstance(choice, bool | int | float | str | None) else json.dumps(choice)


def parse_space(tree: Any, source: str) -> Space:
    """Parse a search space; `check_space` compares its keys with a config.

    Args:
        tree: Content of a file.
        source: The file, for the message.

    Raises:
        InputError: If an entry does not fit.
    """
    if not isinstance(tree, Mapping) or not tree:
        raise InputError(f"{source}: expected settings to search, such as agent.gamma: {{low: 0.9, high: 1}}")
    space: dict[str, Range | Choices] = {}
    for key, entry in tree.items():
        kind: Any = Choices if isinstance(entry, Mapping) and "choices" in entry else Range
        space[str(key)] = build(kind, entry, f"{source}: {key}")
    return space


def find_space(name: str) -> tuple[dict[str, Any], str]:
    """Content and name of a search space's file.

    Args:
        name: A path, or the name of a file in `configs/tuning`, such as "ppo".

    Raises:
        InputError: If there is no such file, or it is not YAML.
    """
    file = find_file(name, top_folder("configs") / "tuning", "search space")
    return read_yaml(file), file.name


def check_space(space: Space, source: str, resolve: Callable[[Mapping[str, Any]], object]) -> None:
    """Check the ends of every range, and every choice.

    Args:
        space: The search space.
        source: Its file, for the message.
        resolve: Makes a config of settings by dotted key, or raises an `InputError`.

    Raises:
        InputError: If a config has no such key, or refuses a value.
    """
    for key, entry in space.items():
        for value in entry.extremes:
            try:
                resolve({key: value})
            except InputError as error:
                raise InputError(one_line(f"{source}: {key}: {error}", 600)) from None


def without_fixed(tree: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """A search space without fixed settings: these keys, and the keys inside and around them."""
    prefixes = [f"{key}." for key in fixed]
    return {
        key: entry
        for key, entry in tree.items()
        if not any(f"{key}.".startswith(prefix) or prefix.startswith(f"{key}.") for prefix in prefixes)
    }
