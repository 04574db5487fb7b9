"""A training from its arguments to its run folder, and back from there."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
import torch as th
import yaml
from stable_baselines3.common.vec_env import DummyVecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl import evaluate, load, make_env, train, training
from tb2rl.callbacks import StopOnInterrupt, tutorial_scores
from tb2rl.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.config import resolve
from tb2rl.errors import InputError
from tb2rl.evaluation import TRAINING_SEED, Evaluator
from tb2rl.processes import ProcessVecEnv
from tb2rl.registry import agent_names, find_agent
from tb2rl.runs import Run

command = import_module("tb2rl.train")  # `from tb2rl import train` is the function
LEARNERS = [name for name in agent_names() if find_agent(name).algorithm is not None]
SOON = {"dqn": {"agent.learning_starts": 900}}  # what an agent needs to have learnt something when QUICK ends
QUICK = {"total_timesteps": 1024, "n_envs": 2, "eval_freq": 512, "eval_episodes": 3, "eval_steps": 60, "save_freq": 512}
BARE = {"total_timesteps": 300, "n_envs": 1, "eval_freq": 0, "save_freq": 0}


class Trained:
    """A quick training, and what its policy's parameters were at the start, in each evaluation and at the end."""

    def __init__(self, agent: str, folder, patch: pytest.MonkeyPatch) -> None:
        make, run = training.make_algorithm, Evaluator.run

        def make_algorithm(*arguments):
            self.algorithm = make(*arguments)
            self.start = parameters(self.algorithm.policy)
            return self.algorithm

        def evaluate(evaluator, policy):
            self.evaluated.append(parameters(policy))
            return run(evaluator, policy)

        patch.setattr(training, "make_algorithm", make_algorithm)
        patch.setattr(Evaluator, "run", evaluate)
        self.folder, self.evaluated = folder, []
        train(agent, settings=SOON.get(agent), folder=folder, **QUICK)
        self.end = parameters(self.algorithm.policy)


@pytest.fixture(scope="module", params=LEARNERS)
def trained(request, tmp_path_factory):
    """A quick training of each agent."""
    with pytest.MonkeyPatch.context() as patch:
        return Trained(request.param, tmp_path_factory.mktemp(request.param) / "run", patch)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A checkpoint of the tabular learner."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train("qlearn", folder=folder, **BARE)
    return folder / "final" / "policy.safetensors"


def parameters(policy: th.nn.Module) -> dict[str, list]:
    return {name: value.tolist() for name, value in policy.state_dict().items()}


def evaluations(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]


def table(folder, place: str = "final/policy.safetensors") -> np.ndarray:
    return load(folder / place).policy.q.numpy()


def random_observations(space, count: int = 300) -> np.ndarray:
    space.seed(0)
    return np.array([space.sample() for _ in range(count)])


# ---- the run folder


def test_a_run_folder_holds_what_it_should_and_nothing_else(trained):
    folder = trained.folder
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    (events,) = [file for file in files if file.startswith("tensorboard/events.out.tfevents")]
    checkpoints = {"checkpoints/step-0000000512.safetensors", "checkpoints/step-0000001024.safetensors"}
    expected = {
        ".lock",
        "config.yaml",
        "best/policy.safetensors",
        "final/policy.safetensors",
        "evaluations.jsonl",
        events,
        *checkpoints,
    }
    assert files == expected


def test_the_config_of_a_run_is_the_one_that_was_resolved(trained):
    folder = trained.folder
    config = Run.open(folder).config
    train_settings = {f"train.{key}": value for key, value in QUICK.items()}
    assert config == resolve(config.agent, settings={**SOON.get(config.agent, {}), **train_settings})
    assert load(folder).trained_with == config
    versions = yaml.safe_load((folder / "config.yaml").read_text())["versions"]
    assert versions["torch"] == th.__version__
    assert {"python", "tb2rl", "stable-baselines3", "pybullet"} <= versions.keys()
    assert load(folder / "final" / "policy.safetensors").num_timesteps == trained.algorithm.num_timesteps == 1024


