"""The greedy action of a policy as plain layers of arrays, without torch.

`graph.py` makes an ONNX graph of them, `portable/network.py` runs them with numpy. Both know a layer by its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor, NatureCNN
from torch import nn

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import NUMBERS
from tb2rl.envs.features import NEAREST, InverseRange
from tb2rl.runs.normalisation import statistics_of

OBSERVATION = "observation"  # the name of an observation without parts


@dataclass(frozen=True)
class Layer:
    """One layer: its kind, and its arrays by name; a single number is an array of shape ()."""

    kind: str
    arrays: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Network:
    """The layers from observations to actions.

    Attributes:
        inputs: The layers of each part of the observation, by name; their outputs are joined in this order.
        layers: The layers after that; the last one returns the action of `predict`.
    """

    inputs: Mapping[str, tuple[Layer, ...]]
    layers: tuple[Layer, ...]

    def sequence(self) -> list[Layer]:
        """All layers of a network whose observation has no parts."""
        return [*self.inputs[OBSERVATION], *self.layers]


def network_of(algorithm: BaseAlgorithm) -> Network:
    """The layers of a policy from `tb2rl.load`.

    Raises:
        InputError: If it contains an unknown module.
    """
    policy: Any = algorithm.policy
    space = algorithm.observation_space
    if hasattr(policy, "best_actions"):
        return Network({OBSERVATION: ()}, (_table(policy.best_actions(), space),))
    extractor, layers = _extractor_and_layers(policy)
    normalised = _normalised(algorithm)
    combined = type(extractor) is CombinedExtractor  # joins the parts in the order of the space
    inputs = {
        name: (
            *normalised.get(name, ()),
            *_preprocessed(part, policy.normalize_images),
            *_layers_of(extractor.extractors[name] if combined else extractor),
        )
        for name, part in parts_of(space).items()
    }
    return Network(inputs, (*layers, _last_layer(policy, algorithm.action_space)))


def parts_of(space: spaces.Space) -> Mapping[str, spaces.Space]:
    """The spaces of the parts of an observation, by name; "observation" is the name of one without parts."""
    return space.spaces if isinstance(space, spaces.Dict) else {OBSERVATION: space}


def _extractor_and_layers(policy: Any) -> tuple[Any, list[Layer]]:
    """The features extractor, and the layers from features to the values of actions or to an action."""
    if hasattr(policy, "q_net"):  # DQN
        return policy.q_net.features_extractor, _layers_of(policy.q_net.q_net)
    if hasattr(policy, "quantile_net"):  # QR-DQN
        return policy.quantile_net.features_extractor, _mean_of_quantiles(policy.quantile_net)
    if hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):  # SAC, TQC: a squashed Gaussian
        actor = policy.actor
        return actor.features_extractor, [*_layers_of(actor.latent_pi), *_layers_of(actor.mu), _layer("tanh")]
    if hasattr(policy, "actor"):  # TD3, DDPG
        return policy.actor.features_extractor, _layers_of(policy.actor.mu)
    if hasattr(policy, "mlp_extractor"):  # PPO, A2C, TRPO
        memory = _lstm_layers(policy.lstm_actor) if hasattr(policy, "lstm_actor") else []
        squashed = [_layer("tanh")] if policy.squash_output else []
        body = [*_layers_of(policy.mlp_extractor.policy_net), *_layers_of(policy.action_net), *squashed]
        return policy.pi_features_extractor, [*memory, *body]
    raise InputError(f"{type(policy).__name__} is not a policy that can be exported")


def _table(best: np.ndarray, space: Any) -> Layer:
    """The best action of each state; its row is the sum of the classes, each times the stride of its column."""
    strides = np.cumprod([1, *space.nvec[:0:-1]])[::-1]
    return _layer("table", strides=strides, best=best.astype(np.min_scalar_type(best.max())))


def _mean_of_quantiles(network: Any) -> list[Layer]:
    """The value of an action is the mean of its quantiles, and the mean of a linear layer's outputs is linear."""
    *before, last = _layers_of(network.quantile_net)
    shape = (network.n_quantiles, -1)
    means = {name: array.reshape(*shape, *array.shape[1:]).mean(axis=0) for name, array in last.arrays.items()}
    return [*before, _layer("linear", **means)]


