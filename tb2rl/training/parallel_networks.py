"""Runs the actor and the critic of an on-policy algorithm at the same time, with the same results to the bit.

Each network is computed by one Python thread, because torch releases the interpreter lock. The threads of torch divide
each operation instead: they gain as much, but add in another order, and spin while they wait for each other.
"""

from collections.abc import Callable
from typing import Any

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import MlpExtractor

from tb2rl.core.processes import processors
from tb2rl.core.threads import parallel_for

_MIN_MULTIPLICATIONS = 4_000_000  # of a network for all observations, about 50 us; a thread needs as long to wake up


def parallelize_networks(algorithm: BaseAlgorithm) -> None:
    """Let the actor and the critic of an algorithm run at the same time, if it has both and there are processors."""
    extractor = getattr(algorithm.policy, "mlp_extractor", None)
    # torch's threads spin while they wait, so more threads than processors would take several times as long.
    if type(extractor) is MlpExtractor and 2 * th.get_num_threads() <= processors():
        extractor.__class__ = _ParallelExtractor  # the same layers, so parameters and checkpoints stay as they are


class _ParallelExtractor(MlpExtractor):
    """The hidden layers of the actor and the critic, each in its own thread."""

    def forward(self, features: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        networks = self.policy_net, self.value_net
        parameters = [list(network.parameters()) for network in networks]
        multiplications = len(features) * min(sum(p.numel() for p in part) for part in parameters)
        if features.requires_grad or features.device.type != "cpu" or multiplications < _MIN_MULTIPLICATIONS:
            return super().forward(features)
        if not th.is_grad_enabled():
            return _each(lambda network: network(features), networks)
        return _ParallelGradients.apply(networks, features, parameters, *parameters[0], *parameters[1])


class _ParallelGradients(th.autograd.Function):
    """Both networks, with gradients of their parameters, but not of their input."""

    @staticmethod
    def forward(ctx: Any, networks: Any, features: th.Tensor, parameters: Any, *_: th.Tensor) -> Any:
        with th.enable_grad():
            ctx.latents = _each(lambda network: network(features), networks)
        ctx.parameters = parameters
        return tuple(latent.detach() for latent in ctx.latents)

    @staticmethod
    def backward(ctx: Any, *gradients: th.Tensor) -> Any:
        parts = _each(th.autograd.grad, ctx.latents, ctx.parameters, gradients)
        return None, None, None, *parts[0], *parts[1]


def _each(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function with the arguments of each network, in parallel."""
    calls, results = list(zip(*arguments, strict=True)), {}
    with_gradients, num_threads = th.is_grad_enabled(), th.get_num_threads()

    def work(first: int, end: int) -> None:
        for i in range(first, end):
            th.set_num_threads(num_threads)  # this and the next setting belong to the thread
            with th.set_grad_enabled(with_gradients):
                results[i] = function(*calls[i])

    parallel_for(work, len(calls), 1)  # 1: the calling thread takes one network, whatever the number of threads
    return tuple(results[i] for i in range(len(calls)))
