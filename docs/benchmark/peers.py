"""Learners of other programs as their users would take them: their own parameters, raw ranges, one task's Gymnasium id.

DQN and PPO follow CleanRL's single files `dqn.py`, `ppo.py` and `ppo_continuous_action.py` (Huang et al. 2022, JMLR 23)
with their parameters. SBX is Stable-Baselines3 in JAX, with its own parameters in 16 environments; it is not a
dependency: `pip install sbx-rl`.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from torch import nn
from torch.distributions import Categorical, Distribution, Normal
from torch.nn import functional

import tb2rl
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv

SBX_ENVS = 16
DISCRETE, CONTINUOUS = ("maze", "wall"), ("drive",)  # tasks with commands, and with velocities
GoesOn = Callable[[int], bool]  # whether a training goes on after so many control steps


class PpoParameters(NamedTuple):
    """Parameters of `train_ppo`."""

    num_envs: int
    num_steps: int  # of a rollout, in each environment
    batch_size: int
    epochs: int
    learning_rate: float
    entropy_weight: float


COMMANDS_PPO = PpoParameters(4, 128, 128, 4, 2.5e-4, 0.01)  # of CleanRL's `ppo.py`
VELOCITIES_PPO = PpoParameters(1, 2048, 64, 10, 3e-4, 0.0)  # of its `ppo_continuous_action.py`


class Trained(NamedTuple):
    """A trained policy."""

    policy: Any
    timesteps: int
    curve: Sequence[tuple[int, float]] = ()  # timesteps and rate of good episodes of each evaluation


def entrants() -> dict[tuple[str, str], Callable[[str, int, int, GoesOn], Trained]]:
    """Functions `train(task, seed, total_timesteps, goes_on)` by program and task."""
    functions: dict[str, tuple[Any, tuple[str, ...]]] = {
        "CleanRL-style DQN": (train_dqn, DISCRETE),
        "CleanRL-style PPO": (train_ppo, (*DISCRETE, *CONTINUOUS)),
    }
    if find_spec("sbx"):
        for name, tasks in (("DQN", DISCRETE), ("PPO", (*DISCRETE, *CONTINUOUS)), ("SAC", CONTINUOUS)):
            functions[f"SBX {name}"] = (lambda *arguments, name=name: train_sbx(name, *arguments), tasks)
    return {(name, task): function for name, (function, tasks) in functions.items() for task in tasks}


def train_sbx(algorithm: str, task: str, seed: int, total_timesteps: int, goes_on: GoesOn) -> Trained:
    """Train an algorithm of SBX with its default parameters."""
    env = TurtleBot2VecEnv(make_scene(make_task(task, {}), "raw"), SBX_ENVS, simulation="kinematic")
    model = getattr(import_module("sbx"), algorithm)("MlpPolicy", env, seed=seed)
    # A plain function is a callback of Stable-Baselines3, too.
    model.learn(total_timesteps, callback=lambda _locals, _globals: goes_on(model.num_timesteps))
    env.close()
    return Trained(model.policy, model.num_timesteps)


def make_env(task: str, num_envs: int, seed: int, **settings: Any) -> gym.vector.VectorEnv:
    """Environments of a task by its Gymnasium id; also seeds the global generators."""
    arguments = {"task": task, "observation": "raw"}
    name = next(name for name, others in tb2rl.GYM_IDS.items() if others == arguments)
    np.random.seed(seed)  # noqa: NPY002 - Stable-Baselines3's buffer draws from it
    th.manual_seed(seed)
    return gym.make_vec(f"tb2rl:{name}", num_envs, simulation="kinematic", **settings)


def next_observations(observations: np.ndarray, infos: dict[str, Any]) -> np.ndarray:
    """The observations after a step; of ended episodes the last ones, not the first ones of the next episodes."""
    if "final_obs" not in infos:
        return observations
    ended = infos["_final_obs"]
    result = observations.copy()
    result[ended] = np.stack(infos["final_obs"][ended])
    return result


class DqnPolicy(BasePolicy):
    """Action values; the greedy action."""

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Discrete) -> None:
        super().__init__(observation_space, action_space)
        inputs, outputs = observation_space.shape[0], int(action_space.n)
        self.values = nn.Sequential(
            nn.Linear(inputs, 120), nn.ReLU(), nn.Linear(120, 84), nn.ReLU(), nn.Linear(84, outputs)
        )

    def _predict(self, observation: Any, deterministic: bool = False) -> th.Tensor:
        return self.values(observation.float()).argmax(dim=1)


def train_dqn(task: str, seed: int, total_timesteps: int, goes_on: GoesOn) -> Trained:
    """CleanRL's `dqn.py`: one environment, a replay buffer of 10 000 steps."""
    env, rng = make_env(task, 1, seed), np.random.default_rng(seed)
    policy, target = (DqnPolicy(env.single_observation_space, env.single_action_space) for _ in range(2))
    target.load_state_dict(policy.state_dict())
    optimizer = th.optim.Adam(policy.parameters(), lr=2.5e-4)
    buffer = ReplayBuffer(10_000, env.single_observation_space, env.single_action_space, "cpu")
    observations, _ = env.reset(seed=seed)
    step = 0
    while step < total_timesteps and goes_on(step):
        epsilon = max(0.05, 1.0 - 0.95 * step / (0.5 * total_timesteps))
        actions = rng.integers(env.single_action_space.n, size=1)
        if rng.random() >= epsilon:
            actions, _ = policy.predict(observations)
        following, rewards, terminated, _, infos = env.step(actions)
        buffer.add(observations, next_observations(following, infos), actions, rewards, terminated, [{}])
        observations, step = following, step + 1
        if step > 10_000 and step % 10 == 0:
            data = buffer.sample(128)
            with th.no_grad():
                best, _ = target.values(data.next_observations).max(dim=1)
                targets = data.rewards.flatten() + 0.99 * best * (1 - data.dones.flatten())
            values = policy.values(data.observations).gather(1, data.actions).squeeze()
            optimizer.zero_grad()
            functional.mse_loss(targets, values).backward()
            optimizer.step()
        if step > 10_000 and step % 500 == 0:
            target.load_state_dict(policy.state_dict())
    env.close()
    return Trained(policy, step)


