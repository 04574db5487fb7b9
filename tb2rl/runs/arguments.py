"""Arguments of algorithms: checks them against signatures, and converts them from their YAML form.

Only names and types are checked here, because the algorithm itself checks the ranges of numbers. `tb2rl.runs.algorithm`
and `tb2rl.training.error_translation` translate the errors of the algorithm into one line.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, replace
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import torch as th
from annotated_types import Ge, Gt, Le
from gymnasium import spaces
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from tb2rl.core import ANY_POLICY, Agent, InputError, import_object, one_line, unknown
from tb2rl.core.values import build, checked

LIBRARY_ERRORS = (  # errors of torch, numpy and Stable-Baselines3 for invalid values and contradictory arguments
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError, RuntimeError, TypeError,
    ValueError,
)  # fmt: skip
AGENT_RESERVED = {  # arguments of algorithms and baselines that users cannot set: tb2rl sets them or keeps defaults
    "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model",
    "observation_space", "action_space", "vehicle", "replay_buffer_class", "replay_buffer_kwargs",
    "rollout_buffer_class", "rollout_buffer_kwargs", "squash_output",
}  # fmt: skip
_MIN_IMAGE_SIDE = 36  # [pixels] least width and height for the convolutions of Stable-Baselines3
_POLICY_RESERVED = {  # arguments of policies, features extractors and optimisers that users cannot set
    "observation_space", "action_space", "lr_schedule", "params", "capturable", "differentiable",
}  # fmt: skip


def with_policy(agent: Agent, observation_space: spaces.Space, policy: str | None = None) -> Agent:
    """Replace the policy by another, or `ANY_POLICY` by the policy of the algorithm for the observation space."""
    if agent.algorithm is None or (policy is None and agent.policy != ANY_POLICY):
        return agent
    if policy is not None:
        return replace(agent, policy=policy)
    prefixes: tuple[str, ...] = ("MultiInput",)  # in order of preference
    if not isinstance(observation_space, spaces.Dict):
        _channels, *sides = observation_space.shape or (0,)
        has_image = is_image_space(observation_space) and min(sides) >= _MIN_IMAGE_SIDE
        prefixes = ("Cnn", "Mlp") if has_image else ("Mlp",)
    policies = getattr(agent.load(), "policy_aliases", {})  # such as "MlpPolicy" or "MlpLstmPolicy"
    matching = [policy for prefix in prefixes for policy in policies if policy.startswith(prefix)]
    return replace(agent, policy=matching[0]) if matching else agent


def policy_class(agent: Agent) -> type:
    """The class of the policy of an agent that learns; raises an `InputError` if there is none of this name."""
    aliases = getattr(agent.load(), "policy_aliases", {})
    if agent.policy in aliases:
        return aliases[agent.policy]
    if ":" not in agent.policy:
        raise unknown("agent.policy", agent.policy, aliases)
    return _import_torch_class(agent.policy, "agent.policy")


def checked_arguments(agent: Agent, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Check the arguments of an agent's algorithm, or of its policy if the agent does not learn.

    Plain values are converted to the annotated types. Schedules, noise and classes keep their YAML form.
    """
    algorithm = agent.load()
    result = _checked_kwargs(algorithm, arguments, "agent", AGENT_RESERVED)
    if agent.algorithm is None or result.keys().isdisjoint({"policy", "policy_kwargs"}):
        return result
    policy = policy_class(agent)
    if result.get("policy_kwargs") is not None:
        setting = "agent.policy_kwargs"
        # In a layer of the config, null resets a key of an earlier layer to the library's default.
        policy_kwargs = {key: value for key, value in result["policy_kwargs"].items() if value is not None}
        policy_kwargs = _checked_kwargs(policy, policy_kwargs, setting, _POLICY_RESERVED)
        for component in ("features_extractor", "optimizer"):
            class_key, key = f"{component}_class", f"{component}_kwargs"
            if key in policy_kwargs:
                cls = policy_kwargs.get(class_key) or constructor_parameters(policy)[class_key].default
                cls = _import_torch_class(cls, f"{setting}.{class_key}") if isinstance(cls, str) else cls
                policy_kwargs[key] = _checked_kwargs(cls, policy_kwargs[key], f"{setting}.{key}", _POLICY_RESERVED)
        result["policy_kwargs"] = policy_kwargs
    return result


