"""Counter-based random streams, and the sources of random numbers for initial states.

The number at position n of the stream with key k is a hash of k and n, so that any thread can draw the next number of
any environment (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). The hash is SplitMix64 (Steele et
al. 2014).
"""

import math
from dataclasses import dataclass

import numpy as np

from tb2rl.core.compiled import njit

# Constants of SplitMix64: the increment and the two multipliers of the hash.
_INCREMENT, _MULTIPLIER_1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)
_MULTIPLIER_2 = np.uint64(0x94D049BB133111EB)


@njit(cache=True)
def uniform(key, position):
    """Number at a position of the stream with this key (both uint64), uniform in [0, 1)."""
    z = key + (position + np.uint64(1)) * _INCREMENT
    z = (z ^ (z >> np.uint64(30))) * _MULTIPLIER_1
    z = (z ^ (z >> np.uint64(27))) * _MULTIPLIER_2
    return np.float64((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit(cache=True)
def normal(key, position):
    """Standard normal number, made of the stream's numbers at 2 `position` and 2 `position` + 1 (Box & Muller 1958)."""
    first, second = uniform(key, np.uint64(2) * position), uniform(key, np.uint64(2) * position + np.uint64(1))
    return math.sqrt(-2.0 * math.log(1.0 - first)) * math.cos(math.tau * second)


@njit(cache=True)
def _draw(keys, counts, numbers):
    """Fill `numbers` (num_envs, n) with the next n numbers of each stream, and advance the counts of the streams."""
    for i in range(numbers.shape[0]):
        for j in range(numbers.shape[1]):
            numbers[i, j] = uniform(keys[i], counts[i])
            counts[i] += np.uint64(1)


@dataclass(frozen=True)
class GeneratorSource:
    """Draws from a generator that all environments share."""

    generator: np.random.Generator
    num_envs: int = 1

    def uniform(self, count: int) -> np.ndarray:
        """Draw `count` numbers in [0, 1) for each environment, shape (num_envs, count)."""
        return self.generator.random((self.num_envs, count))


@dataclass(frozen=True)
class StreamSource:
    """Draws from a counter-based stream for each environment."""

    keys: np.ndarray  # keys of the streams, shape (num_envs,), uint64
    counts: np.ndarray  # how many numbers each stream has supplied, shape (num_envs,), uint64; changed in place

    @property
    def num_envs(self) -> int:
        return len(self.keys)

    def uniform(self, count: int) -> np.ndarray:
        """Draw `count` numbers in [0, 1) for each environment, shape (num_envs, count)."""
        numbers = np.empty((len(self.keys), count))
        _draw(self.keys, self.counts, numbers)
        return numbers


RandomSource = GeneratorSource | StreamSource  # a source of random numbers for initial states
