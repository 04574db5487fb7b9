"""Worlds from a generator's settings: the same ones in every process, independent of other random draws.

The random numbers of a world follow from its purpose, the generator's seed, and its number. So the worlds of training,
validation, test, hyperparameter search and suites never coincide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.errors import InputError
from tb2rl.core.values import ASCENDING, MOST_WORLDS, PAIR, Fraction
from tb2rl.worlds.generators.enclosure import Size
from tb2rl.worlds.world import World

Purpose = Literal["training", "validation", "test", "suite", "search"]
_KEYS: dict[Purpose, int] = {"training": 0, "validation": 1, "test": 2, "suite": 3, "search": 4}
WorldMaker = Callable[[np.random.Generator, float, Size], World]
Side = Annotated[float, Ge(4), Le(100)]


@dataclass(frozen=True)
class GeneratorSettings:
    """A generator and its settings, as `task.world` takes them."""

    generator: str  # a name, or "module:function"
    worlds: Annotated[int, Ge(1), Le(MOST_WORLDS)] = 512  # for each purpose
    difficulty: Annotated[tuple[Fraction, Fraction], PAIR, ASCENDING] = (0.0, 1.0)  # of all, or a range to draw from
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    size: tuple[Side, Side] = (8.0, 8.0)  # [m] of the floor


def generate(settings: GeneratorSettings, makers: Sequence[WorldMaker], purpose: Purpose) -> tuple[World, ...]:
    """Make the worlds of some settings, by the makers in turns, named by their maker, number and purpose.

    Raises:
        InputError: If one cannot be made.
    """
    made = []
    for number in range(settings.worlds):
        maker, rng = makers[number % len(makers)], world_rng(purpose, settings.seed, number)
        world = maker(rng, rng.uniform(*settings.difficulty), settings.size)
        if not isinstance(world, World):
            raise InputError(f"generator {settings.generator} made no tb2rl.worlds.World but {type(world).__name__}")
        made.append(replace(world, name=f"{maker.__name__} {number} ({purpose})"))
    return tuple(made)


def world_rng(purpose: Purpose, seed: int, number: int) -> np.random.Generator:
    """The random number generator of one world."""
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(_KEYS[purpose], seed, number)))
