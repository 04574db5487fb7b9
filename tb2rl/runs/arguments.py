"""The arguments of other people's algorithms: held against their signatures, and made from their YAML form.

Names and types are checked here. Which numbers make sense is for the algorithm to say; `tb2rl.runs.algorithm` and
`tb2rl.training.troubles` turn what it says into one line.
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

LIBRARY_ERRORS = (  # what torch, numpy and Stable-Baselines3 raise for values of the right type that do not fit
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError, RuntimeError, TypeError,
    ValueError,
)  # fmt: skip
_GIVEN_BY_TRAIN = {
    "self", "policy", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model",
    "observation_space", "action_space", "vehicle", "replay_buffer_class", "replay_buffer_kwargs",
    "rollout_buffer_class", "rollout_buffer_kwargs",
}  # fmt: skip
_SMALLEST_IMAGE = 36  # rows or columns that Stable-Baselines3's convolutions need
_GIVEN = {  # to policies and what they are made of; the last two are for CUDA graphs and for gradients of gradients
    "self", "observation_space", "action_space", "lr_schedule", "params", "capturable", "differentiable",
}  # fmt: skip


def agent_for(name: str, observation_space: spaces.Space) -> Agent:
    """The agent of a name; if it leaves its policy open, with the one of its algorithm for such observations."""
    agent = find_agent(name)
    if agent.algorithm is None or agent.policy != ANY_POLICY:
        return agent
    policies = getattr(import_object(agent.algorithm), "policy_aliases", {})
    # A recurrent algorithm calls them MlpLstmPolicy and so on.
    fitting = [policy for kind in _networks_for(observation_space) for policy in policies if policy.startswith(kind)]
    return replace(agent, policy=fitting[0]) if fitting else agent


def _networks_for(observation_space: spaces.Space) -> tuple[str, ...]:
    """How names of policies begin that read such observations, the best first."""
    if isinstance(observation_space, spaces.Dict):
        return ("MultiInput",)
    _, *sides = observation_space.shape or (0,)
    if is_image_space(observation_space) and min(sides) >= _SMALLEST_IMAGE:
        return ("Cnn", "Mlp")
    return ("Mlp",)


def argument_names(agent: Agent) -> set[str]:
    """The settings of an agent: the arguments that users give to its algorithm (or policy, if it does not learn)."""
    return _known(import_object(agent.algorithm or agent.policy), _GIVEN_BY_TRAIN)


def check_arguments(agent: Agent, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of an agent's algorithm (of its policy, if it does not learn), held against the signatures.

    Raises:
        InputError: For a key that the signature lacks (with the nearest one), or a value of another type.
    """
    algorithm = import_object(agent.algorithm or agent.policy)
    fitting = _fitting(algorithm, arguments, "agent", _GIVEN_BY_TRAIN)
    if agent.algorithm and fitting.get("policy_kwargs") is not None:
        policy = algorithm.policy_aliases.get(agent.policy) or import_object(agent.policy)
        where = "agent.policy_kwargs"
        # A preset can undo what one below it says: null is the library's own default.
        chosen = {key: value for key, value in fitting["policy_kwargs"].items() if value is not None}
        inner = _fitting(policy, chosen, where, _GIVEN)
        for part in ("features_extractor", "optimizer"):
            if inner.get(f"{part}_kwargs") is not None:
                kind = inner.get(f"{part}_class") or inspect.signature(policy).parameters[f"{part}_class"].default
                kind = _network_class(kind, f"{where}.{part}_class") if isinstance(kind, str) else kind
                inner[f"{part}_kwargs"] = _fitting(kind, inner[f"{part}_kwargs"], f"{where}.{part}_kwargs", _GIVEN)
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


def _fitting(kind: Any, arguments: Mapping[str, Any], where: str, given: set[str]) -> dict[str, Any]:
    """The arguments of a class, held against its constructor's signature; those in `given` are not for users."""
    constructor, known = kind.__init__, _known(kind, given)
    fitting: dict[str, Any] = {}
    for key, value in arguments.items():
        if key not in known:
            raise unknown(f"key of {where}", key, known)
        wanted = _parameter_type(constructor, key)
        if isinstance(value, Mapping) and _takes_schedule(wanted):
            _schedule(value, f"{where}.{key}")
            fitting[key] = value
        elif value is not None and ActionNoise in get_args(wanted):
            build(_Noise, value, f"{where}.{key}")
            fitting[key] = value
        elif isinstance(value, str) and get_origin(wanted) is type:
            _network_class(value, f"{where}.{key}")
            fitting[key] = value
        else:
            fitting[key] = checked(wanted, value, f"{where}.{key}")
    return fitting


def _known(kind: Any, given: set[str]) -> set[str]:
    """The names of the arguments of a class, without those in `given`."""
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name for name, it in inspect.signature(kind.__init__).parameters.items() if it.kind in by_name} - given


def _network_class(reference: str, where: str) -> type:
    try:
        found = import_object(reference)
    except InputError as error:
        raise InputError(one_line(f"{where}: {error}")) from None
    if not (isinstance(found, type) and issubclass(found, th.nn.Module | th.optim.Optimizer)):
        raise InputError(one_line(f"{where}: {reference!r} is neither a torch module nor an optimiser"))
    lacking = th.nn.Module.forward
    # A ScriptModule has no attribute `forward` before it is made.
    if issubclass(found, th.nn.Module) and getattr(found, "forward", lacking) is lacking:
        raise InputError(f"{where}: {reference} has no forward of its own")
    return found


def _parameter_type(function: Any, name: str) -> Any:
    """The annotation of one parameter; Any where it cannot be known at run time."""
    only = SimpleNamespace(__annotations__={name: function.__annotations__.get(name, Any)})
    try:
        return get_type_hints(only, function.__globals__, include_extras=True)[name]
    except NameError:  # a name imported for type checkers only
        return Any


def _takes_schedule(kind: Any) -> bool:
    return any(get_origin(option) is Callable for option in get_args(kind))
