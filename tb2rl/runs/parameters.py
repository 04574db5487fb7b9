"""Learned parameters of an algorithm: its policy's, the state of its optimisers, and further tensors.

Arrays of a checkpoint can come from anybody. torch compares the shapes of a policy with its networks, but not those of
an optimiser, and would write past the end of an array.
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
_SCALARS = ("step", "mu_product")  # optimiser state with one number for all weights of a layer


def parameters_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The learned parameters, as a tree for `write_checkpoint`.

    Returns:
        "policy": its state; "others": the states of optimisers and whatever else Stable-Baselines3 saves; "tensors":
        single tensors, such as the entropy coefficient of SAC.
    """
    others, tensors = _names(algorithm)
    return {
        "policy": algorithm.policy.state_dict(),
        "others": {name: attrgetter(name)(algorithm).state_dict() for name in others},
        "tensors": {name: attrgetter(name)(algorithm) for name in tensors},
    }


def load_parameters(algorithm: BaseAlgorithm, content: Mapping[str, Any], file: Path) -> None:
    """Load the parameters and the number of timesteps of a checkpoint into the algorithm of its config.

    Args:
        algorithm: The algorithm to change.
        content: "timesteps" and "policy"; optionally "training" with "others" and "tensors", see `parameters_of`, and
            "normalisation", see `statistics_of`.
        file: Their origin, for messages.

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
    """Attributes that Stable-Baselines3 saves beside the policy: objects with a state, and tensors.

    No public function of it names them; saving to its own archive would pickle.
    """
    stateful, tensors = algorithm._get_torch_save_params()
    return [name for name in stateful if name != "policy"], list(tensors)


def _load(target: th.optim.Optimizer | th.nn.Module, state: Mapping[str, Any]) -> None:
    if isinstance(target, th.optim.Optimizer):
        state = _optimizer_state(target, state)
    else:
        for name, tensor in target.state_dict().items():
            if name in state:  # torch itself reports missing and unexpected names
                _check_numbers(state[name], tensor, f"its {name}")
    target.load_state_dict(_tensors(state))


def _optimizer_state(target: th.optim.Optimizer, state: Mapping[str, Any]) -> dict[str, Any]:
    """The checked state of an optimiser; its options stay those of the config, except the learning rate."""
    parameters = [parameter for group in target.param_groups for parameter in group["params"]]
    for index, values in state["state"].items():
        _check_moments(values, parameters[index])
    rates = [{"lr": float(group["lr"])} for group in state["param_groups"]]
    if not all(math.isfinite(rate["lr"]) for rate in rates):
        raise ValueError("the optimiser's learning rate is not finite")
    groups = [group | rate for group, rate in zip(target.state_dict()["param_groups"], rates, strict=True)]
    return {"state": state["state"], "param_groups": groups}


def _check_moments(values: Mapping[str, Any], parameter: th.nn.Parameter) -> None:
    """Raise a ValueError unless an optimiser's moments of a layer are finite and have the shape of its weights."""
    for name, value in values.items():
        if value is None or (isinstance(value, int | float) and math.isfinite(value)):  # no momentum; a step count
            continue
        shape = () if name in _SCALARS else tuple(parameter.shape)
        if not isinstance(value, np.ndarray) or value.shape != shape:
            raise ValueError(f"the optimiser's {name} has another shape than the weights")
        if value.dtype.kind != "f" or not np.isfinite(value).all():
            raise ValueError(f"the optimiser's {name} has another kind of numbers than the weights, or is not finite")


def _check_numbers(array: Any, tensor: th.Tensor, what: str) -> None:
    """Raise a ValueError unless an array has plausible numbers of the tensor's kind.

    torch would silently convert complex numbers to real ones, and integers to floating point.
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
        target.copy_(th.from_numpy(array))  # in place, because its optimiser refers to it


def _tensors(tree: Any) -> Any:
    """The tree with tensors for arrays."""
    if isinstance(tree, np.ndarray):
        return th.from_numpy(tree)
    if isinstance(tree, Mapping):
        return {key: _tensors(value) for key, value in tree.items()}
    return [_tensors(value) for value in tree] if isinstance(tree, list) else tree