def test_a_loaded_policy_acts_as_the_trained_one_did(trained):
    again = load(trained.folder / "final" / "policy.safetensors")
    observations = random_observations(again.observation_space)
    actions = [algorithm.predict(observations, deterministic=True)[0] for algorithm in (again, trained.algorithm)]
    np.testing.assert_array_equal(*actions)
    assert parameters(again.policy) == trained.end != trained.start


def test_a_run_stands_for_its_best_policy(trained):
    lines = evaluations(trained.folder)
    scores = [(line["success_rate"], line["mean_return"]) for line in lines]
    assert [line["best"] for line in lines] == [score > max(scores[:i], default=()) for i, score in enumerate(scores)]
    best = scores.index(max(scores))
    policy = load(trained.folder)
    assert (policy.num_timesteps, parameters(policy.policy)) == (lines[best]["timesteps"], trained.evaluated[best])


def test_the_best_policy_reproduces_the_figures_that_were_logged(trained):
    logged = [line for line in evaluations(trained.folder) if line["best"]][-1]
    conditions = {"episodes": QUICK["eval_episodes"], "steps": QUICK["eval_steps"], "seed": TRAINING_SEED}
    again = json.loads(json.dumps(evaluate(trained.folder, workers=1, **conditions).summary()))
    assert again == {key: logged[key] for key in again}


def test_the_last_evaluation_is_of_the_final_policy(trained):
    assert evaluations(trained.folder)[-1]["timesteps"] == 1024
    assert trained.evaluated[-1] == trained.end


def test_the_environment_of_a_policy_is_the_one_that_it_was_trained_in(trained):
    policy = load(trained.folder)
    env = make_env(policy, maze="circuit")
    assert (env.observation_space, env.action_space) == (policy.observation_space, policy.action_space)
    assert (env.maze.name, env.task.episode_steps) == ("circuit", policy.trained_with.task_settings.episode_steps)
    observation, _ = env.reset(seed=0)
    env.step(policy.predict(observation, deterministic=True)[0])
    env.close()


def test_tensorboard_shows_scalars_paths_and_hyperparameters(trained):
    folder = trained.folder
    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    scalars = {"rollout/crash_rate", "rollout/distance_mean", "eval/crash_free_rate", "eval/mean_return", "eval/score"}
    assert scalars <= set(events.Tags()["scalars"])
    shown = {event.step: event.value for event in events.Scalars("eval/mean_return")}
    assert shown == {line["timesteps"]: pytest.approx(line["mean_return"]) for line in evaluations(folder)}
    assert events.Tags()["images"] == ["eval/paths"]
    hyperparameters = events.PluginTagToContent("hparams")["_hparams_/session_start_info"]
    assert b"agent.name" in hyperparameters
    assert Run.open(folder).config.agent.encode() in hyperparameters


def test_training_returns_what_load_gives(tmp_path):
    policy = train("qlearn", folder=tmp_path / "run", **BARE)
    again = load(tmp_path / "run")
    assert th.equal(policy.policy.q, again.policy.q)
    assert policy.trained_with == again.trained_with


def test_the_command_leaves_the_standard_evaluation_in_the_run_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command.main(["--name", "it", "--total-timesteps", "16", "--n-envs", "1", "--eval-freq", "0"])
    written = json.loads((tmp_path / "runs/maze/qlearn/it/evaluation.json").read_text())
    assert (written["episodes"], written["steps"], len(written["each"])) == (100, 1500, 100)
    out = capsys.readouterr().out
    assert "runs/maze/qlearn/it" in out
    assert "trained 16 steps" in out
    assert f"{100 * written['crash_free_rate']:.1f} %" in out


