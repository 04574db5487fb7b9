"""The metrics of an evaluation, and its files in a run folder."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.evaluate import Evaluator, evaluate
from tb2rl.evaluation.evaluation import Evaluation, load_evaluation
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import EPISODES, EVALUATION, Run
from tb2rl.simulation import InitialState
from tb2rl.tasks.wander import Wander

# ---- metrics


def evaluation_of(*episodes: Episode, task: Wander = Wander()) -> Evaluation:  # noqa: B008 (frozen)
    return Evaluation(episodes, make_scene(task, "raw"), 1, "kinematic")


def test_the_summary_counts_what_happened(make_episode):
    stuck = make_episode("stuck", False, 10, 1.0, -150.0, failed=True)  # failures count whatever their name
    lasted = make_episode("time limit", True, 30, 3.0, 150.0)
    evaluation = evaluation_of(*[stuck, lasted] * 2, task=Wander(control_period=0.5, episode_steps=30))
    summary = evaluation.summary()
    assert (summary["episodes"], summary["steps"], summary["seed"]) == (4, 30, 1)
    assert (summary["failure_free_rate"], summary["success_rate"], summary["touch_free_rate"]) == (0.5, 0.5, 0.5)
    assert (summary["mean_distance"], summary["mean_return"], summary["mean_length"]) == (2.0, 0.0, 20.0)
    assert (summary["std_distance"], summary["std_return"], summary["std_length"]) == (1.0, 150.0, 10.0)
    assert summary["mean_speed"] == 8.0 / (80 * 0.5)
    assert summary["endings"] == {"stuck": 2, "time limit": 2}
    assert summary["failure_free_interval"] == wilson_interval(2, 4)
    assert evaluation.score == (0.5, 0.0)


def test_an_evaluation_is_printed_as_a_table_without_its_arrays(make_episode):
    evaluation = evaluation_of(*[make_episode(length=2)] * 4, task=Wander(episode_steps=7))
    header, first, *_, endings = str(evaluation).splitlines()
    assert " ".join(header.split()) == "4 episodes of at most 7 steps value"
    assert first.split()[:2] == ["failure-free", f"{100 * evaluation.summary()['failure_free_rate']:.1f}"]
    assert endings.split()[0] == "endings"


def test_the_squares_of_the_median_episode_distinguish_driving_from_circling(make_episode):
    angles = 2 * np.pi * np.arange(100) / 20
    circling = np.stack([0.5 + 0.4 * np.cos(angles), -0.5 + 0.4 * np.sin(angles)], axis=1)  # in the square (0, -1)
    straight = np.stack([np.arange(-20, 80) / 10 + 0.05, np.full(100, 3.5)], axis=1)  # from -2 to 8
    paths = circling, straight, np.concatenate([straight, straight[::-1]])
    episodes = [replace(make_episode(length=1), path=path.astype(np.float32)) for path in paths]

    def squares(*numbers: int) -> float:
        return evaluation_of(*(episodes[i] for i in numbers)).summary()["median_squares"]

    assert (squares(0), squares(1), squares(2)) == (1, 10, 10)
    assert (squares(0, 0, 1), squares(0, 1)) == (1, 5.5)


def test_out_of_bounds_counts_as_failed(forward):
    scene = resolve("random", "wall", settings={"task.bounds": [-1.0, -3.0, 1.0, 3.0]}).scene
    states = InitialState.default(scene.spec, 1)
    states.pose[:] = 0.0, 2.0, 0.0
    with Evaluator(scene, states, workers=1, simulation="kinematic") as evaluator:
        evaluation = evaluator.run(forward)
    (outside,) = evaluation.episodes
    assert (outside.ended, outside.failed, outside.success, outside.touched) == ("out of bounds", True, False, False)
    assert outside.path[-1, 0] > 1.0 > outside.path[-2, 0]
    assert 5.0 * (outside.length - 1) <= outside.episode_return + 200.0 <= 10.0 * (outside.length - 1)
    assert evaluation.summary()["endings"] == {"out of bounds": 1}


def test_the_score_compares_success_rates_in_half_percents_and_then_returns(make_episode):
    def score(failures: int, total: float, count: int = 1000) -> tuple[float, float]:
        return evaluation_of(*(make_episode("", i >= failures, 1, 1.0, total) for i in range(count))).score

    assert score(0, -9.0, 1) > score(1, 9.0, 1) > score(1, 8.0, 1)
    assert score(1, 9.0) > score(0, 8.0) > score(5, 9.0)


# ---- files in a run folder


@pytest.fixture(scope="module")
def evaluated(trained_run, tmp_path_factory) -> Path:
    """A run folder with an evaluation of two episodes; copy it before you write to it."""
    folder = tmp_path_factory.mktemp("evaluated") / "run"
    shutil.copytree(trained_run, folder)
    evaluation = evaluate(folder, episodes=2, steps=5, simulation="kinematic")
    Run.open(folder).write_evaluation(*evaluation.serialize(Run.open(folder).config, "its name"))
    return folder


@pytest.fixture
def folder(evaluated, tmp_path) -> Path:
    """A copy of this run folder."""
    return shutil.copytree(evaluated, tmp_path / "evaluated")


def change(folder: Path, edit) -> None:
    tree = json.loads((folder / EVALUATION).read_text())
    edit(tree)
    (folder / EVALUATION).write_text(json.dumps(tree))


def assert_refused(folder: Path, *named: str) -> None:
    with pytest.raises(InputError) as refused:
        load_evaluation(Run.open(folder))
    message = str(refused.value)
    assert "\n" not in message
    assert [part for part in named if part not in message] == [], message


def test_an_evaluation_is_read_as_it_was_written(folder, outcomes):
    back = load_evaluation(Run.open(folder))
    assert outcomes(back) == outcomes(evaluate(folder, episodes=2, steps=5, simulation="kinematic"))
    assert [len(episode.actions) for episode in back.episodes] == [episode.length for episode in back.episodes]
    assert (back.steps, back.task.episode_steps, back.simulation) == (5, 5, "kinematic")
    written = json.loads((folder / EVALUATION).read_text())
    assert json.loads(json.dumps(back.summary())).items() <= written.items()
    assert (written["policy"], written["config"]) == ("its name", Run.open(folder).config.to_dict())
    assert written["versions"].keys() >= {"tb2rl", "pybullet", "torch"}
    assert [each["failed"] for each in written["each"]] == [episode.failed for episode in back.episodes]


def test_continuous_actions_are_read_as_they_were_written(folder, cruise, tmp_path, outcomes):
    config = resolve("stable_baselines3:PPO", cruise)
    policy = make_baseline(resolve("random", cruise, settings={"task.observation": "raw"}))
    evaluation = evaluate(policy, config, episodes=2, steps=9, simulation="kinematic")
    run = Run.create(tmp_path / "run", config)
    run.write_evaluation(*evaluation.serialize(config, "random"))
    assert outcomes(load_evaluation(Run.open(tmp_path / "run"))) == outcomes(evaluation)
    tree, arrays = Run.open(folder).read_evaluation()
    run.write_evaluation({**tree, "config": config.to_dict()}, arrays)
    assert_refused(run.folder, "evaluation.json", "do not match the task")


def test_episodes_in_many_worlds_are_read_with_theirs(tmp_path, outcomes):
    config = resolve("random", settings={"task.world": {"generator": "clutter", "worlds": 30, "difficulty": 0.0}})
    evaluation = evaluate(make_baseline(config), config, episodes=5, steps=3, simulation="kinematic")
    folder = Run.create(tmp_path / "run", config).folder
    Run.open(folder).write_evaluation(*evaluation.serialize(config, "random"))
    back = load_evaluation(Run.open(folder))
    assert outcomes(back) == outcomes(evaluation)
    assert [each.world for each in back.episodes] == [each.world for each in evaluation.episodes]
    assert len({each.world for each in back.episodes}) > 2
    names = [world.name for world in back.scene.spec.worlds]
    assert names == [world.name for world in evaluation.scene.spec.worlds] == [f"clutter {i} (test)" for i in range(30)]
    change(folder, lambda tree: tree["each"][0].update(world=30))
    assert_refused(folder, "evaluation.json", "do not match the task")


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (lambda tree: tree.clear(), "each"),
        (lambda tree: tree["config"]["task"].update(collision_range=0.4), "do not match the task in config.yaml"),
        (lambda tree: tree["each"][0].update(distance=None), "each.0.distance"),
        (lambda tree: tree["each"][0].update(length=4), "do not match the task"),
        (lambda tree: tree["each"].pop(), "zip"),
        (lambda tree: tree.update(simulation="gazebo"), "gazebo"),
    ],
)
def test_an_evaluation_that_does_not_fit_is_refused(edit, named, folder):
    change(folder, edit)
    assert_refused(folder, "evaluation.json is not an evaluation", named)


def test_damaged_or_missing_files_are_refused(folder):
    (folder / EPISODES).write_bytes((folder / EPISODES).read_bytes()[:-100])
    assert_refused(folder, EPISODES, "damaged")
    (folder / EVALUATION).write_text("{")
    assert_refused(folder, EVALUATION)
    (folder / EPISODES).unlink()
    assert_refused(folder, "no standard evaluation: run `python -m tb2rl.evaluate")
