"""Runs the layers of an exported policy with numpy; each turns numbers (num_envs, n) into numbers (num_envs, m)."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Sequence, Tuple

import numpy as np

Arrays = Mapping[str, np.ndarray]
LayerArrays = Tuple[str, Arrays]  # the kind of a layer, and its arrays by name


class Network:
    """Maps observations to greedy actions, one layer after the other; keeps the state of its LSTM layers.

    Args:
        layers: The layers in order.

    Raises:
        ValueError: If there is an unknown kind of layer.
    """

    def __init__(self, layers: Sequence[LayerArrays]) -> None:
        unknown = sorted({kind for kind, _ in layers} - {*_LAYERS, "lstm"})
        if unknown:
            raise ValueError(f"this program does not know the layer {', '.join(unknown)}")
        self._layers = list(layers)
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._lstm_states: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """The actions: numbers of named actions, shape (num_envs,), or shares from -1 to 1, shape (num_envs, 2).

        Args:
            observations: Shape (num_envs, n): float32, or integer classes.
        """
        values = observations
        for index, (kind, arrays) in enumerate(self._layers):
            if kind == "lstm":
                self._lstm_states[index] = _lstm(values, self._lstm_states.get(index), arrays)
                values, _ = self._lstm_states[index]
            else:
                values = _LAYERS[kind](values, **arrays)
        return values


def _lstm(
    values: np.ndarray, state: tuple[np.ndarray, np.ndarray] | None, arrays: Arrays
) -> tuple[np.ndarray, np.ndarray]:
    """The next output and cells of a long short-term memory (Hochreiter & Schmidhuber 1997), each (num_envs, m).

    The weights are torch's: rows for the input gate, the forget gate, the cell gate and the output gate.
    """
    zeros = np.zeros((len(values), arrays["weight_hh"].shape[1]), np.float32)
    hidden, cells = state or (zeros, zeros)
    gates = values @ arrays["weight_ih"].T + arrays["bias_ih"] + (hidden @ arrays["weight_hh"].T + arrays["bias_hh"])
    enter, keep, new, output = np.split(gates, 4, axis=1)
    cells = _sigmoid(keep) * cells + _sigmoid(enter) * np.tanh(new)
    return _sigmoid(output) * np.tanh(cells), cells


def _one_hot(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.concatenate([np.eye(n, dtype=np.float32)[column] for n, column in zip(counts, values.T)], axis=1)


def _normalise(values: np.ndarray, mean: np.ndarray, deviation: np.ndarray, limit: np.ndarray) -> np.ndarray:
    return np.clip((values - mean) / deviation, -limit, limit).astype(np.float32)


def _inverse_range(values: np.ndarray, **arrays: np.ndarray) -> np.ndarray:
    """Distances as 1 / (offset + d), all else scaled to [-1, 1]; see `tb2rl.envs.features.InverseRange`."""
    inverse = 1.0 / (arrays["offset"] + np.maximum(values, arrays["nearest"]))
    return np.where(arrays["is_distance"], arrays["spread"] * (inverse - arrays["middle"]), values / arrays["largest"])


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-np.clip(values, -80.0, 80.0)))  # beyond, exp overflows


_LAYERS: Dict[str, Any] = {
    "argmax": lambda values: values.argmax(axis=1),
    "clip": lambda values, low, high: np.minimum(np.maximum(values, low), high),
    "elu": lambda values: np.where(values > 0, values, np.expm1(np.minimum(values, 0))),
    "flatten": lambda values: values.reshape(len(values), -1),
    "inverse_range": _inverse_range,
    "leaky_relu": lambda values: np.maximum(values, np.float32(0.01) * values),
    "linear": lambda values, weight, bias: values @ weight.T + bias,
    "normalise": _normalise,
    "one_hot": _one_hot,
    "relu": lambda values: np.maximum(values, np.float32(0.0)),
    "sigmoid": _sigmoid,
    "table": lambda values, strides, best: best[values @ strides].astype(np.int64),
    "tanh": np.tanh,
    "unscale": lambda values, low, high: low + np.float32(0.5) * (values + np.float32(1.0)) * (high - low),
}