class PpoPolicy(BasePolicy):
    """Actor and critic with tanh units; the most probable action."""

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Space) -> None:
        super().__init__(observation_space, action_space)
        self.is_discrete = isinstance(action_space, spaces.Discrete)
        outputs = int(action_space.n) if isinstance(action_space, spaces.Discrete) else action_space.shape[0]
        inputs = observation_space.shape[0]
        self.critic, self.actor = _tanh_network(inputs, 1, 1.0), _tanh_network(inputs, outputs, 0.01)
        self.log_std = nn.Parameter(th.zeros(outputs))
        # Running statistics of the observations, which only the continuous version normalises.
        self.register_buffer("mean", th.zeros(inputs))
        self.register_buffer("variance", th.ones(inputs))
        self.register_buffer("count", th.tensor(1e-4))

    def observe(self, observations: th.Tensor) -> None:
        """Update the statistics of the observations (Chan et al. 1979)."""
        mean, variance, count = observations.mean(0), observations.var(0, correction=0), len(observations)
        total, delta = self.count + count, mean - self.mean
        spread = self.variance * self.count + variance * count + delta**2 * self.count * count / total
        self.mean, self.variance, self.count = self.mean + delta * count / total, spread / total, total

    def normalized(self, observations: Any) -> th.Tensor:
        """The inputs of the networks."""
        observations = th.as_tensor(observations, dtype=th.float32)
        scaled = (observations - self.mean) / th.sqrt(self.variance + 1e-8)
        return observations if self.is_discrete else scaled.clip(-10, 10)

    def distribution(self, inputs: th.Tensor) -> Distribution:
        """The distribution of the actions."""
        outputs = self.actor(inputs)
        return Categorical(logits=outputs) if self.is_discrete else Normal(outputs, self.log_std.exp())

    def log_probability(self, distribution: Distribution, actions: th.Tensor) -> th.Tensor:
        """The logarithm of the actions' probability, summed over their components."""
        result = distribution.log_prob(actions)
        return result if self.is_discrete else result.sum(1)

    def _predict(self, observation: Any, deterministic: bool = False) -> th.Tensor:
        outputs = self.actor(self.normalized(observation))
        return outputs.argmax(dim=1) if self.is_discrete else outputs


