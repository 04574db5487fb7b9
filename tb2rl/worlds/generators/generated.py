"""Worlds from a generator's settings: the same ones in every process, whatever else was drawn before.

A world's random numbers follow from what it is for, the generator's seed, and its number: so worlds to train in, to
choose the best policy in and to judge it in never share any, nor do those that settings are searched in, and no suite
shares them (`tb2rl.worlds.suites`).
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

# Training; which of its policies is best; how good that one is; what all policies are compared by; which settings are
# best.
Purpose = Literal["training", "validation", "test", "suite", "search"]
_KEYS: dict[Purpose, int] = {"training": 0, "validation": 1, "test": 2, "suite": 3, "search": 4}
Maker = Callable[[np.random.Generator, float, Size], World]


Span = Annotated[tuple[Fraction, Fraction], PAIR, ASCENDING]
Side = Annotated[float, Ge(4), Le(100)]


@dataclass(frozen=True)
class Generated:
    """A generator and its settings, as `task.world` takes them."""

    generator: str  # a name, or "module:function"
    worlds: Annotated[int, Ge(1), Le(MOST_WORLDS)] = 512  # for each purpose
    difficulty: Span = (0.0, 1.0)  # from 0 to 1, or a range that each world's is drawn from
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    size: tuple[Side, Side] = (8.0, 8.0)  # [m] of the floor


def generate(settings: Generated, makers: Sequence[Maker], purpose: Purpose) -> tuple[World, ...]:
    """The worlds of some settings, called by their maker, purpose and number.

    Args:
        settings: What to generate.
        makers: What makes them, one after the other in turns.
        purpose: What they are for.

    Raises:
        InputError: If one cannot be made.
    """
    made = []
    for number in range(settings.worlds):
        maker, rng = makers[number % len(makers)], generator_of(purpose, settings.seed, number)
        world = maker(rng, rng.uniform(*settings.difficulty), settings.size)
        if not isinstance(world, World):
            raise InputError(f"generator {settings.generator} made no tb2rl.worlds.World but {type(world).__name__}")
        made.append(replace(world, name=f"{maker.__name__} {number} ({purpose})"))
    return tuple(made)


def generator_of(purpose: Purpose, seed: int, number: int) -> np.random.Generator:
    """Where the random numbers of one world come from."""
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(_KEYS[purpose], seed, number)))
