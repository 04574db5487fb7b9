"""A training from its config to its run folder: what is in the folder, and which policy comes back from it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch as th
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl import evaluate, load, make_env, train
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names
from tb2rl.evaluation.evaluator import TRAINING_SEED
from tb2rl.evaluation.twin import TwinEvaluator
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.simulation import SIMULATIONS
from tb2rl.training import training

LEARNERS = [name for name in agent_names() if find_agent(name).algorithm is not None]
LATE = {"agent.learning_starts": 900}  # what an agent needs to have learned something when QUICK ends
SOON = {"dqn": LATE, "sac": LATE, "td3": LATE, "recurrent_ppo": {"agent.n_steps": 128}}
QUICK = {"total_timesteps": 1024, "n_envs": 2, "eval_freq": 512, "eval_episodes": 3, "eval_steps": 60, "save_freq": 512}
BARE = {"total_timesteps": 300, "n_envs": 1, "eval_freq": 0, "save_freq": 0}


class Trained:
    """A quick training, and what its policy's parameters were at the start, in each evaluation and at the end."""

    def __init__(self, agent: str, folder, patch: pytest.MonkeyPatch) -> None:
        make, run = training.make_algorithm, TwinEvaluator.run

        def make_algorithm(*arguments):
            self.algorithm = make(*arguments)
            self.start = parameters(self.algorithm.policy)
            return self.algorithm

        def evaluate_it(evaluator, policy, *more):
            self.evaluated.append(parameters(policy))
            return run(evaluator, policy, *more)

        patch.setattr(training, "make_algorithm", make_algorithm)
        patch.setattr(TwinEvaluator, "run", evaluate_it)
        self.folder, self.evaluated = folder, []
        train(agent, task_of(agent), settings=SOON.get(agent), folder=folder, **QUICK)
        self.end = parameters(self.algorithm.policy)


@pytest.fixture(scope="module", params=LEARNERS)
def trained(request, tmp_path_factory):
    """A quick training of each agent."""
    with pytest.MonkeyPatch.context() as patch:
        return Trained(request.param, tmp_path_factory.mktemp(request.param) / "run", patch)


def task_of(agent: str) -> str:
    """A task that the agent can learn."""
    return "drive" if find_agent(agent).actions == "continuous" else "maze"


def parameters(policy: th.nn.Module) -> dict[str, list]:
    return {name: value.tolist() for name, value in policy.state_dict().items()}


def evaluations(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]


def random_observations(space, count: int = 300) -> np.ndarray:
    space.seed(0)
    return np.array([space.sample() for _ in range(count)])


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
    config, agent = Run.open(folder).config, Run.open(folder).config.agent_name
    train_settings = {f"train.{key}": value for key, value in QUICK.items()}
    assert config == resolve(agent, task_of(agent), settings={**SOON.get(agent, {}), **train_settings})
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
    policy = load(trained.folder)
    with TwinEvaluator(policy.trained_with.scene, **conditions) as evaluator:
        again = json.loads(json.dumps(evaluator.run(policy.policy).summary()))
    assert again == {key: logged[key] for key in again}


def test_the_last_evaluation_is_of_the_final_policy(trained):
    assert evaluations(trained.folder)[-1]["timesteps"] == 1024
    assert trained.evaluated[-1] == trained.end


def test_the_environment_of_a_policy_is_the_one_that_it_was_trained_in(trained):
    policy = load(trained.folder)
    env = make_env(policy, world="circuit")
    assert (env.observation_space, env.action_space) == (policy.observation_space, policy.action_space)
    assert (env.scene.world.name, env.task.episode_steps) == ("circuit", policy.trained_with.task.episode_steps)
    observation, _ = env.reset(seed=0)
    env.step(policy.predict(observation, deterministic=True)[0])
    env.close()


