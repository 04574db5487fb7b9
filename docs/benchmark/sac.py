"""SAC as CleanRL's single file `sac_continuous_action.py` (Huang et al. 2022, JMLR 23), in many environments."""

from typing import Any, NamedTuple

import numpy as np
import torch as th
from peers import GoesOn, make_env, next_observations
from stable_baselines3.common.buffers import ReplayBuffer
from torch import nn
from torch.nn import functional

LOG_STD = (-5.0, 2.0)  # least and largest logarithm of the standard deviation
GAMMA, TAU, RATE = 0.99, 0.005, 3e-4


class SacParameters(NamedTuple):
    """Parameters of `train_sac`."""

    num_envs: int
    updates: int  # after each step of all environments
    batch_size: int
    buffer_size: int
    learning_starts: int
    hidden: int  # units of each of two layers


class Actor(nn.Module):
    """Mean and standard deviation of a Gaussian, squashed by tanh; actions are from -1 to 1."""

    def __init__(self, inputs: int, outputs: int, hidden: int) -> None:
        super().__init__()
        self.network = _network(inputs, 2 * outputs, hidden)

    def sample(self, observations: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Random actions, and the logarithms of their probabilities."""
        mean, log_std = self.network(observations).chunk(2, dim=1)
        low, high = LOG_STD
        distribution = th.distributions.Normal(mean, (low + 0.5 * (high - low) * (th.tanh(log_std) + 1)).exp())
        raw = distribution.rsample()
        actions = th.tanh(raw)
        return actions, (distribution.log_prob(raw) - th.log(1 - actions**2 + 1e-6)).sum(1, keepdim=True)


def _network(inputs: int, outputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, outputs)
    )


def train_sac(
    task: str, seed: int, total_timesteps: int, goes_on: GoesOn, parameters: SacParameters, **settings: Any
) -> int:
    """Train at a task with velocities, and return the number of steps; `settings` are the task's."""
    num_envs, updates, batch_size, buffer_size, learning_starts, hidden = parameters
    env = make_env(task, num_envs, seed, **settings)
    observation_space, action_space = env.single_observation_space, env.single_action_space
    inputs, outputs = observation_space.shape[0], action_space.shape[0]
    actor, log_alpha = Actor(inputs, outputs, hidden), th.zeros(1, requires_grad=True)
    critics, target_critics = (nn.ModuleList(_network(inputs + outputs, 1, hidden) for _ in range(2)) for _ in range(2))
    target_critics.load_state_dict(critics.state_dict())
    groups = [*actor.parameters()], [*critics.parameters()], [log_alpha]
    actor_optimizer, critic_optimizer, alpha_optimizer = (th.optim.Adam(group, lr=RATE) for group in groups)
    buffer = ReplayBuffer(buffer_size, observation_space, action_space, "cpu", num_envs)
    target_entropy = -outputs
    (observations, _), step = env.reset(seed=seed), 0
    while step < total_timesteps and goes_on(step):
        with th.no_grad():
            actions = actor.sample(th.as_tensor(observations))[0].numpy()
        if step < learning_starts:
            actions = np.random.uniform(-1, 1, actions.shape).astype(np.float32)  # noqa: NPY002 - seeded by `make_env`
        following, rewards, terminated, _, infos = env.step(actions)
        buffer.add(observations, next_observations(following, infos), actions, rewards, terminated, [{}] * num_envs)
        observations, step = following, step + num_envs
        for update in range(updates if step > learning_starts else 0):
            data = buffer.sample(batch_size)
            alpha = log_alpha.exp().item()
            with th.no_grad():
                actions, log_probs = actor.sample(data.next_observations)
                values = _least_value(target_critics, data.next_observations, actions) - alpha * log_probs
                targets = data.rewards + (1 - data.dones) * GAMMA * values
            pairs = th.cat([data.observations, data.actions], dim=1)
            loss = sum(functional.mse_loss(critic(pairs), targets) for critic in critics)
            _descend(critic_optimizer, loss)
            for _ in range(2 if update % 2 == 0 else 0):  # makes up for the delay of the actor
                actions, log_probs = actor.sample(data.observations)
                _descend(
                    actor_optimizer, (alpha * log_probs - _least_value(critics, data.observations, actions)).mean()
                )
                _descend(alpha_optimizer, (-log_alpha.exp() * (log_probs.detach() + target_entropy)).mean())
                alpha = log_alpha.exp().item()
            for weight, target in zip(critics.parameters(), target_critics.parameters(), strict=True):
                target.data.copy_(TAU * weight.data + (1 - TAU) * target.data)
    env.close()
    return step


def _least_value(critics: nn.ModuleList, observations: th.Tensor, actions: th.Tensor) -> th.Tensor:
    pairs = th.cat([observations, actions], dim=1)
    return th.min(*(critic(pairs) for critic in critics))


def _descend(optimizer: th.optim.Optimizer, loss: th.Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
