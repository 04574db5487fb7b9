"""Each algorithm, network and observation acts the same as an ONNX graph and as a numpy network."""

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.torch_layers import FlattenExtractor

from tb2rl.commands.export import export_onnx
from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.deploy.graph import build_graph
from tb2rl.deploy.network import OBSERVATION, extract_network, observation_spaces
from tb2rl.deploy.portable.policy import Network
from tb2rl.envs.encodings import stack_observations
from tb2rl.runs.algorithm import make_algorithm, policy_with_normalization
from tb2rl.runs.config import resolve
from tb2rl.runs.loading import config_of

PPO, ACTIVATION = "stable_baselines3:PPO", "agent.policy_kwargs.activation_fn"
RAW = {"task.observation": "raw"}
INVERSE_RANGE = {**RAW, "agent.policy_kwargs.features_extractor_class": "tb2rl.envs.features:InverseRange"}
BUFFER = {"agent.buffer_size": 10}
AGENTS = {
    "frame stack, ELU": ("ppo", "maze", {"task.frame_stack": 3, ACTIVATION: "torch.nn:ELU"}),
    "normalised, LeakyReLU": (PPO, "wall", {**RAW, "train.norm_obs": True, ACTIVATION: "torch.nn:LeakyReLU"}),
    "classes": ("stable_baselines3:DQN", "wall", {**BUFFER, "task.observation": "discrete"}),
    "A2C, Sigmoid": ("stable_baselines3:A2C", "drive", {**INVERSE_RANGE, ACTIVATION: "torch.nn:Sigmoid"}),
    "DDPG": ("stable_baselines3:DDPG", "drive", {**BUFFER, **INVERSE_RANGE}),
    "SAC, gSDE": ("sac", "drive", {**BUFFER, "agent.use_sde": True}),
    "PPO, squashed": ("ppo", "drive", {"agent.use_sde": True, "agent.policy_kwargs.squash_output": True}),
    "PPO, bounded": ("ppo", "drive", {"agent.policy": "tb2rl.training.policies:BoundedPolicy"}),
    "QR-DQN": ("sb3_contrib:QRDQN", "maze", {**BUFFER, **INVERSE_RANGE}),
    "TQC": ("sb3_contrib:TQC", "drive", {**BUFFER, **INVERSE_RANGE}),
    "TRPO": ("sb3_contrib:TRPO", "maze", INVERSE_RANGE),
}
CAMERA = {"camera": {"width": 36, "height": 36}}
IMAGES = {
    "two frames": {"task.observe": [CAMERA], "task.frame_stack": 2},
    "beside a normalised laser": {"task.observe": ["laser", CAMERA], "train.norm_obs": True},
}
NAMES = sorted(entry.parent.name for entry in top_folder("zoo").glob("*/config.yaml"))


def random_policy(agent, task, settings):
    """An untrained algorithm; large random weights tell layers apart and lead to many actions."""
    pytest.importorskip("sb3_contrib")
    config = resolve(agent, task, settings={"train.n_envs": 2, **settings})
    algorithm = make_algorithm(config)
    th.manual_seed(0)
    with th.no_grad():
        for name, weights in algorithm.policy.named_parameters():
            large = 1.0 if "lstm" in name else 2.0 * weights.shape[-1] ** -0.5
            weights.normal_(0.0, large if weights.ndim > 1 else 0.1)
    env, rng = algorithm.get_vec_normalize_env(), np.random.default_rng(0)
    for met in env.obs_rms.values() if env and isinstance(env.obs_rms, dict) else [env.obs_rms] if env else []:
        met.mean, met.var = rng.uniform(0.0, 9.0, met.mean.shape), rng.uniform(0.1, 9.0, met.var.shape)
    algorithm.policy = policy_with_normalization(algorithm)
    return algorithm, config.scene.actions


def session(model):
    onnxruntime = pytest.importorskip("onnxruntime")
    return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


def graph_session(algorithm, actions):
    graph = build_graph(extract_network(algorithm), observation_spaces(algorithm.observation_space), actions, {})
    return session(graph.SerializeToString())


def samples(algorithm, count):
    algorithm.observation_space.seed(0)
    return stack_observations([algorithm.observation_space.sample() for _ in range(count)])


