"""Builds the ONNX graph of a policy: observations in, actions and commands out.

The graph is built from the layers, without torch's exporters, because so it is readable and old runtimes can load it
(Python 3.8 has onnxruntime 1.19).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import onnx
from gymnasium import spaces
from onnx import TensorProto, helper, numpy_helper

from tb2rl.deploy.network import Layer, Network
from tb2rl.tasks.actions import Actions, Commands, Velocities

OPSET, IR_VERSION = 17, 8  # of 2022: onnxruntime 1.12 and later read them
ROBOTS = "robots"  # the name of the first axis, of any length
_FLOAT, _DOUBLE, _INTEGER = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.INT64


def graph_of(
    network: Network, observations: Mapping[str, spaces.Space], actions: Actions, about: Mapping[str, Any]
) -> onnx.ModelProto:
    """Build the graph of a policy.

    Its inputs are the parts of the observation as `predict` takes them, shape (num_envs, ...); its outputs are
    "action", as `predict` returns it, and "command": v [m/s] and w [rad/s], shape (num_envs, 2). A policy with an LSTM
    also takes "hidden_0" and "cell_0", zeros at the start of an episode, and returns their next values as
    "hidden_0_next" and "cell_0_next", shape (1, num_envs, units); a second layer of the LSTM is number 1.

    Args:
        network: The layers.
        observations: The space of each input.
        actions: The meaning of the actions.
        about: Metadata of the file, as JSON under "tb2rl".
    """
    graph = _Graph()
    parts = []
    for name, space in observations.items():
        dtype = helper.np_dtype_to_tensor_dtype(np.dtype(space.dtype))
        graph.input(name, dtype, (ROBOTS, *(space.shape or ())))
        parts.append(graph.apply(name, network.inputs[name]))
    joined = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
    action = graph.apply(joined, network.layers)
    if isinstance(actions, Commands):
        graph.output(action, "action", _INTEGER, (ROBOTS,))
        command = graph.add("Gather", actions.table.astype(np.float32), action, axis=0)
    else:
        assert isinstance(actions, Velocities)  # `describe` refuses others
        graph.output(action, "action", _FLOAT, (ROBOTS, 2))
        command = _unscale(graph, action, actions.low, actions.high)
    graph.output(command, "command", _FLOAT, (ROBOTS, 2))
    return graph.model(about)


class _Graph:
    """A graph under construction; values are known by their names."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []
        self._lstm_layers = 0

    def add(self, operator: str, *inputs: str | np.ndarray | np.generic, outputs: int = 1, **attributes: Any) -> Any:
        """Add a node; returns the name of its output, or the names of several."""
        names = [each if isinstance(each, str) else self._constant(np.asarray(each)) for each in inputs]
        made = [f"{operator}_{len(self._nodes)}_{number}" for number in range(outputs)]
        self._nodes.append(helper.make_node(operator, names, made, **attributes))
        return made[0] if outputs == 1 else made

    def cast(self, value: str, dtype: int) -> str:
        """Add a conversion of a value."""
        return self.add("Cast", value, to=dtype)

    def input(self, name: str, dtype: int, shape: tuple[int | str, ...]) -> str:
        """Declare an input; returns its name."""
        self._inputs.append(helper.make_tensor_value_info(name, dtype, shape))
        return name

    def output(self, value: str, name: str, dtype: int, shape: tuple[int | str, ...]) -> None:
        """Declare a value an output, under a name of its own."""
        self._nodes.append(helper.make_node("Identity", [value], [name]))
        self._outputs.append(helper.make_tensor_value_info(name, dtype, shape))

    def apply(self, value: str, layers: tuple[Layer, ...]) -> str:
        """Add layers, one after the other; returns the name of the last one's output."""
        for layer in layers:
            value = _LAYERS[layer.kind](self, value, **layer.arrays)
        return value

    def lstm(self, values: str, size: int, *weights: np.ndarray) -> str:
        """Add an LSTM with its state as input and output; returns the name of its output (num_envs, size)."""
        shape, number = (1, ROBOTS, size), self._lstm_layers
        past = [self.input(f"{name}_{number}", _FLOAT, shape) for name in ("hidden", "cell")]
        sequence = self.add("Unsqueeze", values, np.array([0]))  # of one step
        _, *now = self.add("LSTM", sequence, *weights, "", *past, outputs=3, hidden_size=size)
        for name, value in zip(("hidden", "cell"), now, strict=True):
            self.output(value, f"{name}_{number}_next", _FLOAT, shape)
        self._lstm_layers += 1
        return self.add("Squeeze", now[0], np.array([0]))

    def model(self, about: Mapping[str, Any]) -> onnx.ModelProto:
        """The model, checked, with its metadata."""
        outputs = sorted(self._outputs, key=lambda output: "_next" in output.name)  # the LSTM's come last
        graph = helper.make_graph(self._nodes, "policy", self._inputs, outputs, self._constants)
        opsets = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, producer_name="tb2rl", opset_imports=opsets, ir_version=IR_VERSION)
        helper.set_model_props(model, {"tb2rl": json.dumps(about)})
        onnx.checker.check_model(model, full_check=True)
        return model

    def _constant(self, array: np.ndarray) -> str:
        name = f"constant_{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name


