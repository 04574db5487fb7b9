"""A policy goes to the hub and comes back: the same policy, as data alone, with a card that the hub reads."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import tb2rl
from tb2rl.core.files import top_folder
from tb2rl.runs.config import resolve
from tb2rl.training.training import train_config

FILES = {"README.md", "config.json", "best/policy.safetensors", "evaluation.json", "evaluations.jsonl", "paths.png"}
TINY = {"train.simulation": "kinematic", "train.n_envs": 2, "train.total_timesteps": 64, "train.eval_freq": 0}
RECURRENT = {
    "agent.n_steps": 16,
    "agent.batch_size": 16,
    "agent.policy_kwargs.features_extractor_class": "stable_baselines3.common.torch_layers:FlattenExtractor",
    "agent.policy_kwargs.features_extractor_kwargs": None,
    "train.norm_obs": True,
}


def run_of(agent: str, folder, settings=TINY):
    """A run that learned next to nothing, with the figures of another one."""
    run = train_config(resolve(agent, settings=settings), folder / "run").run
    shutil.copy(top_folder("zoo") / "maze-loop-ppo" / "evaluation.json", run.folder)
    return run.folder


def states(policy) -> np.ndarray:
    policy.observation_space.seed(0)
    return np.stack([policy.observation_space.sample() for _ in range(200)])


def actions(policy) -> list[np.ndarray]:
    """What a policy does in 200 states, one after the other: it may remember."""
    taken, memory = [], None
    for number, seen in enumerate(states(policy)):
        action, memory = policy.predict(seen, memory, np.array([number % 50 == 0]), deterministic=True)
        taken.append(action)
    return taken


def metadata(files: dict[str, bytes]) -> dict:
    return yaml.safe_load(files["README.md"].decode().split("---\n")[1])


@pytest.mark.parametrize(
    ("name", "environment", "rate"),
    [
        ("maze-loop-qlearn", "TurtleBot2Maze-v0", "failure_free_rate"),
        ("zoo:wall-wall-dqn", "TurtleBot2WallRaw-v0", "success_rate"),
    ],
)
def test_a_policy_of_the_zoo_goes_out_and_comes_back_with_a_card(
    name, environment, rate, main, hub, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    main(["push", name, "ada/theirs"])
    said, files = capsys.readouterr(), hub.repositories["ada/theirs"][-1]
    assert said.out == "hf:ada/theirs is on the hub; see it drive: python -m tb2rl.play hf:ada/theirs\n"
    assert files.keys() == FILES
    ours, theirs = tb2rl.load(f"zoo:{name.removeprefix('zoo:')}"), tb2rl.load("hf:ada/theirs")
    np.testing.assert_array_equal(actions(theirs), actions(ours))
    assert (theirs.trained_with, theirs.num_timesteps) == (ours.trained_with, ours.num_timesteps)

    about, figures = metadata(files), json.loads(files["evaluation.json"])
    assert about["library_name"] == "tb2rl"
    assert {"reinforcement-learning", "deep-reinforcement-learning", environment} <= set(about["tags"])
    (model,) = about["model-index"]
    (result,) = model["results"]
    assert model["name"] == "theirs"
    assert result["task"]["type"] == "reinforcement-learning"
    assert result["dataset"] == {"name": environment, "type": environment}
    reward = f"{figures['mean_return']:.2f} +/- {figures['std_return']:.2f}"
    assert {metric["type"]: metric["value"] for metric in result["metrics"]} == {
        "mean_reward": reward,
        rate: figures[rate],
    }
    assert b'tb2rl.load("hf:ada/theirs")' in files["README.md"]
    assert figures["policy"] == "hf:ada/theirs"

    assert "Bearer hf_secret" in hub.authorisations
    written = [file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()]
    assert b"hf_secret" not in b"".join([*written, *files.values(), said.err.encode()])


@pytest.mark.slow
def test_a_run_that_remembers_and_normalises_goes_out_and_comes_back(main, hub, tmp_path):
    pytest.importorskip("sb3_contrib")
    folder = run_of("recurrent_ppo", tmp_path, TINY | RECURRENT)
    main(["push", str(folder), "ada/theirs"])
    ours, theirs = tb2rl.load(folder), tb2rl.load("hf:ada/theirs")
    np.testing.assert_array_equal(actions(theirs), actions(ours))
    assert theirs.policy.predict(states(ours)[0])[1] is not None, "it has no memory"


def test_a_checkpoint_of_a_training_at_ones_own_task_goes_without_its_state_and_says_what_others_need(
    main, hub, tmp_path, monkeypatch, capsys
):
    (tmp_path / "own_task.py").write_text("from tb2rl.tasks.wander import Wander\n\nclass Mine(Wander):\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    folder = run_of("qlearn", tmp_path, {**TINY, "task.name": "own_task:Mine"})
    shutil.rmtree(folder / "final")
    main(["push", str(folder), "ada/theirs"])
    need = "others need the same modules and --trust: hf:ada/theirs names the module 'own_task'"
    assert need in capsys.readouterr().out
    files = hub.repositories["ada/theirs"][-1]
    assert files.keys() == FILES - {"evaluations.jsonl", "paths.png"}
    assert not [path for path, content in files.items() if str(tmp_path).encode() in content], "whose machine it was"
    assert "Mine" in metadata(files)["tags"]
    assert tb2rl.load("hf:ada/theirs", trust=True).num_timesteps == 64
    assert b'"training"' not in files["best/policy.safetensors"].replace(b"\\", b"")


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("push maze-loop-dqn", "repository"),
        ("push maze-lop-dqn ada/theirs", "did you mean 'maze-loop-dqn'"),
        ("push empty ada/theirs", "not a run folder"),
        ("push unevaluated ada/theirs", "has no standard evaluation: run `python -m tb2rl.evaluate"),
        ("push damaged ada/theirs", "evaluation.json is not a standard evaluation"),
        ("push mapped ada/theirs", "hall.yaml is a local file"),
        ("push maze-loop-dqn theirs", "hf:user/repository"),
        ("push maze-loop-dqn ada/theirs@main", "without a revision"),
    ],
)
def test_what_cannot_be_shared_is_refused_in_one_line(line, named, main, hub, workdir, refused):
    (workdir / "empty").mkdir()
    for name in ("unevaluated", "damaged", "mapped"):
        shutil.copytree(top_folder("zoo") / "maze-loop-dqn", workdir / name)
    Path("unevaluated", "evaluation.json").unlink()
    Path("damaged", "evaluation.json").write_text('{"episodes": 3}')
    hall = shutil.copy(top_folder("configs") / "worlds" / "loop.yaml", workdir / "hall.yaml")
    config = Path("mapped", "config.yaml")
    config.write_text(config.read_text().replace("world: loop", f"world: {hall}"))
    refused(main, line, [named])
    assert not hub.repositories.get("ada/theirs")


@pytest.mark.parametrize(
    ("token", "refuses", "named"),
    [
        ("hf_secret", (403, ""), "token has the correct permissions"),
        ("hf_secret", (500, ""), "500 Internal Server Error"),
        ("hf_secr\u00e9t", None, "UnicodeEncodeError"),  # no header can hold it
    ],
)
def test_what_the_hub_does_not_take_is_one_line_without_the_token(
    token, refuses, named, main, hub, monkeypatch, refused
):
    monkeypatch.setenv("HF_TOKEN", token)
    hub.refuses = refuses
    assert "hf_sec" not in refused(main, "push maze-loop-dqn ada/theirs", [named])
    assert token.isascii() == (f"Bearer {token}" in hub.authorisations)
