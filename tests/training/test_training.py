"""A training from its config to its run folder, and the policies that load from it."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch as th
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl import evaluate, load, train
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names
from tb2rl.evaluation.evaluate import VALIDATION_SEED, Evaluator
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.tasks.wander import Wander
from tb2rl.training import training

LEARNERS = [name for name in agent_names() if find_agent(name).algorithm is not None]
LATE = {"agent.learning_starts": 400}  # to have learned something when QUICK ends
SOON = {
    "dqn": LATE,
    "sac": LATE,
    "td3": LATE,
    "ppo": {"agent.n_steps": 64, "agent.batch_size": 64},
    "recurrent_ppo": {"agent.n_steps": 64},
}
QUICK = {"simulation": "kinematic", "total_timesteps": 512, "n_envs": 2, "save_freq": 256}
QUICK |= {"eval_freq": 256, "eval_episodes": 3, "eval_steps": 60}
BARE = {"total_timesteps": 128, "n_envs": 1, "eval_freq": 0, "save_freq": 0, "simulation": "kinematic"}


class Trained:
    """A quick training, and its policy's parameters at the start, in each evaluation and at the end."""

    def __init__(self, agent: str, folder, patch: pytest.MonkeyPatch) -> None:
        make, run = training.make_algorithm, Evaluator.run

        def make_algorithm(*arguments):
            self.algorithm = make(*arguments)
            self.start = parameters(self.algorithm.policy)
            return self.algorithm

        def evaluate_it(evaluator, policy, *more):
            self.evaluated.append(parameters(policy))
            return run(evaluator, policy, *more)

        patch.setattr(training, "make_algorithm", make_algorithm)
        patch.setattr(Evaluator, "run", evaluate_it)
        self.folder, self.evaluated = folder, []
        train(agent, task_of(agent), settings=SOON.get(agent), folder=folder, **QUICK)
        self.end = parameters(self.algorithm.policy)


FAST = {"qlearn", "ppo", "sac"}


@pytest.fixture(scope="module", params=[pytest.param(n, marks=[] if n in FAST else pytest.mark.slow) for n in LEARNERS])
def trained(request, tmp_path_factory):
    """A quick training of each agent."""
    with pytest.MonkeyPatch.context() as patch:
        return Trained(request.param, tmp_path_factory.mktemp(request.param) / "run", patch)


def task_of(agent: str) -> str:
    return "drive" if find_agent(agent).actions == "continuous" else "maze"


def parameters(policy: th.nn.Module) -> dict[str, list]:
    return {name: value.tolist() for name, value in policy.state_dict().items()}


def test_a_run_folder_holds_its_files_and_its_resolved_config(trained):
    folder = trained.folder
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    (events,) = [file for file in files if file.startswith("tensorboard/events.out.tfevents")]
    policies = {"best/policy.safetensors", "final/policy.safetensors"}
    checkpoints = {f"checkpoints/step-{steps:010}.safetensors" for steps in (256, 512)}
    assert files == {".lock", "config.yaml", "evaluations.jsonl", events, *policies, *checkpoints}
    config, agent = Run.open(folder).config, Run.open(folder).config.agent_name
    train_settings = {f"train.{key}": value for key, value in QUICK.items()}
    assert config == resolve(agent, task_of(agent), settings={**SOON.get(agent, {}), **train_settings})
    assert load(folder).trained_with == config
    versions = yaml.safe_load((folder / "config.yaml").read_text())["versions"]
    assert versions["torch"] == th.__version__
    assert {"python", "tb2rl", "stable-baselines3", "pybullet"} <= versions.keys()


def test_a_loaded_policy_acts_as_the_trained_one(trained):
    again = load(trained.folder / "final" / "policy.safetensors")
    again.observation_space.seed(0)
    observations = np.array([again.observation_space.sample() for _ in range(300)])
    actions = [algorithm.predict(observations, deterministic=True)[0] for algorithm in (again, trained.algorithm)]
    np.testing.assert_array_equal(*actions)
    assert parameters(again.policy) == trained.end != trained.start
    assert again.num_timesteps == trained.algorithm.num_timesteps == 512