def _table(graph: _Graph, classes: str, strides: np.ndarray, best: np.ndarray) -> str:
    row = graph.add("MatMul", classes, strides)
    return graph.cast(graph.add("Gather", best, row, axis=0), _INTEGER)


def _one_hot(graph: _Graph, classes: str, counts: np.ndarray) -> str:
    columns, numbers = np.repeat(np.arange(len(counts)), counts), np.concatenate([np.arange(n) for n in counts])
    return graph.cast(graph.add("Equal", graph.add("Gather", classes, columns, axis=1), numbers), _FLOAT)


def _normalise(graph: _Graph, values: str, mean: np.ndarray, deviation: np.ndarray, limit: np.ndarray) -> str:
    centred = graph.add("Sub", graph.cast(values, _DOUBLE), mean)
    return graph.cast(graph.add("Clip", graph.add("Div", centred, deviation), -limit, limit), _FLOAT)


def _inverse_range(graph: _Graph, values: str, **arrays: np.ndarray) -> str:
    distance = graph.add("Add", graph.add("Max", values, arrays["nearest"]), arrays["offset"])
    difference = graph.add("Sub", graph.add("Div", np.float32(1.0), distance), arrays["middle"])
    inverse = graph.add("Mul", difference, arrays["spread"])
    return graph.add("Where", arrays["is_distance"], inverse, graph.add("Div", values, arrays["largest"]))


def _lstm(graph: _Graph, values: str, **arrays: np.ndarray) -> str:
    size = arrays["weight_hh"].shape[1]
    order = np.arange(4 * size).reshape(4, size)[[0, 3, 1, 2]].ravel()  # ONNX has the output gate second
    weights = arrays["weight_ih"][order][None], arrays["weight_hh"][order][None]
    biases = np.concatenate([arrays["bias_ih"][order], arrays["bias_hh"][order]])
    return graph.lstm(values, size, *weights, biases[None])


def _unscale(graph: _Graph, values: str, low: np.ndarray, high: np.ndarray) -> str:
    share = graph.add("Mul", graph.add("Add", values, np.float32(1.0)), np.float32(0.5))
    return graph.add("Add", graph.add("Mul", share, (high - low).astype(np.float32)), low.astype(np.float32))


def _conv(graph: _Graph, values: str, weight: np.ndarray, bias: np.ndarray, strides: np.ndarray) -> str:
    return graph.add("Conv", values, weight, bias, strides=strides.tolist())


_LAYERS: Mapping[str, Callable[..., str]] = {
    "argmax": lambda graph, values: graph.add("ArgMax", values, axis=1, keepdims=0),
    "clip": lambda graph, values, low, high: graph.add("Min", graph.add("Max", values, low), high),
    "conv": _conv,
    "elu": lambda graph, values: graph.add("Elu", values),
    "flatten": lambda graph, values: graph.add("Flatten", values),
    "image": lambda graph, values, largest: graph.add("Div", graph.cast(values, _FLOAT), largest),
    "inverse_range": _inverse_range,
    "leaky_relu": lambda graph, values: graph.add("LeakyRelu", values),
    "linear": lambda graph, values, weight, bias: graph.add("Gemm", values, weight, bias, transB=1),
    "lstm": _lstm,
    "normalise": _normalise,
    "one_hot": _one_hot,
    "relu": lambda graph, values: graph.add("Relu", values),
    "sigmoid": lambda graph, values: graph.add("Sigmoid", values),
    "table": _table,
    "tanh": lambda graph, values: graph.add("Tanh", values),
    "unscale": _unscale,
}
