"""Arguments of the algorithms of other packages: checked against their signatures, and made from their YAML form.

Only names and types are checked here. The algorithm itself refuses numbers out of range; `tb2rl.runs.algorithm` and
`tb2rl.training.error_translation` turn its errors into one line.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import torch as th
from annotated_types import Ge, Gt, Le
from gymnasium import spaces
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.utils import LinearSchedule

from tb2rl.core.agent import ANY_POLICY, Agent, find_agent
from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.plugins import import_object
from tb2rl.core.values import build, checked

LIBRARY_ERRORS = (  # of torch, numpy and Stable-Baselines3, for arguments of the right type that do not fit together
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError, RuntimeError, TypeError,
    ValueError,
)  # fmt: skip
_SET_BY_TRAIN = {
    "self", "policy", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model",
    "observation_space", "action_space", "vehicle", "replay_buffer_class", "replay_buffer_kwargs",
    "rollout_buffer_class", "rollout_buffer_kwargs",
}  # fmt: skip
_SMALLEST_IMAGE = 36  # rows or columns that Stable-Baselines3's convolutions need
_SET_BY_ALGORITHM = {  # of policies and their parts; the last two are for CUDA graphs and for second derivatives
    "self", "observation_space", "action_space", "lr_schedule", "params", "capturable", "differentiable",
}  # fmt: skip


def agent_for(name: str, observation_space: spaces.Space) -> Agent:
    """The agent of a name; an agent that leaves its policy open gets its algorithm's policy for the observations."""
    agent = find_agent(name)
    if agent.algorithm is None or agent.policy != ANY_POLICY:
        return agent
    prefixes: tuple[str, ...] = ("MultiInput",)
    if not isinstance(observation_space, spaces.Dict):
        _, *sides = observation_space.shape or (0,)
        has_image = is_image_space(observation_space) and min(sides) >= _SMALLEST_IMAGE
        prefixes = ("Cnn", "Mlp") if has_image else ("Mlp",)
    policies = getattr(import_object(agent.algorithm), "policy_aliases", {})  # MlpLstmPolicy for a recurrent algorithm
    fitting = [policy for prefix in prefixes for policy in policies if policy.startswith(prefix)]
    return replace(agent, policy=fitting[0]) if fitting else agent


def argument_names(agent: Agent) -> set[str]:
    """The settings of an agent: arguments of its algorithm, or of its policy if it does not learn."""
    return _parameters(import_object(agent.algorithm or agent.policy), _SET_BY_TRAIN)


def check_arguments(agent: Agent, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Check the arguments of an agent's algorithm (of its policy, if it does not learn) against the signatures.

    Raises:
        InputError: For an unknown key (with the nearest one), or a value of another type.
    """
    algorithm = import_object(agent.algorithm or agent.policy)
    fitting = _check(algorithm, arguments, "agent", _SET_BY_TRAIN)
    if agent.algorithm and fitting.get("policy_kwargs") is not None:
        policy = algorithm.policy_aliases.get(agent.policy) or import_object(agent.policy)
        where = "agent.policy_kwargs"
        # null means the library's default, so that a preset can undo a key of a preset below it.
        given = {key: value for key, value in fitting["policy_kwargs"].items() if value is not None}
        inner = _check(policy, given, where, _SET_BY_ALGORITHM)
        for part in ("features_extractor", "optimizer"):
            if inner.get(f"{part}_kwargs") is not None:
                kind = inner.get(f"{part}_class") or inspect.signature(policy).parameters[f"{part}_class"].default
                kind = _network_class(kind, f"{where}.{part}_class") if isinstance(kind, str) else kind
                inner[f"{part}_kwargs"] = _check(
                    kind, inner[f"{part}_kwargs"], f"{where}.{part}_kwargs", _SET_BY_ALGORITHM
                )
        fitting["policy_kwargs"] = inner
    return fitting


def algorithm_arguments(settings: Mapping[str, Any], action_space: spaces.Space) -> dict[str, Any]:
    """Agent settings as the algorithm takes them: schedules, noise and classes made from their YAML form.

    A schedule is {start: 0.5, end: 0.05, fraction: 0.8}, linear over that share of the training; `action_noise` is
    {sigma: 0.1}, the standard deviation of Gaussian noise on actions; in `policy_kwargs` a class is "module:Class".
    """
    made: dict[str, Any] = {
        key: _schedule(value, f"agent.{key}") if is_schedule(value) else value for key, value in settings.items()
    }
    if made.get("action_noise") is not None:
        noise = np.full(action_space.shape or (), build(_Noise, made["action_noise"], "agent.action_noise").sigma)
        made["action_noise"] = NormalActionNoise(np.zeros_like(noise), noise)
    if made.get("policy_kwargs") is not None:
        made["policy_kwargs"] = {
            key: _network_class(value, f"agent.policy_kwargs.{key}") if isinstance(value, str) else value
            for key, value in made["policy_kwargs"].items()
        }
    return made


def is_schedule(value: Any) -> bool:
    """Whether a value is a schedule in its YAML form, see `algorithm_arguments`."""
    return isinstance(value, Mapping) and {"start", "end"} <= value.keys()


@dataclass(frozen=True)
class _Linear:
    start: float
    end: float
    fraction: Annotated[float, Gt(0), Le(1)] = 1.0


@dataclass(frozen=True)
class _Noise:
    sigma: Annotated[float, Ge(0), Le(10)]  # of actions that span -1 to 1


def _schedule(value: Mapping[str, Any], where: str) -> LinearSchedule:
    line = build(_Linear, value, where)
    return LinearSchedule(line.start, line.end, line.fraction)


def _check(kind: Any, arguments: Mapping[str, Any], where: str, reserved: set[str]) -> dict[str, Any]:
    """Check arguments against the constructor of a class; users cannot set the `reserved` ones."""
    known = _parameters(kind, reserved)
    fitting: dict[str, Any] = {}
    for key, value in arguments.items():
        if key not in known:
            raise unknown(f"key of {where}", key, known)
        annotation, path = _annotation(kind.__init__, key), f"{where}.{key}"
        fitting[key] = value
        if isinstance(value, Mapping) and any(get_origin(option) is Callable for option in get_args(annotation)):
            _schedule(value, path)
        elif value is not None and ActionNoise in get_args(annotation):
            build(_Noise, value, path)
        elif isinstance(value, str) and get_origin(annotation) is type:
            _network_class(value, path)
        else:
            fitting[key] = checked(annotation, value, path)
    return fitting


def _parameters(kind: Any, reserved: set[str]) -> set[str]:
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name for name, it in inspect.signature(kind.__init__).parameters.items() if it.kind in by_name} - reserved


def _network_class(reference: str, where: str) -> type:
    try:
        found = import_object(reference)
    except InputError as error:
        raise InputError(one_line(f"{where}: {error}")) from None
    if not (isinstance(found, type) and issubclass(found, th.nn.Module | th.optim.Optimizer)):
        raise InputError(one_line(f"{where}: {reference!r} is neither a torch module nor an optimiser"))
    abstract = th.nn.Module.forward
    # A ScriptModule has no attribute `forward` before it is made.
    if issubclass(found, th.nn.Module) and getattr(found, "forward", abstract) is abstract:
        raise InputError(f"{where}: {reference} has no forward of its own")
    return found


def _annotation(function: Any, name: str) -> Any:
    """The annotation of one parameter; Any if it cannot be resolved at run time."""
    only = SimpleNamespace(__annotations__={name: function.__annotations__.get(name, Any)})
    try:
        return get_type_hints(only, function.__globals__, include_extras=True)[name]
    except NameError:  # a name imported for type checkers only
        return Any