def test_tensorboard_shows_scalars_paths_and_hyperparameters(trained, scalars):
    run = Run.open(trained.folder)
    events = EventAccumulator(str(run.folder / "tensorboard")).Reload()
    wanted = {"rollout/failure_rate", "rollout/distance_mean"}
    wanted |= {"eval/failure_free_rate", "eval/success_rate", "eval/mean_return", "eval/score"}
    assert wanted <= set(events.Tags()["scalars"])
    shown = dict(scalars(run, "eval/mean_return"))
    assert shown == {line["timesteps"]: pytest.approx(line["mean_return"]) for line in evaluations(run.folder)}
    assert all(0.0 <= rate <= 1.0 for _, rate in scalars(run, "rollout/failure_rate"))
    assert events.Tags()["images"] == ["eval/paths"]
    hyperparameters = events.PluginTagToContent("hparams")["_hparams_/session_start_info"]
    assert b"agent.name" in hyperparameters
    assert run.config.agent_name.encode() in hyperparameters


def test_training_returns_what_load_gives(tmp_path):
    policy = train("qlearn", folder=tmp_path / "run", **BARE)
    again = load(tmp_path / "run")
    assert th.equal(policy.policy.q, again.policy.q)
    assert policy.trained_with == again.trained_with


def test_a_task_may_be_given_as_its_class(tmp_path):
    from my_tasks import Pictured

    policy = train("qlearn", "my-maze", folder=tmp_path / "named", **BARE)
    assert policy.trained_with.task_name == "my-maze"
    settings = {"task.observation": "raw", "agent.n_steps": 16, "agent.batch_size": 16}
    quick = {**BARE, "simulation": "kinematic", "total_timesteps": 32}
    policy = train("stable_baselines3:PPO", Pictured, folder=tmp_path / "given", settings=settings, **quick)
    assert policy.trained_with.task_name == "my_tasks:Pictured"
    assert type(policy.trained_with.task) is Pictured
    assert set(load(tmp_path / "given").observation_space) == {"picture", "numbers"}


def test_runs_without_a_name_do_not_collide(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = resolve("stable_baselines3:A2C", "wall")
    folders = []
    for _ in range(3):
        folders.append(training.default_folder(config))
        folders[-1].mkdir(parents=True)
    assert len(set(folders)) == 3
    assert {str(folder.parent) for folder in folders} == {"runs/wall/A2C"}


def test_a_run_can_have_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train(name="mine", **{**BARE, "total_timesteps": 8}, simulation="kinematic")
    assert (tmp_path / "runs/maze/qlearn/mine/config.yaml").is_file()
    with pytest.raises(InputError, match=r"name of a folder, of printable text without a path, got '\.\./x'"):
        train(name="../x")
    with pytest.raises(InputError, match="either it or folder="):
        train(name="x", folder="y")


def test_an_existing_folder_is_left_alone(small, tmp_path):
    run = training.train_config(small(), tmp_path / "run").run
    before = {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match="exists already"):
        training.train_config(small(seed=1), run.folder)
    assert {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize("simulation", SIMULATIONS)
@pytest.mark.parametrize(("agent", "own"), [("qlearn", {}), ("ppo", {"agent.n_steps": 64, "agent.batch_size": 64})])
def test_a_turtlebot3_is_trained_evaluated_and_driven_by_what_came_of_it(agent, own, simulation, tmp_path):
    settings = {"task.robot": "turtlebot3", "task.start": "fixed", **own}
    policy = train(agent, settings=settings, simulation=simulation, folder=tmp_path / "run", **BARE)
    env = make_env(load(tmp_path / "run"))
    assert (env.scene.robot.name, env.scene.task.control_period) == ("turtlebot3", 0.4)
    env.close()
    evaluation = evaluate(policy, episodes=1, steps=5, workers=1)
    assert 0.0 < evaluation.summary()["mean_speed"] <= evaluation.scene.actions.max_speed == 0.22


def test_evaluations_on_the_way_are_in_worlds_that_it_is_not_trained_in(small):
    for judge in ("kinematic", "bullet"):
        world = {"task.world": {"generator": "rooms", "worlds": 4, "difficulty": 0.0}}
        evaluator = training.make_evaluator(small(settings=world, eval_simulation=judge, eval_episodes=2))
        assert [world.name for world in evaluator.scene.spec.worlds] == [f"rooms {i} (validation)" for i in range(4)]
        evaluator.close()
