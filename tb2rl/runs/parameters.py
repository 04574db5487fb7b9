"""What an algorithm has learned: its policy's parameters, its optimisers' state, and tensors beside both.

Arrays from a checkpoint may come from anybody. torch holds a policy's shapes against the networks, but not an
optimiser's, and would write past an array's end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, one_line
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.normalisation import load_statistics

_LARGEST, _LARGEST_COUNT = 1e9, 1e12  # of any weight, and of any integer, such as the visits of a state
_SINGLE = ("step", "mu_product")  # of an optimiser, one number for all of a layer's weights


def parameters_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """What an algorithm has learned, as a tree for `write_checkpoint`.

    Returns:
        "policy": the policy's state; "others": that of each optimiser, or whatever else Stable-Baselines3 saves with
        the algorithm; "tensors": those that belong to neither, such as the entropy coefficient of SAC.
    """
    others, tensors = _names(algorithm)
    return {
        "policy": algorithm.policy.state_dict(),
        "others": {name: attrgetter(name)(algorithm).state_dict() for name in others},
        "tensors": {name: attrgetter(name)(algorithm) for name in tensors},
    }


def load_parameters(algorithm: BaseAlgorithm, content: Mapping[str, Any], file: Path) -> None:
    """Put the parameters of a checkpoint into the algorithm of its config.

    Args:
        algorithm: Gets the parameters, and the number of timesteps.
        content: "timesteps" and "policy"; where it has a "training" too, the "others" and "tensors" in that; where
            the config normalises, "normalisation", see `statistics_of`.
        file: Where they come from, for the message.

    Raises:
        InputError: If they do not fit.
    """
    try:
        algorithm.num_timesteps = int(content["timesteps"])
        _load(algorithm.policy, content["policy"])
        load_statistics(algorithm, content.get("normalisation"))
        if training := content.get("training"):
            others, tensors = _names(algorithm)
            for name in others:
                _load(attrgetter(name)(algorithm), training["others"][name])
            for name in tensors:
                _fill(attrgetter(name)(algorithm), training["tensors"][name])
    except LIBRARY_ERRORS as error:
        raise InputError(one_line(f"{file} does not fit its config: {error or type(error).__name__}")) from None


def _names(algorithm: BaseAlgorithm) -> tuple[list[str], list[str]]:
    """What Stable-Baselines3 saves with the algorithm beside the policy: things with a state, and single tensors."""
    stateful, tensors = algorithm._get_torch_save_params()
    return [name for name in stateful if name != "policy"], list(tensors)


def _load(target: th.optim.Optimizer | th.nn.Module, state: Mapping[str, Any]) -> None:
    if isinstance(target, th.optim.Optimizer):
        parameters = [parameter for group in target.param_groups for parameter in group["params"]]
        for index, values in state["state"].items():
            _check_moments(values, parameters[index])
        # The rest of the groups is what the config says; of these, learning changes the learning rate alone.
        rates = [{"lr": float(group["lr"])} for group in state["param_groups"]]
        if not all(math.isfinite(rate["lr"]) for rate in rates):
            raise ValueError("the optimiser's learning rate is not finite")
        groups = [group | rate for group, rate in zip(target.state_dict()["param_groups"], rates, strict=True)]
        state = {"state": state["state"], "param_groups": groups}
    else:
        for name, tensor in target.state_dict().items():
            if name in state:  # torch itself names those that are missing or too many
                _check_numbers(state[name], tensor, f"its {name}")
    target.load_state_dict(_tensors(state))


def _check_moments(values: Mapping[str, Any], parameter: th.nn.Parameter) -> None:
    """Raise a ValueError where an optimiser's moments of a layer's weights differ from them in shape or kind."""
    for name, value in values.items():
        if value is None or (isinstance(value, int | float) and math.isfinite(value)):  # no momentum; a count of steps
            continue
        shape = () if name in _SINGLE else tuple(parameter.shape)
        if not isinstance(value, np.ndarray) or value.shape != shape:
            raise ValueError(f"the optimiser's {name} has another shape than the weights")
        if value.dtype.kind != "f" or not np.isfinite(value).all():
            raise ValueError(f"the optimiser's {name} has another kind of numbers than the weights, or is not finite")


def _check_numbers(array: Any, tensor: th.Tensor, what: str) -> None:
    """Raise a ValueError unless an array has numbers of the tensor's kind that learning can lead to.

    torch would convert complex numbers to real ones, and integers to floating point, without a word.
    """
    if not isinstance(array, np.ndarray) or array.dtype.kind != tensor.detach().cpu().numpy().dtype.kind:
        raise ValueError(f"{what} has another kind of numbers than the policy")
    inexact = array.dtype.kind in "fc"
    magnitudes = np.abs(array if inexact else array.astype(float))  # the least integer has no positive counterpart
    if not (magnitudes < (_LARGEST if inexact else _LARGEST_COUNT)).all():
        raise ValueError("it holds weights that learning does not lead to")


def _fill(target: th.Tensor, array: np.ndarray) -> None:
    _check_numbers(array, target, "a tensor beside the policy")
    if array.shape != tuple(target.shape):
        raise ValueError("a tensor beside the policy has another shape")
    with th.no_grad():
        target.copy_(th.from_numpy(array))  # in place: its optimiser holds on to it


def _tensors(tree: Any) -> Any:
    """The tree with tensors for arrays, as torch wants it."""
    if isinstance(tree, np.ndarray):
        return th.from_numpy(tree)
    if isinstance(tree, Mapping):
        return {key: _tensors(value) for key, value in tree.items()}
    return [_tensors(value) for value in tree] if isinstance(tree, list) else tree