def assert_same(got, expected):
    """Named actions are equal; shares from -1 to 1 are within 1e-5."""
    assert (got.dtype, got.shape) == (expected.dtype, expected.shape)
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-5 if expected.dtype.kind == "f" else 0.0)


@pytest.mark.parametrize("kind", AGENTS)
def test_an_exported_network_acts_the_same(kind):
    algorithm, actions = random_policy(*AGENTS[kind])
    observations = samples(algorithm, 300)
    expected, _ = algorithm.predict(observations, deterministic=True)
    assert len(np.unique(expected, axis=0)) > 1
    assert_same(graph_session(algorithm, actions).run(["action"], {OBSERVATION: observations})[0], expected)
    assert_same(Network(extract_network(algorithm).sequence())(observations), expected)


def test_an_exported_lstm_keeps_the_same_state():
    sizes = {"agent.policy_kwargs.lstm_hidden_size": 8, "agent.policy_kwargs.n_lstm_layers": 2}
    algorithm, actions = random_policy("recurrent_ppo", "maze", sizes)
    steps = samples(algorithm, 1_000).reshape(20, 50, -1)  # of 50 robots
    onnx, network, memory = graph_session(algorithm, actions), Network(extract_network(algorithm).sequence()), None
    given = {each.name: np.zeros((1, 50, 8), np.float32) for each in onnx.get_inputs()[1:]}
    assert len(given) == 4
    actions_of_steps = []
    for observations in steps:
        expected, memory = algorithm.predict(observations, memory, deterministic=True)
        action, _, *state = onnx.run(None, {OBSERVATION: observations, **given})
        given = dict(zip(given, state, strict=True))
        assert_same(action, expected)
        assert_same(network(observations), expected)
        actions_of_steps.append(expected)
    network.reset()
    assert_same(network(steps[0]), actions_of_steps[0])
    fresh, _ = algorithm.predict(steps[-1], deterministic=True)
    assert (fresh != actions_of_steps[-1]).any(), "the state matters"


@pytest.mark.parametrize("kind", IMAGES)
def test_a_graph_reads_images(kind):
    algorithm, actions = random_policy(PPO, "maze", {**RAW, **IMAGES[kind]})
    observations = samples(algorithm, 20)
    expected, _ = algorithm.predict(observations, deterministic=True)
    given = observations if isinstance(observations, dict) else {OBSERVATION: observations}
    assert_same(graph_session(algorithm, actions).run(["action"], given)[0], expected)


class Doubled(FlattenExtractor):
    def forward(self, observations):
        return 2.0 * super().forward(observations)


def test_an_unknown_module_is_refused():
    algorithm, _ = random_policy(PPO, "drive", {**RAW, ACTIVATION: "torch.nn:GELU"})
    with pytest.raises(InputError, match=r"the type GELU cannot be exported, .* ReLU, "):
        extract_network(algorithm)
    algorithm, _ = random_policy(PPO, "drive", RAW)
    algorithm.policy.pi_features_extractor = Doubled(algorithm.observation_space)
    with pytest.raises(InputError, match="the type Doubled cannot"):
        extract_network(algorithm)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *[(name, 500) for name in ("drive-loop-ppo", "wall-wall-qlearn")],
        *[pytest.param(name, 10_000, marks=pytest.mark.slow) for name in NAMES],
    ],
)
def test_an_exported_policy_of_the_zoo_acts_the_same(name, count, loaded, tmp_path):
    policy = loaded(f"zoo:{name}")
    observations = samples(policy, count)
    expected, _ = policy.predict(observations, deterministic=True)
    export_onnx(f"zoo:{name}", tmp_path / "policy.onnx")
    action, command = session(tmp_path / "policy.onnx").run(["action", "command"], {OBSERVATION: observations})
    assert_same(action, expected)
    np.testing.assert_allclose(command, config_of(policy).scene.actions.commands(expected), rtol=0.0, atol=1e-5)
    network = Network(extract_network(policy).sequence())
    assert_same(network(observations), expected)
    each = np.concatenate([network(observations[index : index + 1]) for index in range(0, count, 10)])
    assert_same(each, expected[::10])  # one by one, as on a robot: other sums, rounded otherwise
