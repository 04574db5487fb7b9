"""Builds the ONNX graph of a policy: observations in, actions and commands out.

The graph is built from the layers without torch's exporters, so that it is readable and old runtimes can load it.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import onnx
from gymnasium import spaces
from onnx import TensorProto, helper, numpy_helper

from tb2rl.deploy.network import Layer, Network
from tb2rl.tasks.actions import Actions, Commands, Velocities

OPSET, IR_VERSION = 17, 8  # for onnxruntime 1.12 (2022) and later; the last release for Python 3.8 is 1.19
BATCH_AXIS = "robots"  # name of the axis of length num_envs
_FLOAT, _DOUBLE, _INTEGER = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.INT64


def build_graph(
    network: Network, observations: Mapping[str, spaces.Space], actions: Actions, metadata: Mapping[str, Any]
) -> onnx.ModelProto:
    """Build the graph of a policy.

    The inputs are the parts of the observation, as for `predict`, shape (num_envs, ...). The outputs are "action", as
    from `predict`, and "command", v [m/s] and w [rad/s], shape (num_envs, 2). An LSTM reads its state from the
    inputs "hidden_0" and "cell_0", which are zeros at the start of an episode, and writes it to the outputs
    "hidden_0_next" and "cell_0_next", shape (1, num_envs, units). A second LSTM layer has index 1. The `metadata` of
    the file become JSON under the key "tb2rl".
    """
    graph = _Graph()
    parts = []
    for name, space in observations.items():
        dtype = helper.np_dtype_to_tensor_dtype(np.dtype(space.dtype))
        graph.inputs.append(helper.make_tensor_value_info(name, dtype, (BATCH_AXIS, *(space.shape or ()))))
        parts.append(graph.apply(name, network.inputs[name]))
    joined = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
    action = graph.apply(joined, network.layers)
    if isinstance(actions, Commands):
        command = graph.add("Gather", actions.table.astype(np.float32), action, axis=0)
        outputs = [graph.output(action, "action", _INTEGER, (BATCH_AXIS,))]
    else:
        assert isinstance(actions, Velocities)  # `describe` raises for others
        offset, scale = (actions.low + actions.high) / 2.0, (actions.high - actions.low) / 2.0
        command = graph.add("Add", graph.add("Mul", action, scale.astype(np.float32)), offset.astype(np.float32))
        outputs = [graph.output(action, "action", _FLOAT, (BATCH_AXIS, 2))]
    outputs += [graph.output(command, "command", _FLOAT, (BATCH_AXIS, 2)), *graph.lstm_states]
    onnx_graph = helper.make_graph(graph.nodes, "policy", graph.inputs, outputs, graph.constants)
    opsets = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(onnx_graph, producer_name="tb2rl", opset_imports=opsets, ir_version=IR_VERSION)
    helper.set_model_props(model, {"tb2rl": json.dumps(metadata)})
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """A graph under construction; its methods take and return values as strings, the names of node outputs."""

    def __init__(self) -> None:
        self.nodes, self.constants = list[onnx.NodeProto](), list[onnx.TensorProto]()
        self.inputs, self.lstm_states = list[onnx.ValueInfoProto](), list[onnx.ValueInfoProto]()

    def add(self, operator: str, *inputs: str | np.ndarray | np.generic, outputs: int = 1, **attributes: Any) -> Any:
        """Add a node; returns the name of its output, or a list if there are several."""
        input_names = [value if isinstance(value, str) else self._constant(np.asarray(value)) for value in inputs]
        output_names = [f"{operator}_{len(self.nodes)}_{index}" for index in range(outputs)]
        self.nodes.append(helper.make_node(operator, input_names, output_names, **attributes))
        return output_names[0] if outputs == 1 else output_names

    def output(self, value: str, name: str, dtype: int, shape: tuple[int | str, ...]) -> onnx.ValueInfoProto:
        """Add a node that gives a value another name; returns the description of this output of the graph."""
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        return helper.make_tensor_value_info(name, dtype, shape)

    def apply(self, value: str, layers: tuple[Layer, ...]) -> str:
        """Add layers in a row; returns the name of the output of the last layer."""
        for type_name, arrays in layers:
            value = _LAYERS[type_name](self, value, **arrays) if type_name in _LAYERS else self.add(type_name, value)
        return value

    def _constant(self, array: np.ndarray) -> str:
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name


def _table(graph: _Graph, classes: str, strides: np.ndarray, best: np.ndarray) -> str:
    row = graph.add("MatMul", classes, strides)
    return graph.add("Cast", graph.add("Gather", best, row, axis=0), to=_INTEGER)


def _one_hot(graph: _Graph, classes: str, counts: np.ndarray) -> str:
    columns, class_indices = np.repeat(np.arange(len(counts)), counts), np.concatenate([np.arange(n) for n in counts])
    is_class = graph.add("Equal", graph.add("Gather", classes, columns, axis=1), class_indices)
    return graph.add("Cast", is_class, to=_FLOAT)


def _normalise(graph: _Graph, values: str, mean: np.ndarray, deviation: np.ndarray, limit: np.ndarray) -> str:
    centred = graph.add("Sub", graph.add("Cast", values, to=_DOUBLE), mean)
    return graph.add("Cast", graph.add("Clip", graph.add("Div", centred, deviation), -limit, limit), to=_FLOAT)


def _inverse_range(graph: _Graph, values: str, **arrays: np.ndarray) -> str:
    distance = graph.add("Add", graph.add("Max", values, arrays["nearest"]), arrays["offset"])
    difference = graph.add("Sub", graph.add("Div", np.float32(1.0), distance), arrays["middle"])
    inverse = graph.add("Mul", difference, arrays["spread"])
    return graph.add("Where", arrays["is_distance"], inverse, graph.add("Div", values, arrays["largest"]))


def _lstm(graph: _Graph, values: str, **arrays: np.ndarray) -> str:
    """Add an LSTM layer; its state is an input and an output of the graph."""
    size, layer_index = arrays["weight_hh"].shape[1], len(graph.lstm_states) // 2
    order = np.arange(4 * size).reshape(4, size)[[0, 3, 1, 2]].ravel()  # in ONNX the output gate is second
    weights = arrays["weight_ih"][order][None], arrays["weight_hh"][order][None]
    biases = np.concatenate([arrays["bias_ih"][order], arrays["bias_hh"][order]])[None]
    states = [f"{name}_{layer_index}" for name in ("hidden", "cell")]
    sequence = graph.add("Unsqueeze", values, np.array([0]))  # a sequence of one step
    _, *next_states = graph.add("LSTM", sequence, *weights, biases, "", *states, outputs=3, hidden_size=size)
    for name, value in zip(states, next_states, strict=True):
        graph.inputs.append(helper.make_tensor_value_info(name, _FLOAT, (1, BATCH_AXIS, size)))
        graph.lstm_states.append(graph.output(value, f"{name}_next", _FLOAT, (1, BATCH_AXIS, size)))
    return graph.add("Squeeze", next_states[0], np.array([0]))


_LAYERS: Mapping[str, Callable[..., str]] = {
    "argmax": lambda graph, values: graph.add("ArgMax", values, axis=1, keepdims=0),
    "clip": lambda graph, values, low, high: graph.add("Min", graph.add("Max", values, low), high),
    "conv": lambda graph, values, weight, bias, strides: graph.add("Conv", values, weight, bias, strides=strides),
    "image": lambda graph, values, largest: graph.add("Div", graph.add("Cast", values, to=_FLOAT), largest),
    "inverse_range": _inverse_range,
    "linear": lambda graph, values, weight, bias: graph.add("Gemm", values, weight, bias, transB=1),
    "lstm": _lstm,
    "normalise": _normalise,
    "one_hot": _one_hot,
    "table": _table,
}