def test_runs_without_a_name_do_not_collide(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = resolve("stable_baselines3:A2C", "wall")
    folders = []
    for _ in range(3):
        folders.append(training.default_folder(config))
        folders[-1].mkdir(parents=True)
    assert len(set(folders)) == 3
    assert {str(folder.parent) for folder in folders} == {"runs/wall/A2C"}


def test_an_existing_folder_is_left_alone(checkpoint):
    before = checkpoint.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        train("qlearn", folder=checkpoint.parent.parent, **BARE)
    assert checkpoint.read_bytes() == before


# ---- files that are no checkpoints


@pytest.mark.parametrize("size", [0, 1, 100, 0.5, -10])
def test_a_truncated_checkpoint_is_refused(size, checkpoint, tmp_path):
    content = checkpoint.read_bytes()
    size = int(size * len(content)) if isinstance(size, float) else size
    (tmp_path / "policy.safetensors").write_bytes(content[:size])
    with pytest.raises(InputError, match=r"policy\.safetensors is not a checkpoint"):
        load(tmp_path / "policy.safetensors")


@pytest.mark.parametrize(
    "content", [b"hello world\n", b"\x80\x02}q\x00.", b"\x00" * 1000, b"PK\x03\x04", b"}", b"I1\n."]
)
def test_any_other_file_is_refused(content, tmp_path):
    (tmp_path / "policy.safetensors").write_bytes(content)
    with pytest.raises(InputError, match=r"policy\.safetensors is not a checkpoint"):
        load(tmp_path / "policy.safetensors")


@pytest.mark.parametrize(
    "change",
    [
        {"config": None},
        {"config": {}},
        {"config": {"agent": {"name": "qlearn"}}},
        {"timesteps": None},
        {"timesteps": "many"},
        {"policy": None},
        {"policy": {}},
        {"policy": [1]},
        {"policy": {"q": "q"}},
        {"policy": {"q": np.zeros((2, 3)), "visits": np.zeros((2, 3))}},
        {"policy": {"pairs": np.zeros((1, 1), dtype=int), "q": np.zeros((1, 1)), "visits": np.ones((1, 1), dtype=int)}},
    ],
    ids=str,
)
def test_a_checkpoint_whose_content_does_not_fit_is_refused(change, checkpoint, tmp_path):
    content = {**read_checkpoint(checkpoint), **change}
    write_checkpoint(
        tmp_path / "policy.safetensors", {key: value for key, value in content.items() if value is not None}
    )
    with pytest.raises(InputError) as refused:
        load(tmp_path / "policy.safetensors")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", [name for name in LEARNERS if name != "qlearn"])
def test_another_agents_checkpoint_is_refused(name, checkpoint, tmp_path):
    content = read_checkpoint(checkpoint)
    write_checkpoint(tmp_path / "policy.safetensors", {**content, "config": resolve(name).to_dict()})
    with pytest.raises(InputError, match="does not fit its config"):
        load(tmp_path / "policy.safetensors")


def test_a_file_that_stable_baselines_saved_is_refused(checkpoint, tmp_path):
    load(checkpoint).save(tmp_path / "policy.zip")
    with pytest.raises(InputError, match="is not a checkpoint"):
        load(tmp_path / "policy.zip")


@pytest.mark.parametrize("config", ["", "- 1", "agent: 3\ntask: {name: maze}", "agent: {name: qlearn}", "{", None])
def test_a_folder_that_is_no_run_is_refused(config, tmp_path):
    if config is not None:
        (tmp_path / "config.yaml").write_text(config)
    with pytest.raises(InputError, match=re.escape(str(tmp_path))):
        load(tmp_path)


def test_a_run_without_a_checkpoint_yet_says_so(tmp_path):
    Run.create(tmp_path / "run", resolve())
    with pytest.raises(InputError, match="no checkpoint yet"):
        load(tmp_path / "run")


@pytest.mark.parametrize("reference", ["no/such/run", "zoo:no-such-policy"])
def test_an_unknown_reference_is_refused(reference):
    with pytest.raises(InputError, match=reference.removeprefix("zoo:")):
        load(reference)


def test_a_run_without_evaluations_stands_for_its_last_checkpoint(checkpoint, tmp_path):
    run = Run.create(tmp_path / "run", resolve())
    algorithm = load(checkpoint)
    for algorithm.num_timesteps in (900, 1000):
        run.save(algorithm, f"checkpoints/step-{algorithm.num_timesteps:010d}")
    assert load(run.folder).num_timesteps == 1000
    algorithm.num_timesteps = 2000
    run.save(algorithm, "final/policy")
    assert load(run.folder).num_timesteps == 2000


# ---- worlds, seeds, rewards, episodes


@pytest.mark.parametrize(("worlds", "kind"), [(1, DummyVecEnv), (3, ProcessVecEnv)])
def test_equal_seeds_give_equal_tables_and_others_do_not(worlds, kind, tmp_path, monkeypatch):
    made = []
    make = training.make_vec_env
    monkeypatch.setattr(training, "make_vec_env", lambda config: made.append(make(config)) or made[-1])
    for name, seed in (("one", 5), ("two", 5), ("other", 6)):
        train("qlearn", seed=seed, folder=tmp_path / name, **{**BARE, "n_envs": worlds})
    assert {type(env) for env in made} == {kind}
    np.testing.assert_array_equal(table(tmp_path / "one"), table(tmp_path / "two"))
    assert not np.array_equal(table(tmp_path / "one"), table(tmp_path / "other"))


def test_the_number_of_processors_changes_nothing_but_the_time(tmp_path, monkeypatch):
    for processors in (1, 3):
        monkeypatch.setattr("tb2rl.processes.processors", lambda n=processors: n)
        train("qlearn", folder=tmp_path / str(processors), **{**BARE, "n_envs": 3})
    np.testing.assert_array_equal(table(tmp_path / "1"), table(tmp_path / "3"))


def test_the_scale_of_the_reward_is_for_the_agent_alone(tmp_path, capsys):
    quick = {"agent": "qlearn", **BARE, "eval_freq": 150, "eval_episodes": 2, "eval_steps": 20, "verbose": 1}
    printed = []
    for scale in (1.0, 0.5):  # powers of two leave every rounding as it is
        train(folder=tmp_path / str(scale), reward_scale=scale, **quick)
        printed.append(re.findall(r"Reward: (-?\d+) - Steps: (\d+)", capsys.readouterr().out))
    np.testing.assert_array_equal(table(tmp_path / "0.5"), 0.5 * table(tmp_path / "1.0"))
    assert printed[0] == printed[1] != []
    unscaled, scaled = (evaluations(tmp_path / name) for name in ("1.0", "0.5"))
    assert [line["mean_return"] for line in scaled] == [line["mean_return"] for line in unscaled]


@pytest.mark.parametrize("worlds", [1, 2])
def test_training_stops_after_the_episodes_that_were_asked_for(worlds, tmp_path):
    settings = {"train.episodes": 5, "train.total_timesteps": 10**9, "train.n_envs": worlds, "train.eval_freq": 0}
    done = training.train_config(resolve("qlearn", settings=settings), tmp_path / "run")
    assert 5 <= len(done.lengths) <= 5 + worlds - 1, "several worlds may end an episode at once"
    assert worlds * sum(done.lengths) >= done.timesteps >= sum(done.lengths)


def test_training_may_have_a_time_limit_of_its_own(tmp_path):
    settings = {f"train.{key}": value for key, value in BARE.items()}
    config = resolve("qlearn", settings={**settings, "train.episode_steps": 4})
    assert max(training.train_config(config, tmp_path / "run").lengths) == 4
    assert load(tmp_path / "run").trained_with.task_settings.episode_steps > 4


def test_verbose_prints_the_tutorials_lines_and_scores(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    quick = ["--n-envs", "1", "--eval-freq", "0", "--no-evaluation"]
    command.main(["--preset", "tutorial", "--episodes", "3", "--name", "it", "-v", *quick])
    out = capsys.readouterr().out
    lines = re.findall(
        r"^EP: (\d+) - \[alpha: 0.1 - gamma: 0.7 - epsilon: ([\d.]+)\] - Reward: (-?\d+) - Steps: (\d+) - "
        r"Time: 0:00:\d\d$",
        out,
        re.MULTILINE,
    )
    assert [(int(number), float(epsilon)) for number, epsilon, _, _ in lines] == [
        (number, pytest.approx(0.9 * 0.999**number, abs=1e-4)) for number in (1, 2, 3)
    ]
    lengths = [int(steps) for *_, steps in lines]
    assert [int(total) for _, _, total, _ in lines] == [
        pytest.approx(total, abs=5 * steps) for total, steps in zip([-200] * 3, lengths, strict=True)
    ]
    assert out.splitlines()[-1] == tutorial_scores(lengths)


def test_the_scores_are_the_mean_length_and_the_mean_of_the_100_longest():
    assert tutorial_scores(range(1, 201)) == "overall score: 100.5 steps, best 100 score: 150.5 steps"
    assert tutorial_scores([3, 5]) == "overall score: 4.0 steps, best 2 score: 4.0 steps"
    assert tutorial_scores([]) == "no episode ended"


# ---- several seeds


def test_several_seeds_are_trained_judged_and_summed_up(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rates = iter([1.0, 0.5, 0.96])
    summary = {"mean_distance": 10.0}
    monkeypatch.setattr(command, "evaluate", lambda policy: SimpleNamespace(task=SimpleNamespace(maze="loop")))
    monkeypatch.setattr(command, "report", lambda *_: {**summary, "success_rate": next(rates)})
    monkeypatch.setattr(command, "keep", lambda *_: None)
    quick = ["--total-timesteps", "8", "--n-envs", "1", "--eval-freq", "0"]
    command.main(["--seeds", "3..5", "--name", "it", *quick])
    folder = tmp_path / "runs" / "maze" / "qlearn" / "it"
    assert [load(folder / f"seed-{seed}").seed for seed in (3, 4, 5)] == [3, 4, 5]
    figures = json.loads((folder / "seeds.json").read_text())
    assert (figures["seeds"], figures["failed"]) == ([3, 4, 5], [4])
    assert figures["success"]["mean"] == pytest.approx(0.82)
    low, high = figures["success"]["interval"]
    assert 0.5 <= low < 0.82 < high <= 1.0
    assert "failed (success below 95 %): 1 of 3: 4" in capsys.readouterr().out


@pytest.mark.parametrize(("text", "seeds"), [("0..4", [0, 1, 2, 3, 4]), ("7", [7]), ("3,1", [3, 1]), ("2..2", [2])])
def test_seeds_are_read_from_the_command_line(text, seeds):
    assert command.parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "4..2", "1,1", "-1", "a", "0..", "0..99999", "1.5"])
def test_seeds_that_are_none_are_refused(text):
    with pytest.raises(InputError, match=r"0\.\.4"):
        command.parse_seeds(text)


# ---- stopping


def test_ctrl_c_saves_the_policy_and_ends_well(tmp_path):
    arguments = ["--name", "it", "--total-timesteps", "1000000000", "--n-envs", "2", "--save-freq", "200"]
    evaluating = ["--eval-freq", "100", "--set", "train.eval_episodes=2", "train.eval_steps=5"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": tmp_path}
    process = subprocess.Popen(
        [sys.executable, "-m", "tb2rl.train", *arguments, *evaluating], **pipes, start_new_session=True
    )
    folder = tmp_path / "runs" / "maze" / "qlearn" / "it"
    deadline = time.monotonic() + 60
    while not list(folder.glob("checkpoints/*.safetensors")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, "")
    assert "stopping" in out
    assert load(folder / "final" / "policy.safetensors").num_timesteps >= 200
    assert not (folder / "evaluation.json").exists()


def test_a_second_ctrl_c_stops_at_once():
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt() as stop:
        assert stop._on_step()
        signal.raise_signal(signal.SIGINT)
        assert not stop._on_step()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