def algorithm_arguments(settings: Mapping[str, Any], action_space: spaces.Space) -> dict[str, Any]:
    """Convert settings that `checked_arguments` returned from their YAML form to the arguments of the algorithm.

    - Schedule: {start: 0.5, end: 0.05, fraction: 0.8} is linear over this fraction of the training.
    - `action_noise`: {sigma: 0.1} is the standard deviation of Gaussian noise on actions.
    - Class in `policy_kwargs`: "module:Class".
    """
    arguments: dict[str, Any] = dict(settings)
    for key, value in settings.items():
        if is_schedule(value):
            arguments[key] = LinearSchedule(*map(float, astuple(_LinearSchedule(**value))))
    if arguments.get("action_noise") is not None:
        sigma = np.full(action_space.shape or (), float(arguments["action_noise"]["sigma"]))
        arguments["action_noise"] = NormalActionNoise(np.zeros_like(sigma), sigma)
    if arguments.get("policy_kwargs") is not None:
        arguments["policy_kwargs"] = {
            key: _import_torch_class(value, f"agent.policy_kwargs.{key}") if isinstance(value, str) else value
            for key, value in arguments["policy_kwargs"].items()
        }
    return arguments


def is_schedule(value: Any) -> bool:
    """Whether a value is the YAML form of a schedule, see `algorithm_arguments`."""
    return isinstance(value, Mapping) and {"start", "end"} <= value.keys()


@dataclass(frozen=True)
class _LinearSchedule:
    start: float
    end: float
    fraction: Annotated[float, Gt(0), Le(1)] = 1.0


@dataclass(frozen=True)
class _GaussianNoise:
    sigma: Annotated[float, Ge(0), Le(10)]  # the range of actions is -1 to 1


def _checked_kwargs(cls: Any, arguments: Mapping[str, Any], where: str, reserved: set[str]) -> dict[str, Any]:
    """Check arguments of a class's constructor, and convert plain values; users cannot set the `reserved` names."""
    known, annotations = constructor_parameters(cls).keys() - reserved, type_hints(cls.__init__)
    result = dict(arguments)
    for key, value in arguments.items():
        if key not in known:
            raise unknown(f"key of {where}", key, known)
        annotation, setting = annotations.get(key, Any), f"{where}.{key}"
        if isinstance(value, Mapping) and any(get_origin(option) is Callable for option in get_args(annotation)):
            build(_LinearSchedule, value, setting)  # only checks, as do the next two; `algorithm_arguments` converts
        elif value is not None and ActionNoise in get_args(annotation):
            build(_GaussianNoise, value, setting)
        elif isinstance(value, str) and get_origin(annotation) is type:
            _import_torch_class(value, setting)
        else:
            result[key] = checked(annotation, value, setting)
    return result


def constructor_parameters(cls: Any) -> dict[str, inspect.Parameter]:
    """The parameters of a constructor, without *args and **kwargs."""
    parameters = inspect.signature(cls).parameters
    variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {name: parameter for name, parameter in parameters.items() if parameter.kind not in variadic}


def _import_torch_class(reference: str, where: str) -> type:
    try:
        cls = import_object(reference)
    except InputError as error:
        raise InputError(one_line(f"{where}: {error}")) from None
    if not (isinstance(cls, type) and issubclass(cls, th.nn.Module | th.optim.Optimizer)):
        raise InputError(one_line(f"{where}: {reference!r} is neither a torch module nor an optimiser"))
    return cls


def type_hints(function_or_class: Any) -> dict[str, Any]:
    try:
        return get_type_hints(function_or_class, localns={"VecEnv": VecEnv}, include_extras=True)  # for SB3's GymEnv
    except NameError:  # an annotation uses a name that is imported only for type checkers
        return {}
