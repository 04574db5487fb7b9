"""Whatever an agent learns with, its export acts as it does: memories, frames, images, quantiles, other units."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th

from tb2rl.core.errors import InputError
from tb2rl.deploy.graph import graph_of
from tb2rl.deploy.network import OBSERVATION, network_of, parts_of
from tb2rl.envs.encodings import stacked
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.layers import resolve
from tb2rl.runs.normalisation import driving_policy

RAW = {"task.observation": "raw"}
NEAR = {**RAW, "agent.policy_kwargs.features_extractor_class": "tb2rl.envs.features:InverseRange"}
BUFFER = {"agent.buffer_size": 10}
AGENTS = {
    "frame_stack": ("ppo", "maze", {"task.frame_stack": 3}),
    "normalised": ("stable_baselines3:PPO", "wall", {**RAW, "train.norm_obs": True}),
    "classes": ("stable_baselines3:DQN", "wall", {**BUFFER, "task.observation": "discrete"}),
    "ELU": ("ppo", "maze", {"agent.policy_kwargs.activation_fn": "torch.nn:ELU"}),
    "LeakyReLU": ("ppo", "maze", {"agent.policy_kwargs.activation_fn": "torch.nn:LeakyReLU"}),
    "Sigmoid": ("ppo", "maze", {"agent.policy_kwargs.activation_fn": "torch.nn:Sigmoid"}),
    "A2C": ("stable_baselines3:A2C", "drive", NEAR),
    "DDPG": ("stable_baselines3:DDPG", "drive", {**BUFFER, **NEAR}),
    "SAC, noise by state": ("sac", "drive", {**BUFFER, "agent.use_sde": True}),
    "PPO, squashed": (
        "ppo",
        "drive",
        {"agent.use_sde": True, "agent.policy_kwargs.squash_output": True},
    ),
    "QR-DQN": ("sb3_contrib:QRDQN", "maze", {**BUFFER, **NEAR}),
    "TQC": ("sb3_contrib:TQC", "drive", {**BUFFER, **NEAR}),
    "TRPO": ("sb3_contrib:TRPO", "maze", NEAR),
}
IMAGES = {
    "an image": {"task.observe": [{"camera": {"depth": True, "width": 36, "height": 36}}]},
    "two frames of an image": {"task.observe": [{"camera": {"width": 36, "height": 36}}], "task.frame_stack": 2},
    "an image beside numbers": {"task.observe": ["laser", {"camera": {"width": 36, "height": 36}}]},
    "normalised beside an image": {
        "task.observe": ["laser", {"camera": {"width": 36, "height": 36}}],
        "train.norm_obs": True,
    },
}


def random_policy(agent, task, settings):
    """An algorithm that nobody trained: large random weights tell layers apart, and act in many ways."""
    pytest.importorskip("sb3_contrib")
    config = resolve(agent, task, settings={"train.n_envs": 2, **settings})
    algorithm = make_algorithm(config, Spaces.vectorised(config))
    th.manual_seed(0)
    with th.no_grad():
        for name, weights in algorithm.policy.named_parameters():
            large = 1.0 if "lstm" in name else 2.0 * weights.shape[-1] ** -0.5
            weights.normal_(0.0, large if weights.ndim > 1 else 0.1)
    env, rng = algorithm.get_vec_normalize_env(), np.random.default_rng(0)
    for met in env.obs_rms.values() if env and isinstance(env.obs_rms, dict) else [env.obs_rms] if env else []:
        met.mean, met.var = rng.uniform(0.0, 9.0, met.mean.shape), rng.uniform(0.1, 9.0, met.var.shape)
    algorithm.policy = driving_policy(algorithm)
    return algorithm, config.scene.actions


def session(algorithm, actions):
    """The graph of an algorithm in onnxruntime."""
    onnxruntime = pytest.importorskip("onnxruntime")
    model = graph_of(network_of(algorithm), parts_of(algorithm.observation_space), actions, {})
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])


def samples(algorithm, count):
    algorithm.observation_space.seed(0)
    return stacked([algorithm.observation_space.sample() for _ in range(count)])


def assert_same(got, expected):
    assert (got.dtype, got.shape) == (expected.dtype, expected.shape)
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-5 if expected.dtype.kind == "f" else 0.0)


@pytest.mark.parametrize("kind", AGENTS)
def test_an_exported_network_acts_the_same(kind, runner):
    algorithm, actions = random_policy(*AGENTS[kind])
    observations = samples(algorithm, 1_000)
    expected, _ = algorithm.predict(observations, deterministic=True)
    assert len(np.unique(expected, axis=0)) > 1
    assert_same(session(algorithm, actions).run(["action"], {OBSERVATION: observations})[0], expected)
    assert_same(runner(algorithm)(observations), expected)


@pytest.mark.parametrize("layers", [1, 2])
def test_an_exported_memory_remembers_the_same(layers, runner):
    sizes = {"agent.policy_kwargs.lstm_hidden_size": 8, "agent.policy_kwargs.n_lstm_layers": layers}
    algorithm, actions = random_policy("recurrent_ppo", "maze", sizes)
    steps = samples(algorithm, 1_000).reshape(20, 50, -1)  # of 50 robots
    onnx, numpy, memory = session(algorithm, actions), runner(algorithm), None
    given = {each.name: np.zeros((1, 50, 8), np.float32) for each in onnx.get_inputs()[1:]}
    assert len(given) == 2 * layers
    acted = []
    for observations in steps:
        expected, memory = algorithm.predict(observations, memory, deterministic=True)
        action, _, *after = onnx.run(None, {OBSERVATION: observations, **given})
        given = dict(zip(given, after, strict=True))
        assert_same(action, expected)
        assert_same(numpy(observations), expected)
        acted.append(expected)
    numpy.begin()
    assert_same(numpy(steps[0]), acted[0])
    fresh, _ = algorithm.predict(steps[-1], deterministic=True)
    assert (fresh != acted[-1]).any(), "the memory matters"


@pytest.mark.parametrize("kind", IMAGES)
def test_a_graph_reads_images(kind):
    algorithm, actions = random_policy("stable_baselines3:PPO", "maze", {**RAW, **IMAGES[kind]})
    observations = samples(algorithm, 50)
    expected, _ = algorithm.predict(observations, deterministic=True)
    given = observations if isinstance(observations, dict) else {OBSERVATION: observations}
    assert_same(session(algorithm, actions).run(["action"], given)[0], expected)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"agent.policy_kwargs.activation_fn": "torch.nn:GELU"}, ["GELU", "ReLU, "]),
        ({"agent.policy_kwargs.features_extractor_class": "my_features:Doubled", **RAW}, ["Doubled", "InverseRange"]),
    ],
)
def test_what_is_not_known_is_refused(settings, words):
    algorithm, _ = random_policy("stable_baselines3:PPO", "maze", settings)
    with pytest.raises(InputError) as refused:
        network_of(algorithm)
    assert [word for word in words if word not in str(refused.value)] == []


def test_batch_renormalisation_is_refused():
    algorithm, _ = random_policy("sb3_contrib:CrossQ", "drive", RAW)
    with pytest.raises(InputError, match="BatchRenorm1d"):
        network_of(algorithm)
