"""Search spaces: ranges and choices of settings, such as those in `configs/tuning`."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Len
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from tb2rl.core import InputError, find_file, one_line, read_yaml, top_folder
from tb2rl.core.values import build


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`, which are integers if both limits are integers."""

    low: int | float
    high: int | float
    log: bool = False  # sample logarithms uniformly

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError("low must be less than high, and greater than 0 if log is true")

    @property
    def distribution(self) -> BaseDistribution:
        """Optuna's distribution."""
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
        """The choices by Optuna's parameter, which is JSON for lists and mappings."""
        plain_types = bool | int | float | str | None
        return {choice if isinstance(choice, plain_types) else json.dumps(choice): choice for choice in self.choices}

    @property
    def distribution(self) -> BaseDistribution:
        """Optuna's distribution."""
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


def read_space(name: str, fixed: Mapping[str, Any], resolve: Callable[[Mapping[str, Any]], object]) -> dict[str, Any]:
    """Read the file of a search space, and check every choice and the limits of every range.

    Args:
        name: Name of a file in `configs/tuning`, such as "ppo", or a path.
        fixed: Fixed settings by dotted key; these settings, their parts and their parents are not searched.
        resolve: Function that checks settings by dotted key, and raises an `InputError` if they are invalid.

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
                resolve({key: value})
            except InputError as error:
                raise InputError(one_line(f"{file.name}: {key}: {error}", 600)) from None
    return tree


def _overlap(key: str, other: str) -> bool:
    """Whether two dotted keys are equal, or one is a prefix of the other."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")
