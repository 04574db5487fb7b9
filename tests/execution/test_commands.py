"""Commands that let Ray do their work come to what they come to without it."""

import json
from importlib import import_module
from pathlib import Path

import optuna
import pytest

from tb2rl.commands import evaluate as suite_command
from tb2rl.zoo import entry

evaluate, tune, zoo = (import_module(f"tb2rl.{name}") for name in ("evaluate", "tune", "zoo.__main__"))
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ray", "workdir")]

RAY = ["--on", "ray", "--workers", "2"]
SHORT = "train.n_envs=16 train.total_timesteps=5120 train.eval_freq=2560 train.eval_episodes=20 train.eval_steps=50"


def test_a_suite_by_ray_comes_to_the_same(small_suite, monkeypatch):
    monkeypatch.setattr(suite_command, "find_suite", lambda name, path: small_suite(name))
    words = ["--agent", "random", "--task", "navigate", "--set", "task.world=loop", "--suite", "unseen", "--json"]
    evaluate.main([*words, "here.json", "--workers", "1"])
    evaluate.main([*words, "there.json", *RAY])
    assert json.loads(Path("here.json").read_text()) == json.loads(Path("there.json").read_text())


def test_a_search_by_ray_comes_to_the_same():
    words = ["--agent", "qlearn", "--task", "wall", "--trials", "3", "--seeds", "1", "--fresh", "0", "--set"]
    words += [*SHORT.split(), "--sampler", "random", "--pruner", "none"]
    tune.main([*words, "--name", "here", "--workers", "1"])
    tune.main([*words, "--name", "there", *RAY])
    assert len(scores("here")) == 3
    assert scores("here") == scores("there")
    assert policies("here") == policies("there")


def scores(name: str) -> list[tuple]:
    study = optuna.load_study(study_name=name, storage=f"sqlite:///runs/tune/{name}/study.db")
    return [(trial.state, trial.value, trial.params) for trial in study.trials]


def policies(name: str) -> dict[Path, bytes]:
    """The content of the policies of a search."""
    folder = Path("runs/tune", name, "trials")
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.safetensors")}


def test_a_zoo_is_built_by_ray(workdir, monkeypatch):
    folder = workdir / "zoo"
    folder.mkdir()
    circles = "task.turn_speed=0.5 task.turn_rate=0.12"  # too large for any world: evaluations are over soon
    (folder / "recipes.yaml").write_text(f"mine: --agent qlearn --simulation kinematic --set {SHORT} {circles}\n")
    monkeypatch.setattr(entry, "top_folder", lambda name: folder)
    zoo.main(["build", *RAY])
    assert json.loads((folder / "mine" / "evaluation.json").read_text())["episodes"] == 100
    worlds = json.loads((folder / "mine" / "unseen_worlds.json").read_text())
    assert [*worlds] == ["circuit", "round", "maze", "mixed"]
    assert "[mine](mine/README.md)" in (folder / "README.md").read_text()
