"""The standard evaluation: fair start poses, figures that do not depend on the machine, and where they are written."""

from __future__ import annotations

import json
from importlib import import_module

import numpy as np
import pytest

from tb2rl import evaluate, load, train
from tb2rl.config import resolve
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.evaluation import SEED, TRAINING_SEED, Episode, Evaluation, Evaluator, kept, wilson_interval
from tb2rl.maze import load_maze
from tb2rl.registry import agent_names, find_agent
from tb2rl.runs import make_baseline
from tb2rl.tasks.wander import Wander

command = import_module("tb2rl.evaluate")  # `from tb2rl import evaluate` is the function
BASELINES = [name for name in agent_names() if find_agent(name).algorithm is None]
KEYS = {"crash_free_rate", "success_rate", "mean_distance", "mean_return", "mean_length", "episodes"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder with a policy that knows next to nothing."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train("qlearn", total_timesteps=100, n_envs=1, eval_freq=0, save_freq=0, folder=folder)
    return folder


@pytest.fixture
def short(monkeypatch):
    """The standard evaluation, but of two episodes of five steps in this process."""
    monkeypatch.setattr(command, "EPISODES", 2)
    monkeypatch.setattr(command, "STEPS", 5)
    return ["--workers", "1"]


def outcomes(evaluation: Evaluation) -> list[tuple]:
    return [(e.start, e.ended, e.length, e.distance, e.episode_return, e.path.tolist()) for e in evaluation.episodes]


# ---- what is driven


@pytest.mark.parametrize("name", BASELINES)
def test_the_result_does_not_depend_on_the_number_of_processes(name):
    config = resolve(name, settings={"task.noise": 0.01})
    alone, shared = (
        evaluate(make_baseline(config), config, episodes=5, steps=40, workers=workers) for workers in (1, 2)
    )
    assert outcomes(alone) == outcomes(shared)
    assert alone.summary() == shared.summary()


def test_the_same_evaluation_twice_gives_the_same_result(run):
    twice = [evaluate(run, episodes=3, steps=30, workers=1) for _ in range(2)]
    assert outcomes(twice[0]) == outcomes(twice[1])


def test_every_episode_has_a_start_of_its_own_and_the_time_limit_that_was_asked_for():
    config = resolve("wallfollower", settings={"task.start": "fixed", "task.episode_steps": 7})
    evaluation = evaluate(make_baseline(config), config, episodes=4, steps=20, workers=1)
    assert len({episode.start for episode in evaluation.episodes}) == 4
    assert [episode.length for episode in evaluation.episodes] == [20] * 4
    for episode in evaluation.episodes:
        assert len(episode.path) == 21
        assert np.linalg.norm(np.diff(episode.path, axis=0), axis=1).sum() == pytest.approx(episode.distance, rel=1e-3)


def test_training_does_not_draw_the_standard_start_poses():
    env, training = TurtleBot2Env("maze"), set()
    for seed in range(20):
        training |= {tuple(env.reset(seed=seed if first else None)[1]["pose"].round(6)) for first in (True, False)}
    env.close()

    def poses(seed: int) -> set[tuple]:
        rng = np.random.default_rng(seed)
        return {tuple(pose.round(6)) for pose in load_maze("loop").random_poses(rng, 100, Wander().start_clearance)}

    assert len(training) == 40
    assert training & poses(0), "an evaluation of seed 0 would start where a training of seed 0 does"
    assert training.isdisjoint(poses(SEED))
    assert poses(TRAINING_SEED).isdisjoint(poses(SEED))


def test_random_actions_crash():
    config = resolve("random")
    assert evaluate(make_baseline(config), config, episodes=30, workers=1).summary()["crash_free_rate"] < 0.05


def test_the_wall_follower_does_not():
    config = resolve("wallfollower")
    evaluation = evaluate(make_baseline(config), config, episodes=6, steps=300, workers=1)
    assert evaluation.summary()["crash_free_rate"] == 1.0
    assert evaluation.summary()["mean_speed"] > 0.2, "nor does it stand still"


@pytest.mark.slow
def test_the_wall_follower_is_a_baseline_to_beat_in_the_standard_evaluation():
    config = resolve("wallfollower")
    assert evaluate(make_baseline(config), config).summary()["crash_free_rate"] > 0.9


def test_anything_that_predicts_can_be_evaluated():
    class Ahead:
        def predict(self, observation, *, deterministic=False):
            return np.int64(Wander.FORWARD), None

    episodes = evaluate(Ahead(), resolve(), episodes=3, steps=200, workers=1).episodes
    assert [episode.ended for episode in episodes] == ["crash"] * 3
    assert [episode.episode_return for episode in episodes] == [5.0 * (e.length - 1) - 200.0 for e in episodes]


def test_a_policy_of_unknown_origin_needs_a_config():
    with pytest.raises(InputError, match="no config"):
        evaluate(object())


@pytest.mark.parametrize("change", [{"beams": 9}, {"edges": [1.0]}, {"name": "wall", "maze": "wall"}])
def test_a_policy_is_not_judged_on_observations_that_it_was_not_trained_on(run, change):
    with pytest.raises(InputError, match="observation"):
        evaluate(run, settings=change, episodes=1, steps=2, workers=1)


# ---- the figures


@pytest.mark.parametrize(
    ("count", "total", "interval"),
    [(95, 100, (0.8882, 0.9785)), (0, 10, (0.0, 0.2775)), (10, 10, (0.7225, 1.0)), (1, 2, (0.0945, 0.9055))],
)
def test_the_wilson_interval_has_the_values_of_the_tables(count, total, interval):
    assert wilson_interval(count, total) == pytest.approx(interval, abs=1e-4)


def test_the_summary_counts_what_happened():
    def episode(ended: str, success: bool, length: int, distance: float, total: float) -> Episode:
        nowhere = np.zeros((1, 2)), np.zeros(0)
        return Episode((0.0, 0.0, 0.0), ended, success, ended == "crash", length, distance, total, *nowhere)

    episodes = [episode("crash", False, 10, 1.0, -150.0), episode("time limit", True, 30, 3.0, 150.0)]
    evaluation = Evaluation(episodes * 2, Wander(control_period=0.5), steps=30, seed=1)
    summary = evaluation.summary()
    assert (summary["episodes"], summary["steps"], summary["seed"]) == (4, 30, 1)
    assert (summary["crash_free_rate"], summary["success_rate"], summary["touch_free_rate"]) == (0.5, 0.5, 0.5)
    assert (summary["mean_distance"], summary["mean_return"], summary["mean_length"]) == (2.0, 0.0, 20.0)
    assert (summary["std_distance"], summary["std_return"], summary["std_length"]) == (1.0, 150.0, 10.0)
    assert summary["mean_speed"] == 8.0 / (80 * 0.5)
    assert summary["endings"] == {"crash": 2, "time limit": 2}
    assert summary["crash_free_interval"] == wilson_interval(2, 4)
    assert evaluation.score == (0.5, 0.0)


def test_a_policy_that_succeeds_more_often_scores_higher_whatever_its_return():
    def score(success: bool, total: float) -> tuple[float, float]:
        episode = Episode((0.0, 0.0, 0.0), "", success, False, 1, 1.0, total, np.zeros((1, 2)), np.zeros(0))
        return Evaluation([episode], Wander(), 1, 0).score

    assert score(True, -9.0) > score(False, 9.0) > score(False, 8.0)


# ---- the command


def test_the_standard_evaluation_lands_in_the_run_folder(run, short, capsys):
    command.main([str(run), *short])
    written = json.loads((run / "evaluation.json").read_text())
    assert written.keys() >= KEYS | {"policy", "config", "versions"}
    assert (written["episodes"], written["steps"], written["seed"], len(written["each"])) == (2, 5, SEED, 2)
    assert written["config"] == load(run).trained_with.to_dict()
    assert written["mean_return"] == evaluate(run, episodes=2, steps=5, workers=1).summary()["mean_return"]
    shown = capsys.readouterr().out
    assert f"{100 * written['crash_free_rate']:.1f} %" in shown
    assert f"{written['mean_return']:.1f}" in shown
    back = kept(run)
    assert outcomes(back) == outcomes(evaluate(run, episodes=2, steps=5, workers=1))
    assert [len(episode.actions) for episode in back.episodes] == [episode.length for episode in back.episodes]
    assert json.loads(json.dumps(back.summary())).items() <= written.items()
    (run / "evaluation.json").unlink()


@pytest.mark.parametrize("damage", ["{", "[]", '{"each": []}', None])
def test_a_kept_evaluation_that_is_damaged_is_refused_in_one_line(run, short, damage):
    command.main([str(run), *short])
    file = run / "evaluation.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "each": []}) if damage is None else damage)
    with pytest.raises(InputError, match=r"evaluation\.json is not an evaluation"):
        kept(run)
    (run / "episodes.safetensors").unlink()
    with pytest.raises(InputError, match="no standard evaluation: run"):
        kept(run)
    file.unlink()


@pytest.mark.parametrize(
    "change", [["--episodes", "3"], ["--steps", "4"], ["--seed", "1"], ["--set", "task.maze=circuit"]]
)
def test_another_evaluation_does_not(run, short, change):
    command.main([str(run), *short, *change])
    assert not (run / "evaluation.json").exists()


def test_json_goes_to_the_file_that_is_named_and_only_there(run, short, tmp_path):
    command.main([str(run), *short, "--json", str(tmp_path / "mine.json")])
    assert json.loads((tmp_path / "mine.json").read_text()).keys() >= KEYS
    assert not (run / "evaluation.json").exists()


def test_settings_change_the_task_of_a_policy(run, short, tmp_path, capsys):
    changes = ["--set", "task.maze=circuit", "task.noise=0.1", "--set", "task.forward_speed=0.1"]
    command.main([str(run), *short, "--json", str(tmp_path / "it.json"), *changes])
    task = json.loads((tmp_path / "it.json").read_text())["config"]["task"]
    assert (task["maze"], task["noise"], task["forward_speed"]) == ("circuit", 0.1, 0.1)
    assert "in circuit" in " ".join(capsys.readouterr().out.split()), "the title breaks where the folder's name is long"


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_can_be_evaluated_by_its_name_at_another_task(name, short, tmp_path, capsys):
    command.main(["--agent", name, "--task", "wall", *short, "--json", str(tmp_path / "it.json")])
    written = json.loads((tmp_path / "it.json").read_text())
    assert (written["policy"], written["config"]["task"]["name"]) == (name, "wall")
    assert "goal reached" in capsys.readouterr().out


def test_an_evaluator_serves_several_policies():
    config = resolve("wallfollower")
    with Evaluator(config.task_settings, config.observation, episodes=2, steps=10, workers=2) as evaluator:
        first, again = (evaluator.run(make_baseline(config)) for _ in range(2))
    assert outcomes(first) == outcomes(again)