def _tanh_network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, outputs)]
    for layer, scale in zip(layers, (np.sqrt(2), np.sqrt(2), gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def train_ppo(
    task: str,
    seed: int,
    total_timesteps: int,
    goes_on: GoesOn,
    parameters: PpoParameters | None = None,
    **settings: Any,
) -> Trained:
    """CleanRL's `ppo.py` for commands, its `ppo_continuous_action.py` for velocities.

    `parameters` replace those of CleanRL, `settings` the task's.
    """
    is_discrete = task not in CONTINUOUS
    parameters = parameters or (COMMANDS_PPO if is_discrete else VELOCITIES_PPO)
    num_envs, num_steps, size, epochs, rate, entropy_weight = parameters
    env = make_env(task, num_envs, seed, **settings)
    policy = PpoPolicy(env.single_observation_space, env.single_action_space)
    optimizer = th.optim.Adam(policy.parameters(), lr=rate, eps=1e-5)
    rewards_scale = _RewardScale(num_envs)
    observations, _ = env.reset(seed=seed)
    dones, step, batch_size = np.zeros(num_envs), 0, num_envs * num_steps
    while step < total_timesteps and goes_on(step):
        optimizer.param_groups[0]["lr"] = rate * max(0.0, 1 - step / total_timesteps)
        rollout: dict[str, list[Any]] = {name: [] for name in ("inputs", "actions", "log_probs", "values")}
        rewards, ends = np.zeros((num_steps, num_envs), np.float32), np.zeros((num_steps + 1, num_envs), np.float32)
        for index in range(num_steps):
            ends[index] = dones
            if not is_discrete:
                policy.observe(th.as_tensor(observations, dtype=th.float32))
            with th.no_grad():
                inputs = policy.normalized(observations)
                distribution = policy.distribution(inputs)
                actions = distribution.sample()
                log_probs, values = policy.log_probability(distribution, actions), policy.critic(inputs).flatten()
            for name, value in zip(rollout, (inputs, actions, log_probs, values), strict=True):
                rollout[name].append(value)
            space = env.single_action_space
            command = actions.numpy() if is_discrete else actions.numpy().clip(space.low, space.high)
            observations, reward, terminated, truncated, _ = env.step(command)
            dones = terminated | truncated
            rewards[index] = reward if is_discrete else rewards_scale(reward, dones)
        step, ends[-1] = step + batch_size, dones
        with th.no_grad():
            last_value = policy.critic(policy.normalized(observations)).flatten().numpy()
        values = np.append(th.stack(rollout["values"]).numpy(), last_value[None], axis=0)
        advantages, advantage = np.zeros_like(rewards), np.zeros(num_envs, np.float32)
        for index in reversed(range(num_steps)):
            alive = 1 - ends[index + 1]
            delta = rewards[index] + 0.99 * values[index + 1] * alive - values[index]
            advantages[index] = advantage = delta + 0.99 * 0.95 * alive * advantage
        data = [th.stack(column).flatten(0, 1) for column in rollout.values()]
        returns = th.as_tensor(advantages + values[:-1]).flatten()
        for _ in range(epochs):
            for indices in th.randperm(batch_size).split(size):
                batch = [column[indices] for column in (*data, th.as_tensor(advantages).flatten(), returns)]
                optimizer.zero_grad()
                _ppo_loss(policy, batch, entropy_weight).backward()
                nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
                optimizer.step()
    env.close()
    return Trained(policy, step)


def _ppo_loss(policy: PpoPolicy, batch: Sequence[th.Tensor], entropy_weight: float) -> th.Tensor:
    """The loss of a batch: inputs, actions, logarithms of their probabilities, values, advantages and returns."""
    inputs, actions, log_probs, old_values, advantages, returns = batch
    distribution = policy.distribution(inputs)
    ratio = (policy.log_probability(distribution, actions) - log_probs).exp()
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    policy_loss = th.max(-advantages * ratio, -advantages * ratio.clip(0.8, 1.2)).mean()
    values = policy.critic(inputs).flatten()
    clipped = old_values + (values - old_values).clip(-0.2, 0.2)
    value_loss = 0.5 * th.max((values - returns) ** 2, (clipped - returns) ** 2).mean()
    return policy_loss + 0.5 * value_loss - entropy_weight * distribution.entropy().mean()


class _RewardScale:
    """Divides rewards by the running standard deviation of the discounted return, as Gymnasium's NormalizeReward."""

    def __init__(self, num_envs: int) -> None:
        self._returns, self._statistics = np.zeros(num_envs), RunningMeanStd(shape=())

    def __call__(self, rewards: np.ndarray, dones: np.ndarray) -> np.ndarray:
        self._returns = self._returns * 0.99 * (1 - dones) + rewards
        self._statistics.update(self._returns)
        return np.clip(rewards / np.sqrt(self._statistics.var + 1e-8), -10, 10)
