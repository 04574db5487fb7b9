"""Extracts the layers of a policy, from observations to greedy actions, as numpy arrays.

`graph.py` converts the layers to an ONNX graph, and `portable/policy.py` runs them with numpy.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor, NatureCNN
from torch import nn

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import NUMBERS
from tb2rl.envs.features import MIN_DISTANCE, InverseRange
from tb2rl.runs.algorithm import statistics_of

OBSERVATION = "observation"  # name of the input of a policy whose observation is not a Dict


class Layer(NamedTuple):
    """A layer: its type, and its arrays by name; numbers are arrays of shape ()."""

    type_name: str  # with a capital letter, it is the name of an ONNX operator without arrays
    arrays: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Network:
    """The layers from observations to actions."""

    inputs: Mapping[str, tuple[Layer, ...]]  # by part of the observation; their outputs are concatenated in this order
    layers: tuple[Layer, ...]  # after the concatenation; the last one returns the action of `predict`

    def sequence(self) -> list[Layer]:
        """All layers of a network whose observation is not a Dict."""
        return [*self.inputs[OBSERVATION], *self.layers]


def extract_network(algorithm: BaseAlgorithm) -> Network:
    """Extract the layers of a policy from `tb2rl.load`.

    Raises:
        InputError: If the policy has an unknown type or contains an unknown module.
    """
    policy: Any = algorithm.policy
    space: Any = algorithm.observation_space
    if hasattr(policy, "best_actions"):  # a table with a row for each state, whose index is observation @ strides
        best, strides = policy.best_actions(), np.cumprod([1, *space.nvec[:0:-1]])[::-1]
        table = _layer("table", strides=strides, best=best.astype(np.min_scalar_type(best.max())))
        return Network({OBSERVATION: ()}, (table,))
    extractor, layers = _extractor_and_layers(policy)
    statistics, inputs = statistics_of(algorithm).get("observations", {}), {}
    env: Any = algorithm.get_vec_normalize_env()
    for name, part in observation_spaces(space).items():
        preprocessing = []
        moments = statistics.get(name if isinstance(space, spaces.Dict) else NUMBERS)
        if moments:  # `train.norm_obs`
            deviation = np.sqrt(moments["var"] + env.epsilon)
            preprocessing.append(_layer("normalise", mean=moments["mean"], deviation=deviation, limit=env.clip_obs))
        if isinstance(part, spaces.MultiDiscrete):  # as in `preprocess_obs` of Stable-Baselines3
            preprocessing.append(_layer("one_hot", counts=part.nvec))
        elif is_image_space(part):
            preprocessing.append(_layer("image", largest=np.float32(255.0 if policy.normalize_images else 1.0)))
        is_combined = type(extractor) is CombinedExtractor  # then each part has an extractor, in the order of the space
        inputs[name] = (*preprocessing, *_convert(extractor.extractors[name] if is_combined else extractor))
    actions: Any = algorithm.action_space  # the bounds are -1 and 1, so that squashed outputs need no scaling
    is_discrete = isinstance(actions, spaces.Discrete)
    action_layer = _layer("argmax") if is_discrete else _layer("clip", low=actions.low, high=actions.high)
    return Network(inputs, (*layers, action_layer))


def observation_spaces(space: spaces.Space) -> Mapping[str, spaces.Space]:
    """The spaces of the parts of an observation, by name; an observation that is not a Dict is one part."""
    return space.spaces if isinstance(space, spaces.Dict) else {OBSERVATION: space}


def _extractor_and_layers(policy: Any) -> tuple[Any, list[Layer]]:
    """Find the features extractor, and the layers from features to action values or to an action."""
    if hasattr(policy, "q_net"):  # DQN
        return policy.q_net.features_extractor, _convert(policy.q_net.q_net)
    if hasattr(policy, "quantile_net"):  # QR-DQN
        return policy.quantile_net.features_extractor, _mean_of_quantiles(policy.quantile_net)
    if hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):  # SAC, TQC: a squashed Gaussian
        actor = policy.actor
        return actor.features_extractor, [*_convert(actor.latent_pi), *_convert(actor.mu), _layer("Tanh")]
    if hasattr(policy, "actor"):  # TD3, DDPG
        return policy.actor.features_extractor, _convert(policy.actor.mu)
    if hasattr(policy, "mlp_extractor"):  # PPO, A2C, TRPO
        lstm = _convert(policy.lstm_actor) if hasattr(policy, "lstm_actor") else []
        squashing = [_layer("Tanh")] if policy.squash_output else []
        actor_layers = [*_convert(policy.mlp_extractor.policy_net), *_convert(policy.action_net), *squashing]
        return policy.pi_features_extractor, [*lstm, *actor_layers]
    raise InputError(f"policies of the type {type(policy).__name__} cannot be exported")


def _mean_of_quantiles(network: Any) -> list[Layer]:
    """Average the last layer over the quantiles, because the value of an action is the mean of its quantiles."""
    *hidden, last = _convert(network.quantile_net)
    shape = (network.n_quantiles, -1)
    means = {name: array.reshape(*shape, *array.shape[1:]).mean(axis=0) for name, array in last.arrays.items()}
    return [*hidden, _layer("linear", **means)]


def _convert(module: nn.Module) -> list[Layer]:
    """Convert a torch module to layers."""
    if type(module) not in _CONVERTERS:
        supported = ", ".join(sorted(module_type.__name__ for module_type in _CONVERTERS))
        raise InputError(f"modules of the type {type(module).__name__} cannot be exported, only {supported}")
    return _CONVERTERS[type(module)](module)


def _lstm(module: nn.LSTM) -> list[Layer]:
    names, indices = ("weight_ih", "weight_hh", "bias_ih", "bias_hh"), range(module.num_layers)
    return [_layer("lstm", **{name: getattr(module, f"{name}_l{index}") for name in names}) for index in indices]


def _inverse_range(module: Any) -> list[Layer]:
    numbers = {"middle": module.middle, "spread": module.spread, "offset": module.offset, "nearest": MIN_DISTANCE}
    constants = {name: np.float32(number) for name, number in numbers.items()}
    buffers = {name: module.get_buffer(f"_{name}") for name in ("is_distance", "largest")}
    return [_layer("inverse_range", **buffers, **constants)]


_CONVERTERS: dict[type, Callable[[Any], list[Layer]]] = {
    nn.Sequential: lambda module: [layer for submodule in module for layer in _convert(submodule)],
    nn.Linear: lambda module: [_layer("linear", weight=module.weight, bias=module.bias)],
    nn.LSTM: _lstm,
    nn.Conv2d: lambda module: [_layer("conv", weight=module.weight, bias=module.bias, strides=module.stride)],
    nn.Flatten: lambda module: [_layer("Flatten")],
    nn.ReLU: lambda module: [_layer("Relu")],
    nn.Tanh: lambda module: [_layer("Tanh")],
    nn.Sigmoid: lambda module: [_layer("Sigmoid")],
    nn.ELU: lambda module: [_layer("Elu")],  # with the default alpha, as Stable-Baselines3 makes it
    nn.LeakyReLU: lambda module: [_layer("LeakyRelu")],
    nn.Hardtanh: lambda module: [_layer("clip", low=np.float32(module.min_val), high=np.float32(module.max_val))],
    FlattenExtractor: lambda module: [_layer("Flatten")],
    NatureCNN: lambda module: [*_convert(module.cnn), *_convert(module.linear)],
    InverseRange: _inverse_range,
}


def _layer(type_name: str, **arrays: Any) -> Layer:
    detached = {name: value.detach() if isinstance(value, th.Tensor) else value for name, value in arrays.items()}
    return Layer(type_name, {name: np.asarray(value) for name, value in detached.items()})