def test_a_run_stands_for_its_best_policy_which_reproduces_its_evaluation(trained, evaluations):
    lines = evaluations(Run.open(trained.folder))
    assert lines[-1]["timesteps"] == 512
    assert trained.evaluated[-1] == trained.end
    scores = [(line["success_rate"], line["mean_return"]) for line in lines]
    assert [line["best"] for line in lines] == [score > max(scores[:i], default=()) for i, score in enumerate(scores)]
    best = scores.index(max(scores))
    policy = load(trained.folder)
    assert (policy.num_timesteps, parameters(policy.policy)) == (lines[best]["timesteps"], trained.evaluated[best])
    conditions = {"episodes": QUICK["eval_episodes"], "steps": QUICK["eval_steps"], "seed": VALIDATION_SEED}
    again = evaluate(policy, workers=1, simulation=policy.trained_with.train.eval_simulation, **conditions).summary()
    assert {key: lines[best][key] for key in again} == {
        key: list(value) if isinstance(value, tuple) else value for key, value in again.items()
    }


@pytest.mark.parametrize("trained", ["qlearn"], indirect=True)
def test_tensorboard_shows_scalars_and_paths(trained, scalars, evaluations):
    run = Run.open(trained.folder)
    events = EventAccumulator(str(run.folder / "tensorboard")).Reload()
    wanted = {"rollout/failure_rate", "rollout/distance_mean"}
    wanted |= {"eval/failure_free_rate", "eval/success_rate", "eval/mean_return", "eval/score"}
    assert wanted <= set(events.Tags()["scalars"])
    shown = dict(scalars(run, "eval/mean_return"))
    assert shown == {line["timesteps"]: pytest.approx(line["mean_return"]) for line in evaluations(run)}
    assert events.Tags()["images"] == ["eval/paths"]


def test_a_task_may_be_given_as_its_class(tmp_path):
    policy = train("qlearn", Wander, folder=tmp_path / "run", **BARE)
    again = load(tmp_path / "run")
    assert policy.trained_with == again.trained_with
    assert (again.trained_with.task_name, type(again.trained_with.task)) == ("tb2rl.tasks.wander:Wander", Wander)


def test_a_run_has_a_name_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train(name="mine", **BARE)
    assert (tmp_path / "runs/maze/qlearn/mine/config.yaml").is_file()
    with pytest.raises(InputError, match=r"--name \(name=\) is '\.\./x'; give a folder name"):
        train(name="../x")
    with pytest.raises(InputError, match="folder= and name= exclude each other"):
        train(name="x", folder="y")
    folders = set()
    for _ in range(3):
        folder = training.default_folder(resolve("stable_baselines3:A2C", "wall"))
        folder.mkdir(parents=True)
        folders.add(folder)
    assert len(folders) == 3
    assert {str(folder.parent) for folder in folders} == {"runs/wall/A2C"}


def test_the_name_of_a_run_tells_what_was_chosen_on_every_file_system(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train("qlearn", settings={"task.beams": 5, "train.seed": 3}, **BARE)
    (folder,) = Path("runs/maze/qlearn").iterdir()
    settings = "beams=5-total_timesteps=128-n_envs=1-eval_freq=0"  # as many as fit, none is cut
    assert re.fullmatch(rf"seed=3-{settings}-\d{{8}}-\d{{6}}", folder.name)
    world = {"generator": "rooms", "file": 'a/b\\c: *?"<>|' + "x" * 300}
    name = training.default_folder(resolve(), chosen={"task.world": world, "preset": None}).name
    assert re.fullmatch(r"world=generator_rooms_file_a_b_c_[\w.+-]+", name)
    assert len(name) < 100


@pytest.mark.slow
@pytest.mark.parametrize("agent", LEARNERS)
def test_an_agent_learns_to_drive(agent, tmp_path):
    task = task_of(agent)
    fewer = {"train.eval_episodes": 100} if task == "drive" else {}  # no such training stops early
    policy = train(agent, task, simulation="kinematic", seed=7, settings=fewer, folder=tmp_path / "run")
    summary = evaluate(policy, episodes=40, steps=1000).summary()
    assert summary["failure_free_rate"] >= 0.95
    assert summary["mean_speed"] > 0.3, "it neither stands nor turns"
