"""Counter-based random streams, and the sources of random numbers for initial states.

Number n of stream k is a hash of both, so that any thread can draw the next number of any environment. Salmon et al.
2011, "Parallel random numbers: as easy as 1, 2, 3"; the hash is SplitMix64 (Steele et al. 2014).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tb2rl.core.compiled import njit

_GOLDEN, _FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(cache=True)
def uniform(key, count):
    """Number `count` of stream `key` (both uint64), uniform in [0, 1)."""
    z = key + (count + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return np.float64((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit(cache=True)
def normal(key, count):
    """A standard normal number from numbers 2 `count` and 2 `count` + 1 of a stream (Box & Muller 1958)."""
    first, second = uniform(key, np.uint64(2) * count), uniform(key, np.uint64(2) * count + np.uint64(1))
    return math.sqrt(-2.0 * math.log(1.0 - first)) * math.cos(math.tau * second)


@njit(cache=True)
def uniforms(keys, counts, numbers):
    """Fill `numbers` (num_envs, n) with the next n numbers of each stream, and advance its count."""
    for i in range(numbers.shape[0]):
        for j in range(numbers.shape[1]):
            numbers[i, j] = uniform(keys[i], counts[i])
            counts[i] += np.uint64(1)


class Draws(Protocol):
    """A source of random numbers for initial states."""

    @property
    def num_envs(self) -> int:
        """Number of environments."""

    def uniform(self, count: int) -> np.ndarray:
        """The next `count` numbers in [0, 1) for each environment, shape (num_envs, count)."""


@dataclass(frozen=True)
class GeneratorDraws:
    """Draws from a generator that all environments share."""

    generator: np.random.Generator
    num_envs: int = 1

    def uniform(self, count: int) -> np.ndarray:
        return self.generator.random((self.num_envs, count))


@dataclass(frozen=True)
class StreamDraws:
    """Draws from a counter-based stream for each environment.

    Attributes:
        keys: Shape (num_envs,), uint64.
        counts: Numbers drawn so far, shape (num_envs,), uint64; advanced in place.
    """

    keys: np.ndarray
    counts: np.ndarray

    @property
    def num_envs(self) -> int:
        return len(self.keys)

    def uniform(self, count: int) -> np.ndarray:
        numbers = np.empty((len(self.keys), count))
        uniforms(self.keys, self.counts, numbers)
        return numbers
