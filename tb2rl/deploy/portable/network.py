"""The layers of an exported policy, run with numpy: each turns numbers (num_envs, n) into numbers (num_envs, m)."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np

Arrays = Mapping[str, np.ndarray]


class Network:
    """From observations to greedy actions, one layer after the other; it remembers what its LSTM layers keep.

    Args:
        layers: The kind of each layer, and its arrays by name.

    Raises:
        ValueError: If there is a kind that is not known here.
    """

    def __init__(self, layers: Sequence[Tuple[str, Arrays]]) -> None:
        unknown = sorted({kind for kind, _ in layers} - {*_LAYERS, "lstm"})
        if unknown:
            raise ValueError("this runner does not know the layer {}".format(", ".join(unknown)))
        self._layers = list(layers)
        self.begin()

    def begin(self) -> None:
        """Forget everything: an episode begins."""
        self._memory: Dict[int, List[np.ndarray]] = {}

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """The actions: numbers of named actions, shape (num_envs,), or shares from -1 to 1, shape (num_envs, 2).

        Args:
            observations: Of the robots, shape (num_envs, n): float32, or integers for classes.
        """
        values = observations
        for number, (kind, arrays) in enumerate(self._layers):
            values = self._remember(number, values, arrays) if kind == "lstm" else _LAYERS[kind](values, **arrays)
        return values

    def _remember(self, number: int, values: np.ndarray, arrays: Arrays) -> np.ndarray:
        """What the LSTM says that is the layer of this number, and keeps."""
        empty = np.zeros((len(values), arrays["weight_hh"].shape[1]), np.float32)
        self._memory[number] = lstm(values, self._memory.get(number, [empty, empty]), **arrays)
        return self._memory[number][0]


def lstm(
    values: np.ndarray,
    past: Sequence[np.ndarray],
    weight_ih: np.ndarray,
    weight_hh: np.ndarray,
    bias_ih: np.ndarray,
    bias_hh: np.ndarray,
) -> List[np.ndarray]:
    """A step of a long short-term memory (Hochreiter & Schmidhuber 1997): what it says, and its cells, (num_envs, m).

    The weights are torch's: rows for the input gate, the forget gate, the new value and the output gate.
    """
    said, cells = past
    gates = (values @ weight_ih.T + bias_ih) + (said @ weight_hh.T + bias_hh)
    enter, keep, new, say = np.split(gates, 4, axis=1)
    cells = _sigmoid(keep) * cells + _sigmoid(enter) * np.tanh(new)
    return [_sigmoid(say) * np.tanh(cells), cells]


def _table(values: np.ndarray, strides: np.ndarray, best: np.ndarray) -> np.ndarray:
    """The best action of the state that the classes name."""
    return best[values @ strides].astype(np.int64)


def _one_hot(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """A one for the class of each number and zeros for all others, side by side."""
    return np.concatenate([np.eye(n, dtype=np.float32)[column] for n, column in zip(counts, values.T)], axis=1)


def _normalise(values: np.ndarray, mean: np.ndarray, deviation: np.ndarray, limit: np.ndarray) -> np.ndarray:
    return np.clip((values - mean) / deviation, -limit, limit).astype(np.float32)


def _nearness(
    values: np.ndarray,
    is_distance: np.ndarray,
    largest: np.ndarray,
    middle: np.ndarray,
    spread: np.ndarray,
    offset: np.ndarray,
    nearest: np.ndarray,
) -> np.ndarray:
    """Distances as nearness 1 / (offset + d), all else scaled to [-1, 1]."""
    near = spread * (1.0 / (offset + np.maximum(values, nearest)) - middle)
    return np.where(is_distance, near, values / largest)


def _linear(values: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    return values @ weight.T + bias


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-np.clip(values, -80.0, 80.0)))  # beyond, exp overflows


def _unscale(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Shares from -1 to 1 of the range of each number."""
    return low + np.float32(0.5) * (values + np.float32(1.0)) * (high - low)


_LAYERS: Dict[str, Any] = {
    "argmax": lambda values: values.argmax(axis=1),
    "clip": lambda values, low, high: np.minimum(np.maximum(values, low), high),
    "elu": lambda values: np.where(values > 0, values, np.expm1(np.minimum(values, 0))),
    "flatten": lambda values: values.reshape(len(values), -1),
    "leaky_relu": lambda values: np.maximum(values, np.float32(0.01) * values),
    "linear": _linear,
    "nearness": _nearness,
    "normalise": _normalise,
    "one_hot": _one_hot,
    "relu": lambda values: np.maximum(values, np.float32(0.0)),
    "sigmoid": _sigmoid,
    "table": _table,
    "tanh": np.tanh,
    "unscale": _unscale,
}
