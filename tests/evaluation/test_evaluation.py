"""What an evaluation says of its episodes, and how it is kept in a run folder and read back."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, episode_of, kept_evaluation
from tb2rl.evaluation.rollout import roll_out
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.folder import EVALUATION, PATHS, Run
from tb2rl.runs.layers import resolve
from tb2rl.tasks.wander import Wander

# ---- the figures


def test_the_summary_counts_what_happened(make_episode):
    collided, lasted = (
        make_episode("collision", False, 10, 1.0, -150.0),
        make_episode("time limit", True, 30, 3.0, 150.0),
    )
    scene = make_scene(Wander(control_period=0.5, episode_steps=30), "raw")
    evaluation = Evaluation([collided, lasted] * 2, scene, seed=1)
    summary = evaluation.summary()
    assert (summary["episodes"], summary["steps"], summary["seed"]) == (4, 30, 1)
    assert (summary["failure_free_rate"], summary["success_rate"], summary["touch_free_rate"]) == (0.5, 0.5, 0.5)
    assert (summary["mean_distance"], summary["mean_return"], summary["mean_length"]) == (2.0, 0.0, 20.0)
    assert (summary["std_distance"], summary["std_return"], summary["std_length"]) == (1.0, 150.0, 10.0)
    assert summary["mean_speed"] == 8.0 / (80 * 0.5)
    assert summary["endings"] == {"collision": 2, "time limit": 2}
    assert summary["failure_free_interval"] == wilson_interval(2, 4)
    assert evaluation.score == (0.5, 0.0)


def test_an_evaluation_is_printed_as_a_table_without_its_arrays(make_episode):
    evaluation = Evaluation([make_episode(length=2)] * 4, make_scene(Wander(episode_steps=7), "raw"), 0)
    header, first, *_, endings = str(evaluation).splitlines()
    assert repr(evaluation) == str(evaluation)
    assert " ".join(header.split()) == "4 episodes of at most 7 steps value"
    assert first.split()[:2] == ["failure-free", f"{100 * evaluation.summary()['failure_free_rate']:.1f}"]
    assert endings.split()[0] == "endings"
    assert "array" not in str(evaluation)


def test_the_squares_that_the_median_episode_visits_tell_driving_from_circling(make_episode):
    around = 2 * np.pi * np.arange(100) / 20
    circling = np.stack([0.5 + 0.4 * np.cos(around), -0.5 + 0.4 * np.sin(around)], axis=1)  # in the square (0, -1)
    straight = np.stack([np.arange(-20, 80) / 10 + 0.05, np.full(100, 3.5)], axis=1)  # from -2 to 8
    back_and_forth = np.concatenate([straight, straight[::-1]])
    episodes = [
        replace(make_episode(length=1), path=path.astype(np.float32)) for path in (circling, straight, back_and_forth)
    ]

    def squares(*numbers: int) -> float:
        return Evaluation([episodes[i] for i in numbers], make_scene(Wander(), "raw"), 0).summary()["median_squares"]

    assert (squares(0), squares(1), squares(2)) == (1, 10, 10)
    assert squares(0, 0, 1) == 1
    assert squares(0, 1) == 5.5


def test_what_failed_is_told_by_the_episode_and_not_by_the_name_of_its_ending(make_episode):
    endings = [("stuck", True), ("collision", False), ("time limit", False), ("stuck", True)]
    episodes = [make_episode(name, False, 1, failed=failed) for name, failed in endings]
    summary = Evaluation(episodes, make_scene(Wander(), "raw"), 0).summary()
    assert (summary["failure_free_rate"], summary["success_rate"]) == (0.5, 0.0)
    assert summary["failure_free_interval"] == wilson_interval(2, 4)
    assert summary["endings"] == {"collision": 1, "stuck": 2, "time limit": 1}


def test_out_of_bounds_counts_as_failed(ahead):
    scene = resolve("random", "wall", settings={"task.bounds": [-1.0, -3.0, 1.0, 3.0]}).scene
    with closing(TurtleBot2Env(scene)) as env:
        outside = episode_of(scene, list(roll_out(env, ahead, 0, pose=(0.0, 2.0, 0.0))))
    assert (outside.ended, outside.failed, outside.success, outside.touched) == ("out of bounds", True, False, False)
    assert outside.path[-1, 0] > 1.0 > outside.path[-2, 0]
    assert 5.0 * (outside.length - 1) <= outside.episode_return + 200.0 <= 10.0 * (outside.length - 1)
    summary = Evaluation([outside], scene, 0).summary()
    assert (summary["failure_free_rate"], summary["success_rate"]) == (0.0, 0.0)
    assert summary["endings"] == {"out of bounds": 1}


def test_a_policy_that_succeeds_more_often_scores_higher_whatever_its_return(make_episode):
    def score(success: bool, total: float) -> tuple[float, float]:
        return Evaluation([make_episode("", success, 1, 1.0, total)], make_scene(Wander(), "raw"), 0).score

    assert score(True, -9.0) > score(False, 9.0) > score(False, 8.0)


def test_of_rates_in_the_same_half_percent_the_higher_return_decides(make_episode):
    def score(failures: int, total: float) -> tuple[float, float]:
        episodes = [make_episode("", i >= failures, 1, 1.0, total) for i in range(1000)]
        return Evaluation(episodes, make_scene(Wander(), "raw"), 0).score

    assert score(1, 9.0) > score(0, 8.0) > score(5, 9.0)


# ---- kept in a run folder


@pytest.fixture
def keep(run, tmp_path) -> Callable[[], Path]:
    """A function that gives a copy of the run folder with an evaluation of two episodes in it."""

    def kept() -> Path:
        folder = tmp_path / "run"
        shutil.copytree(run, folder)
        evaluation = evaluate(folder, episodes=2, steps=5, workers=1)
        Run.open(folder).write_evaluation(*evaluation.tree(Run.open(folder).config, "its name"))
        return folder

    return kept


def changed(folder: Path, change: Callable[[dict], object]) -> None:
    tree = json.loads((folder / EVALUATION).read_text())
    change(tree)
    (folder / EVALUATION).write_text(json.dumps(tree))


def put(*keys: str | int, value: object) -> Callable[[dict], None]:
    """A change to a tree: this value at these keys."""

    def change(tree: dict) -> None:
        part = tree
        for key in keys[:-1]:
            part = part[key]
        part[keys[-1]] = value

    return change


def assert_refused(folder: Path, *named: str) -> None:
    with pytest.raises(InputError) as refused:
        kept_evaluation(Run.open(folder))
    message = str(refused.value)
    assert "\n" not in message
    assert [part for part in named if part not in message] == [], message


def test_what_is_kept_is_read_back(keep, outcomes):
    folder = keep()
    back = kept_evaluation(Run.open(folder))
    assert outcomes(back) == outcomes(evaluate(folder, episodes=2, steps=5, workers=1))
    assert [len(episode.actions) for episode in back.episodes] == [episode.length for episode in back.episodes]
    assert (back.steps, back.task.episode_steps) == (5, 5)
    written = json.loads((folder / EVALUATION).read_text())
    assert json.loads(json.dumps(back.summary())).items() <= written.items()
    assert (written["policy"], written["config"]) == ("its name", Run.open(folder).config.to_dict())
    assert written["versions"].keys() >= {"tb2rl", "pybullet", "torch"}
    assert [each["failed"] for each in written["each"]] == [episode.failed for episode in back.episodes]


def test_an_evaluation_says_in_which_simulation_it_drove(keep, monkeypatch):
    monkeypatch.setattr(
        "tb2rl.evaluation.evaluator.default_simulator", lambda: "kinematic"
    )  # as where PyBullet is missing
    folder = keep()
    assert json.loads((folder / EVALUATION).read_text())["simulation"] == "kinematic"
    assert kept_evaluation(Run.open(folder)).simulation == "kinematic"
    changed(folder, lambda tree: tree.pop("simulation"))
    assert kept_evaluation(Run.open(folder)).simulation == "bullet", "when all were"
    changed(folder, put("simulation", value="gazebo"))
    assert_refused(folder, "simulation", "gazebo")


def test_continuous_actions_are_read_back(cruise, tmp_path, outcomes):
    config = resolve("stable_baselines3:PPO", cruise)
    policy = make_baseline(resolve("random", cruise, settings={"task.observation": "raw"}))
    evaluation = evaluate(policy, config, episodes=2, steps=9, workers=1)
    run = Run.create(tmp_path / "run", config)
    run.write_evaluation(*evaluation.tree(config, "random"))
    assert outcomes(kept_evaluation(Run.open(tmp_path / "run"))) == outcomes(evaluation)


def test_episodes_in_many_worlds_are_read_back_with_theirs(tmp_path, outcomes):
    world = {"generator": "clutter", "worlds": 30, "difficulty": 0.0}
    config = resolve("random", settings={"task.world": world})
    evaluation = evaluate(make_baseline(config), config, episodes=5, steps=3, workers=1)
    folder = Run.create(tmp_path / "run", config).folder
    Run.open(folder).write_evaluation(*evaluation.tree(config, "random"))
    back = kept_evaluation(Run.open(folder))
    assert outcomes(back) == outcomes(evaluation)
    assert [each.world for each in back.episodes] == [each.world for each in evaluation.episodes]
    assert len({each.world for each in back.episodes}) > 2
    names = [world.name for world in back.scene.spec.worlds]
    assert names == [world.name for world in evaluation.scene.spec.worlds] == [f"clutter {i} (test)" for i in range(30)]
    changed(folder, put("each", 0, "world", value=30))
    assert_refused(folder, "evaluation.json has more worlds than the task")
    changed(folder, put("each", 0, "world", value=-1))
    assert_refused(folder, "evaluation.json is not an evaluation")


def test_an_older_evaluation_says_no_world(keep):
    folder = keep()
    changed(folder, lambda tree: [each.pop("world") for each in tree["each"]])
    assert [each.world for each in kept_evaluation(Run.open(folder)).episodes] == [0, 0]


def test_actions_of_another_kind_than_the_tasks_are_refused(keep, cruise, tmp_path):
    folder = keep()
    other = Run.create(tmp_path / "other", resolve("stable_baselines3:PPO", cruise))
    tree, arrays = Run.open(folder).read_evaluation()
    other.write_evaluation({**tree, "config": other.config.to_dict()}, arrays)
    assert_refused(other.folder, "evaluation.json has other actions than the task")


@pytest.mark.parametrize("damage", ["{", "[]", '{"each": []}', None])
def test_an_evaluation_that_is_damaged_is_refused_in_one_line(keep, damage):
    folder = keep()
    if damage is None:
        changed(folder, put("each", value=[]))
    else:
        (folder / EVALUATION).write_text(damage)
    assert_refused(folder, "evaluation.json is not an evaluation")
    (folder / PATHS).unlink()
    assert_refused(folder, "no standard evaluation: run `python -m tb2rl.evaluate")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (put("config", "task", "world", value="circuit"), "not of the task in config.yaml"),
        (put("config", "task", "collision_range", value=0.4), "not of the task in config.yaml"),
        (put("each", 0, "distance", value=None), "each.0.distance"),
        (put("each", 1, "ended", value=None), "each.1.ended"),
        (put("each", 1, "failed", value="perhaps"), "each.1.failed"),
        (put("each", 0, "start", value=[0.0, 0.0]), "each.0.start"),
        (put("each", 0, "length", value=4), "other lengths than their paths and actions"),
        (lambda tree: tree["each"].pop(), "not an evaluation"),
        (put("each", value=[]), "not an evaluation"),
        (put("steps", value="1500x"), "steps"),
    ],
)
def test_an_evaluation_that_does_not_fit_is_refused(change, named, keep):
    folder = keep()
    changed(folder, change)
    assert_refused(folder, "evaluation.json", named)


def test_paths_without_their_end_are_refused(keep):
    folder = keep()
    (folder / PATHS).write_bytes((folder / PATHS).read_bytes()[:-100])
    assert_refused(folder, PATHS, "damaged")
