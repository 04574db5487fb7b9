"""What an algorithm has learned comes back; arrays that do not fit write past nothing and are refused in one line."""

from __future__ import annotations

import shutil
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch as th

from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.runs.parameters import load_parameters, parameters_of
from tb2rl.training.training import resume

GLIDE = """
from tb2rl.tasks import Outcome, Task, Velocities

class Glide(Task):
    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"bump": after.bumped})
"""
SMALL = {"agent.policy_kwargs.net_arch": [8], "agent.buffer_size": 100, "task.observation": "raw"}
OPTIMISER = "training/others/policy.optimizer"
NAN, INF = float("nan"), float("inf")


@pytest.fixture
def make(tmp_path, monkeypatch):
    """A function that makes a small algorithm, untrained."""
    (tmp_path / "glide.py").write_text(GLIDE)
    monkeypatch.syspath_prepend(tmp_path)

    def made(agent, seed=0):
        config = resolve(agent, "glide:Glide", settings={**SMALL, "train.seed": seed})
        return make_algorithm(config, Spaces.vectorised(config))

    return made


@pytest.fixture
def make_sac(make):
    """A function that makes a small SAC, untrained."""
    return partial(make, "stable_baselines3:SAC")


@pytest.fixture
def make_crossq(make):
    """A function that makes a small CrossQ, which counts its steps, untrained."""
    return partial(make, "sb3_contrib:CrossQ")


def as_saved(algorithm, folder, **changes) -> dict:
    """What a checkpoint says of an algorithm."""
    parameters = parameters_of(algorithm)
    content = {"timesteps": 7, "policy": parameters.pop("policy"), "training": {**parameters, **changes}}
    write_checkpoint(folder / "it.safetensors", content)
    return read_checkpoint(folder / "it.safetensors")


def step(algorithm) -> None:
    """One update of everything that is learned."""
    for optimiser in (algorithm.actor.optimizer, algorithm.critic.optimizer, algorithm.ent_coef_optimizer):
        for group in optimiser.param_groups:
            for parameter in group["params"]:
                parameter.grad = th.ones_like(parameter)
        optimiser.step()


def test_everything_that_is_learned_comes_back(make_sac, tmp_path):
    one, other = make_sac(seed=0), make_sac(seed=1)
    step(one)
    load_parameters(other, as_saved(one, tmp_path), tmp_path / "it.safetensors")
    for _ in range(2):  # the optimisers remember, too, and still hold on to the parameters
        assert other.num_timesteps == 7
        assert th.equal(one.log_ent_coef, other.log_ent_coef)
        assert all(th.equal(value, other.policy.state_dict()[name]) for name, value in one.policy.state_dict().items())
        step(one)
        step(other)


def test_a_policy_comes_back_without_the_rest_of_its_training(make_sac, tmp_path):
    one, other = make_sac(seed=0), make_sac(seed=1)
    before = other.log_ent_coef.clone()
    step(one)
    load_parameters(other, {**as_saved(one, tmp_path), "training": None}, tmp_path)
    assert all(th.equal(value, other.policy.state_dict()[name]) for name, value in one.policy.state_dict().items())
    assert th.equal(other.log_ent_coef, before)


@pytest.mark.parametrize("tensors", [{}, {"log_ent_coef": np.zeros(3, np.float32)}, {"log_ent_coef": 3}, [], None])
def test_tensors_beside_the_policy_must_fit(tensors, make_sac, refused, tmp_path):
    algorithm = make_sac()
    content = as_saved(algorithm, tmp_path, tensors=tensors)
    message = refused(load_parameters, algorithm, content, tmp_path / "it.safetensors")
    assert message.startswith(f"{tmp_path / 'it.safetensors'} does not fit its config")


@pytest.mark.parametrize("value", [np.complex64(NAN), np.int64(2**62), np.float32(NAN), np.float32(1e30)])
def test_tensors_beside_the_policy_must_be_numbers_that_learning_leads_to(value, make_sac, refused, tmp_path):
    algorithm = make_sac()
    content = as_saved(algorithm, tmp_path, tensors={"log_ent_coef": np.array([value])})
    assert "does not fit its config" in refused(load_parameters, algorithm, content, tmp_path / "it.safetensors")


# ---- the policy's parameters


@pytest.mark.parametrize("value", [None, {}, [1], {"q": "q"}, {"q": np.zeros((2, 3))}, ...], ids=str)
def test_a_policy_of_another_form_is_refused(value, checkpoint, edited, refused, tmp_path):
    file = edited(checkpoint, tmp_path / "policy.safetensors", "policy", value)
    assert str(file) in refused(load, file)


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e30])
def test_weights_that_learning_does_not_lead_to_are_refused(value, checkpoint, edited, refused, tmp_path):
    def spoiled(policy):
        name = next(name for name, array in policy.items() if array.dtype.kind == "f" and array.size)
        policy[name].reshape(-1)[0] = value
        return policy

    file = edited(checkpoint, tmp_path / "policy.safetensors", "policy", spoiled)
    assert "weights that learning does not lead to" in refused(load, file)


