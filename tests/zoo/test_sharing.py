"""A policy goes to the hub and comes back: the same policy, as data alone, with a card that the hub reads."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
import yaml

import tb2rl
from tb2rl.core.files import top_folder
from tb2rl.runs.layers import resolve
from tb2rl.training.training import train_config
from tb2rl.zoo.entry import entries
from tb2rl.zoo.sharing import card, environment_id

main = import_module("tb2rl.zoo.__main__").main

FILES = {"README.md", "config.json", "best/policy.safetensors", "evaluation.json", "evaluations.jsonl", "paths.png"}
TINY = {"train.simulation": "kinematic", "train.n_envs": 2, "train.total_timesteps": 64, "train.eval_freq": 0}
RECURRENT = {
    "agent.n_steps": 16,
    "agent.batch_size": 16,
    "agent.policy_kwargs.features_extractor_class": "stable_baselines3.common.torch_layers:FlattenExtractor",
    "agent.policy_kwargs.features_extractor_kwargs": None,
    "train.norm_obs": True,
}
ACT = """
import sys, numpy as np, tb2rl
policy, seen = tb2rl.load(sys.argv[1]), np.load(sys.argv[2])
np.save(sys.argv[3], policy.predict(seen, deterministic=True)[0])
"""


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


def metadata(card: bytes) -> dict:
    return yaml.safe_load(card.decode().split("---\n")[1])


@pytest.mark.parametrize("name", ["maze-loop-qlearn", "zoo:maze-loop-dqn", "drive-loop-sac"])
def test_a_policy_of_the_zoo_goes_out_and_comes_back(name, hub, capsys):
    main(["push", name, "ada/theirs"])
    assert capsys.readouterr().out == "hf:ada/theirs is on the hub; see it drive: python -m tb2rl.play hf:ada/theirs\n"
    assert hub.repositories["ada/theirs"][-1].keys() == FILES
    ours, theirs = tb2rl.load(f"zoo:{name.removeprefix('zoo:')}"), tb2rl.load("hf:ada/theirs")
    np.testing.assert_array_equal(actions(theirs), actions(ours))
    assert theirs.trained_with == ours.trained_with
    assert theirs.num_timesteps == ours.num_timesteps


def test_a_run_that_remembers_and_normalises_goes_out_and_comes_back(hub, tmp_path):
    pytest.importorskip("sb3_contrib")
    folder = run_of("recurrent_ppo", tmp_path, TINY | RECURRENT)
    main(["push", str(folder), "ada/theirs"])
    ours, theirs = tb2rl.load(folder), tb2rl.load("hf:ada/theirs")
    np.testing.assert_array_equal(actions(theirs), actions(ours))
    assert theirs.policy.predict(states(ours)[0])[1] is not None, "it has no memory"
    files = hub.repositories["ada/theirs"][-1]
    assert files.keys() == FILES - {"evaluations.jsonl", "paths.png"}
    assert not [path for path, content in files.items() if str(tmp_path).encode() in content], "whose machine it was"


@pytest.mark.slow
def test_it_is_loaded_in_another_process_and_the_token_is_nowhere(hub, tmp_path):
    env, folder = os.environ | {"HF_TOKEN": "hf_secret"}, tmp_path / "work"
    folder.mkdir()
    settings = {"env": env, "cwd": folder, "capture_output": True, "text": True, "check": True}
    push = ["-m", "tb2rl.zoo", "push", "maze-loop-dqn", "ada/theirs"]
    ours = tb2rl.load("zoo:maze-loop-dqn")
    np.save(tmp_path / "seen.npy", states(ours))
    load = ["-c", ACT, "hf:ada/theirs", str(tmp_path / "seen.npy"), str(tmp_path / "done.npy")]
    said = [subprocess.run([sys.executable, *arguments], **settings) for arguments in (push, load)]
    np.testing.assert_array_equal(np.load(tmp_path / "done.npy"), ours.predict(states(ours), deterministic=True)[0])
    assert "Bearer hf_secret" in hub.authorisations
    assert not [done for done in said if "hf_secret" in done.stdout + done.stderr]
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert not [file for file in files if b"hf_secret" in file.read_bytes()]
    assert b"hf_secret" not in b"".join(hub.repositories["ada/theirs"][-1].values())


@pytest.mark.parametrize(
    ("name", "environment", "rate"),
    [("maze-loop-ppo", "TurtleBot2MazeRaw-v0", "failure_free_rate"), ("wall-wall-qlearn", None, "success_rate")],
)
def test_the_card_has_what_the_hub_reads(name, environment, rate, hub):
    main(["push", name, "ada/theirs"])
    files = hub.repositories["ada/theirs"][-1]
    said, figures = metadata(files["README.md"]), json.loads(files["evaluation.json"])
    environment = environment or "TurtleBot2Wall-v0"
    assert said["library_name"] == "tb2rl"
    assert {"reinforcement-learning", "deep-reinforcement-learning", environment} <= set(said["tags"])
    (model,) = said["model-index"]
    (result,) = model["results"]
    assert result["task"]["type"] == "reinforcement-learning"
    assert result["dataset"] == {"name": environment, "type": environment}
    metrics = {metric["type"]: metric["value"] for metric in result["metrics"]}
    reward = f"{figures['mean_return']:.2f} +/- {figures['std_return']:.2f}"
    assert metrics == {"mean_reward": reward, rate: figures[rate]}
    assert b'tb2rl.load("hf:ada/theirs")' in files["README.md"]
    assert figures["policy"] == "hf:ada/theirs"


@pytest.mark.slow
@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry.name)
def test_every_policy_of_the_zoo_can_have_such_a_card(entry, hub):
    text = card(entry.config, entry.figures, "ada/theirs", has_picture=True)
    assert environment_id(entry.config) in metadata(text.encode())["tags"]


def test_a_policy_of_ones_own_module_is_shared_and_says_what_others_need(hub, tmp_path, monkeypatch, capsys):
    (tmp_path / "own_task.py").write_text(
        "from tb2rl.tasks.wander import Wander\n\nclass Mine(Wander):\n    pass\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    folder = run_of("qlearn", tmp_path, {**TINY, "task.name": "own_task:Mine"})
    main(["push", str(folder), "ada/theirs"])
    assert "others need the same modules, and --trust: hf:ada/theirs names the module 'own_task'" in (
        capsys.readouterr().out
    )
    assert "Mine" in metadata(hub.repositories["ada/theirs"][-1]["README.md"])["tags"]


def test_a_checkpoint_of_a_training_goes_without_what_it_goes_on_with(hub, tmp_path):
    folder = run_of("qlearn", tmp_path)
    shutil.rmtree(folder / "final")
    assert tb2rl.load(folder).num_timesteps == 64
    main(["push", str(folder), "ada/theirs"])
    files = hub.repositories["ada/theirs"][-1]
    assert tb2rl.load("hf:ada/theirs").num_timesteps == 64
    assert b"replay" not in files["best/policy.safetensors"]
    assert b'"training"' not in files["best/policy.safetensors"].replace(b"\\", b"")


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("push", "push NAME user/repository"),
        ("push maze-loop-dqn", "push NAME user/repository"),
        ("push maze-lop-dqn ada/theirs", "did you mean 'maze-loop-dqn'"),
        ("push {empty} ada/theirs", "not a run folder"),
        ("push {run} ada/theirs", "has no standard evaluation: run `python -m tb2rl.evaluate"),
        ("push {damaged} ada/theirs", "evaluation.json is not a standard evaluation"),
        ("push {lacking} ada/theirs", "evaluation.json is not a standard evaluation"),
        ("push {mapped} ada/theirs", "hall.yaml is a file of this machine"),
        ("push maze-loop-dqn theirs", "hf:user/repository"),
        ("push maze-loop-dqn ada/theirs@main", "without a revision"),
    ],
)
def test_what_cannot_be_shared_is_refused_in_one_line(line, named, hub, tmp_path, capsys):
    zoo = top_folder("zoo") / "maze-loop-dqn"
    places = {name: tmp_path / name for name in ("empty", "run", "damaged", "lacking", "mapped")}
    places["empty"].mkdir()
    for name in list(places)[1:]:
        shutil.copytree(zoo, places[name])
    (places["run"] / "evaluation.json").unlink()
    (places["damaged"] / "evaluation.json").write_text("{")
    (places["lacking"] / "evaluation.json").write_text('{"episodes": 3}')
    hall = shutil.copy(top_folder("configs") / "worlds" / "loop.yaml", tmp_path / "hall.yaml")
    config = places["mapped"] / "config.yaml"
    config.write_text(config.read_text().replace("world: loop", f"world: {hall}"))
    with pytest.raises(SystemExit, match="2"):
        main(line.format(**places).split())
    message = capsys.readouterr().err
    assert named in message
    assert message.count("\n") == 1
    assert not hub.repositories.get("ada/theirs")


@pytest.mark.parametrize(
    ("refuses", "named"), [((401, ""), "HF_TOKEN"), ((403, ""), "HF_TOKEN"), ((500, ""), "status 500")]
)
def test_what_the_hub_does_not_take_is_one_line_without_the_token(refuses, named, hub, monkeypatch, capsys):
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    hub.refuses = refuses
    with pytest.raises(SystemExit, match="2"):
        main(["push", "maze-loop-dqn", "ada/theirs"])
    message = capsys.readouterr().err
    assert named in message
    assert message.count("\n") == 1
    assert "Bearer hf_secret" in hub.authorisations
    assert "hf_secret" not in message


def test_a_token_that_no_header_can_hold_is_not_shown_either(hub, monkeypatch, capsys):
    monkeypatch.setenv("HF_TOKEN", "hf_secr\u00e9t")
    with pytest.raises(SystemExit, match="2"):
        main(["push", "maze-loop-dqn", "ada/theirs"])
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "hf_sec" not in message