def _lstm_layers(lstm: nn.LSTM) -> list[Layer]:
    if lstm.bidirectional or lstm.proj_size or not lstm.bias:
        raise InputError("only a plain LSTM can be exported: one direction, with biases, without a projection")
    names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    each = ({name: getattr(lstm, f"{name}_l{number}") for name in names} for number in range(lstm.num_layers))
    return [_layer("lstm", **arrays) for arrays in each]


def _last_layer(policy: Any, space: spaces.Space) -> Layer:
    """Choose an action, or bring it into its range."""
    if isinstance(space, spaces.Discrete):
        return _layer("argmax")
    assert isinstance(space, spaces.Box)
    return _layer("unscale" if policy.squash_output else "clip", low=space.low, high=space.high)


def _normalised(algorithm: BaseAlgorithm) -> dict[str, list[Layer]]:
    """The layer of `train.norm_obs` for each part of the observation, by its name."""
    statistics = statistics_of(algorithm).get("observations", {})
    env: Any = algorithm.get_vec_normalize_env()
    several = isinstance(algorithm.observation_space, spaces.Dict)
    return {
        OBSERVATION if name == NUMBERS and not several else name: [
            _layer("normalise", mean=met["mean"], deviation=np.sqrt(met["var"] + env.epsilon), limit=env.clip_obs)
        ]
        for name, met in statistics.items()
    }


def _preprocessed(space: spaces.Space, normalize_images: bool) -> list[Layer]:
    """See `preprocess_obs` of Stable-Baselines3."""
    if isinstance(space, spaces.MultiDiscrete):
        return [_layer("one_hot", counts=space.nvec)]
    if is_image_space(space):
        return [_layer("image", largest=np.float32(255.0 if normalize_images else 1.0))]
    return []


def _layers_of(module: nn.Module) -> list[Layer]:
    """The layers of a module of torch."""
    if type(module) not in _MODULES:
        known = ", ".join(sorted(kind.__name__ for kind in _MODULES))
        raise InputError(f"a network with {type(module).__name__} in it cannot be exported; known: {known}")
    return _MODULES[type(module)](module)


def _conv(module: Any) -> list[Layer]:
    plain = (module.padding, module.dilation, module.groups) == ((0, 0), (1, 1), 1)
    if not plain or module.bias is None:
        raise InputError("only a plain Conv2d can be exported: with a bias, without padding, dilation and groups")
    return [_layer("conv", weight=module.weight, bias=module.bias, strides=np.array(module.stride))]


def _inverse_range(module: Any) -> list[Layer]:
    numbers = {"middle": module.middle, "spread": module.spread, "offset": module.offset, "nearest": NEAREST}
    singles = {name: np.float32(number) for name, number in numbers.items()}
    buffers = {name: module.get_buffer(f"_{name}") for name in ("is_distance", "largest")}
    return [_layer("inverse_range", **buffers, **singles)]


_MODULES: dict[type, Callable[[Any], list[Layer]]] = {
    nn.Sequential: lambda module: [layer for part in module for layer in _layers_of(part)],
    nn.Linear: lambda module: [_layer("linear", weight=module.weight, bias=module.bias)],
    nn.Conv2d: _conv,
    nn.Flatten: lambda module: [_layer("flatten")],
    nn.ReLU: lambda module: [_layer("relu")],
    nn.Tanh: lambda module: [_layer("tanh")],
    nn.Sigmoid: lambda module: [_layer("sigmoid")],
    nn.ELU: lambda module: [_layer("elu")],  # Stable-Baselines3 makes activations without arguments
    nn.LeakyReLU: lambda module: [_layer("leaky_relu")],
    nn.Hardtanh: lambda module: [_layer("clip", low=np.float32(module.min_val), high=np.float32(module.max_val))],
    FlattenExtractor: lambda module: [_layer("flatten")],
    NatureCNN: lambda module: [*_layers_of(module.cnn), *_layers_of(module.linear)],
    InverseRange: _inverse_range,
}


def _layer(kind: str, **arrays: Any) -> Layer:
    plain = {name: value.detach() if isinstance(value, th.Tensor) else value for name, value in arrays.items()}
    return Layer(kind, {name: np.asarray(value) for name, value in plain.items()})