@pytest.mark.parametrize("kind", [np.complex64, np.int64, np.int8, np.uint8, bool])
def test_weights_of_another_kind_are_refused(kind, checkpoint, edited, refused, tmp_path):
    def spoiled(policy):
        name = next(name for name, array in policy.items() if array.dtype.kind == "f" and array.size)
        return {**policy, name: policy[name].astype(kind)}

    file = edited(checkpoint, tmp_path / "policy.safetensors", "policy", spoiled)
    assert "has another kind of numbers than the policy" in refused(load, file)


@pytest.mark.parametrize("value", [2**62, -(2**63)])
def test_counts_that_learning_does_not_lead_to_are_refused(value, make_crossq, refused, tmp_path):
    algorithm = make_crossq()
    content = as_saved(algorithm, tmp_path)
    steps = next(array for array in content["policy"].values() if array.dtype.kind == "i")
    steps[...] = value
    assert "weights that learning does not lead to" in refused(load_parameters, algorithm, content, tmp_path)


@pytest.mark.parametrize(
    ("pairs", "q", "visits"),
    [
        ([10**9], [0.0], [1]),
        ([-1], [0.0], [1]),
        ([3, 3], [0.0, 0.0], [1, 1]),
        ([4, 3], [0.0, 0.0], [1, 1]),
        ([3, 4], [0.0], [1, 1]),
        ([3], [0.0], [-1]),
        ([3], [0.0], [2**62]),
        ([[3]], [[0.0]], [[1]]),
    ],
)
def test_a_table_is_not_written_outside(pairs, q, visits, runs, edited, refused, tmp_path):
    table = {"pairs": np.array(pairs), "q": np.array(q), "visits": np.array(visits)}
    file = edited(Run.open(runs / "qlearn").checkpoints[0], tmp_path / "policy.safetensors", "policy", table)
    assert "does not fit its config" in refused(load, file)


# ---- the optimisers


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("state/0/exp_avg", lambda array: array[:1]),
        ("state/0/exp_avg", lambda array: np.repeat(array, 2, axis=0)),
        ("state/0/exp_avg_sq", lambda array: array[..., None]),
        ("state/0/exp_avg_sq", lambda array: array.ravel()),
        ("state/0/exp_avg", lambda _: np.zeros(0, np.float32)),
        ("state/0/step", lambda _: np.zeros(5, np.float32)),
        ("state/0/step", lambda _: np.array(NAN, np.float32)),
        ("state/0/exp_avg", lambda array: array.astype(np.complex64)),
        ("state/0/exp_avg", lambda array: array.astype(np.int64) + 2**62),
        ("state/0/exp_avg", lambda array: np.full_like(array, INF)),
        ("state/0/exp_avg", lambda array: array.tolist()),
        ("state/0/exp_avg", lambda _: "x"),
        ("param_groups/0/lr", NAN),
        ("state", lambda state: {**state, 99: state[0]}),
        ("state", lambda _: [1]),
        ("param_groups", lambda _: []),
        ("param_groups", lambda groups: groups * 2),
        ("param_groups/0/lr", ...),
        ("param_groups/0/lr", "x"),
        ("param_groups/0/lr", 10**400),
    ],
)
@pytest.mark.parametrize("agent", ["dqn", "ppo"])
def test_what_an_optimiser_remembers_must_fit_the_weights(agent, place, value, runs, edited, refused, tmp_path):
    """Compiled optimisers take the shapes for granted, and would write past an array's end."""
    run = Run.open(shutil.copytree(runs / agent, tmp_path / "run"))
    file = edited(run.checkpoints[0], run.checkpoints[0], f"{OPTIMISER}/{place}", value)
    assert refused(resume, run.folder).startswith(f"{file} does not fit its config")


@pytest.mark.parametrize(
    ("name", "value"), [("fused", True), ("betas", [2.0, 2.0]), ("params", [0, 0]), ("no_such", object)]
)
def test_how_an_optimiser_works_is_not_taken_from_a_file(name, value, make_sac, tmp_path):
    one, other = make_sac(), make_sac()
    content = as_saved(one, tmp_path)
    (group,) = content["training"]["others"]["actor.optimizer"]["param_groups"]
    group[name], group["lr"] = value, 0.125
    load_parameters(other, content, tmp_path)
    (theirs,), (ours,) = one.actor.optimizer.param_groups, other.actor.optimizer.param_groups
    assert ours["lr"] == 0.125
    rest = {"lr", "params"}
    assert {k: v for k, v in ours.items() if k not in rest} == {k: v for k, v in theirs.items() if k not in rest}
    assert len(ours["params"]) == len(theirs["params"])


def test_whatever_stable_baselines_saves_is_saved(monkeypatch):
    """Names of an algorithm's own, which a new version or another library may bring."""
    algorithm = SimpleNamespace(policy=th.nn.Linear(1, 1), extra=th.nn.Linear(2, 1), scale=th.ones(3))
    algorithm._get_torch_save_params = lambda: (["policy", "extra"], ["scale"])
    parameters = parameters_of(algorithm)
    assert parameters["others"]["extra"].keys() == {"weight", "bias"}
    assert parameters["tensors"] == {"scale": algorithm.scale}
