"""Loads a policy that `tb2rl.export` wrote to a folder, and runs its layers with numpy.

Each layer maps shape (num_envs, n) to shape (num_envs, m), but `argmax` and `table` return shape (num_envs,).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Sequence, Tuple, Type

import numpy as np

from tb2rl.envs.filters import Filter

from .encoding import Encoding
from .policy_contract import Needs, SensorData, Speeds

POLICY_FORMAT = 1  # of `policy.json`
Arrays = Mapping[str, np.ndarray]
LstmState = Tuple[np.ndarray, np.ndarray]  # hidden state and cell state, each (num_envs, m)


class ExportedPolicy:
    """A policy that `python -m tb2rl.export POLICY FOLDER` wrote; acts greedily, that is, without exploration.

    Its `observation` is the last one, shape (1, n).

    Raises:
        ValueError: If the folder does not hold such a policy, or a version of tb2rl with another format wrote it.
    """

    def __init__(self, folder: str | Path) -> None:
        try:
            description = json.loads((Path(folder) / "policy.json").read_text(encoding="utf-8"))
            if description["format"] != POLICY_FORMAT:
                raise ValueError(f"its format is {description['format']}, and this program reads {POLICY_FORMAT}")
            layers: List[Tuple[str, Dict[str, np.ndarray]]] = [(layer_type, {}) for layer_type in description["layers"]]
            with (Path(folder) / "weights.npz").open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                for key in arrays.files:
                    index, name = key.split(".")
                    layers[int(index)][1][name] = arrays[key]
            self.needs = Needs(**{**description["needs"], "beams": np.array(description["needs"]["beams"])})
            classes = {each.__name__: each for each in _subclasses(Filter)}  # also those packed into this program
            self.filters = [classes[each["class"]](**each["arguments"]) for each in description.get("filters", ())]
            self.safety, self._actions = description.get("safety"), description["actions"]
            self._encoding = Encoding(description["observation"], self.needs)
            self._network = Network(layers)
        except Exception as error:  # json, zipfile, zlib and numpy raise a dozen kinds of errors for damaged files
            raise ValueError(f"{folder} is damaged, or no folder of tb2rl.export for this program: {error}") from None

    def reset(self) -> None:
        """Start a new episode."""
        self._encoding.reset()
        self._network.reset()

    def act(self, sensor_data: SensorData) -> Speeds:
        """The command of the next control step; called once per step."""
        self.observation = self._encoding(sensor_data)
        (action,) = self._network(self.observation)
        if "commands" in self._actions:
            v, w = self._actions["commands"][action]
        else:
            low, high = np.array(self._actions["low"]), np.array(self._actions["high"])
            v, w = low + (np.clip(action, -1.0, 1.0).astype(float) + 1.0) / 2.0 * (high - low)
        return float(v), float(w)


def _subclasses(cls: Type[Filter]) -> Iterator[Type[Filter]]:
    for subclass in cls.__subclasses__():
        yield subclass
        yield from _subclasses(subclass)


class Network:
    """Maps observations to greedy actions; stores the states of the LSTM layers between calls."""

    def __init__(self, layers: Sequence[Tuple[str, Arrays]]) -> None:  # type and arrays by name of each layer, in order
        self._layers = list(layers)
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._lstm_states: dict[int, LstmState] = {}  # by index of the layer

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The actions: indices of commands, shape (num_envs,), or continuous actions in [-1, 1], shape (num_envs, 2).

        Args:
            values: The observations, shape (num_envs, n): float32, or integer classes.
        """
        for index, (layer_type, arrays) in enumerate(self._layers):
            if layer_type == "lstm":
                self._lstm_states[index] = _lstm(values, self._lstm_states.get(index), arrays)
                values, _ = self._lstm_states[index]
            else:
                values = _LAYERS[layer_type](values, **arrays)
        return values


def _lstm(values: np.ndarray, state: LstmState | None, arrays: Arrays) -> LstmState:
    """The next state of an LSTM (Hochreiter & Schmidhuber 1997); a `state` of None means zeros.

    The rows of the weights are ordered as in torch: input gate, forget gate, cell gate, output gate.
    """
    zeros = np.zeros((len(values), arrays["weight_hh"].shape[1]), np.float32)
    hidden, cells = state or (zeros, zeros)
    gates = values @ arrays["weight_ih"].T + arrays["bias_ih"] + (hidden @ arrays["weight_hh"].T + arrays["bias_hh"])
    input_gate, forget_gate, candidate, output_gate = np.split(gates, 4, axis=1)
    cells = _sigmoid(forget_gate) * cells + _sigmoid(input_gate) * np.tanh(candidate)
    return _sigmoid(output_gate) * np.tanh(cells), cells


def _one_hot(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.concatenate([np.eye(n, dtype=np.float32)[column] for n, column in zip(counts, values.T)], axis=1)


def _normalise(values: np.ndarray, mean: np.ndarray, deviation: np.ndarray, limit: np.ndarray) -> np.ndarray:
    return np.clip((values - mean) / deviation, -limit, limit).astype(np.float32)


def _inverse_range(values: np.ndarray, **arrays: np.ndarray) -> np.ndarray:
    """Map distances d to 1 / (offset + d), and scale the rest to [-1, 1]; see `tb2rl.envs.features.InverseRange`."""
    inverse = 1.0 / (arrays["offset"] + np.maximum(values, arrays["nearest"]))
    return np.where(arrays["is_distance"], arrays["spread"] * (inverse - arrays["middle"]), values / arrays["largest"])


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-np.clip(values, -80.0, 80.0)))  # clipped, because exp overflows


_LAYERS: Dict[str, Any] = {
    "argmax": lambda values: values.argmax(axis=1),
    "clip": lambda values, low, high: np.minimum(np.maximum(values, low), high),
    "Elu": lambda values: np.where(values > 0, values, np.expm1(np.minimum(values, 0))),
    "Flatten": lambda values: values.reshape(len(values), -1),
    "inverse_range": _inverse_range,
    "LeakyRelu": lambda values: np.maximum(values, np.float32(0.01) * values),
    "linear": lambda values, weight, bias: values @ weight.T + bias,
    "normalise": _normalise,
    "one_hot": _one_hot,
    "Relu": lambda values: np.maximum(values, np.float32(0.0)),
    "Sigmoid": _sigmoid,
    "table": lambda values, strides, best: best[values @ strides].astype(np.int64),
    "Tanh": np.tanh,
}
