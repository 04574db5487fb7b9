"""The figures of a suite, by hand for a few episodes; and drives through its worlds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation import suites
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.evaluation.suite_result import Drive
from tb2rl.evaluation.suites import SuiteEvaluation, barn_score, drives_of, evaluator_of, suite_evaluator, suite_scene
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.tasks.navigate import Navigate
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.suites import Suite
from tb2rl.worlds.world import World

BOUNDS = (-4.0, -4.0, 4.0, 4.0)


def world(y: float, yaw: float = 0.0) -> World:
    """A floor with a wall far to the north, to be crossed from the west to the east."""
    wall = (0.0, 3.5, 6.0, 0.2, 0.0)
    return World.from_shapes(f"at {y:g}", [wall], start=(-2.0, y, yaw), goal=(0.0, y, 0.0), bounds=BOUNDS)


@pytest.fixture(scope="module")
def suite() -> Suite:
    """Three worlds of two families."""
    return Suite("tiny", (world(-1.0), world(0.0), world(1.0)), ("a", "b", "a"), (2.0, 2.0, 4.0), 2.0)


@pytest.fixture(scope="module")
def task() -> Navigate:
    """The task, whose own world no suite asks for."""
    return Navigate(world="loop", goal_radius=0.5)


def drive(number=0, ended="goal", time=10.0, distance=2.0, closest=0.5, moving=None) -> Drive:
    success, failed = ended == "goal", ended == "bump"
    return Drive(number, ended, success, failed, time, time if moving is None else moving, distance, closest)


# ---- BARN's score


@pytest.mark.parametrize(
    ("time", "score"),
    [
        (20.0, 0.25),  # 5 s / 20 s
        (10.0, 0.5),  # twice OT
        (3.0, 0.5),  # faster counts alike
        (40.0, 0.125),  # eight times OT
        (99.0, 0.125),  # slower counts alike
    ],
)
def test_the_score_of_barn_in_2024(time, score):
    assert barn_score(drive(moving=time, time=200.0), reference=10.0) == pytest.approx(score)  # OT = 5 s
    assert barn_score(drive(ended="bump", moving=time), reference=10.0) == 0.0


def test_the_clock_of_barn_starts_after_a_tenth_of_a_metre(make_episode):
    standing = make_episode("goal", True, 6, 1.0)
    path = np.array([[1.0, 1.0]] * 3 + [[1.0, 1.05], [1.0, 1.1001], [1.0, 1.2], [1.0, 1.3]], dtype=np.float32)
    started = Drive.of(replace(standing, path=path, closest=0.25), control_period=0.5)
    assert (started.time, started.moving_time, started.closest) == (3.0, 1.0, 0.25)
    assert Drive.of(replace(standing, ended="time limit", success=False), 0.5).moving_time == 0.0
    assert barn_score(Drive.of(standing, 0.5), 10.0) == 0.5, "at the goal without a move"


# ---- the figures


@pytest.fixture
def evaluation(suite, task) -> SuiteEvaluation:
    """A success along a detour, a collision, and a success after a path of 4 m that took 12 s."""
    drives = [
        drive(0, time=8.0, distance=2.5),
        drive(1, "bump", 1.0, 0.1),
        drive(2, time=12.0, distance=3.4, closest=0.1),
    ]
    return SuiteEvaluation(suite, suite_scene(make_scene(task, "raw"), suite), drives, "bullet")


def test_the_figures_of_three_drives(evaluation):
    speed = evaluation.scene.robot.max_speed
    figures = evaluation.figures()
    assert figures.worlds == 3
    assert figures.success_rate == pytest.approx(2 / 3)
    assert figures.success_interval == wilson_interval(2, 3)
    assert (figures.failed_rate, figures.time_limit_rate) == (pytest.approx(1 / 3), 0.0)
    # The goal is reached at half a metre from it. A drive that is shorter than the path counts as the path.
    assert figures.spl == pytest.approx((1.5 / 2.5 + 0.0 + 1.0) / 3)
    assert figures.time_ratio == pytest.approx((8.0 * speed / 1.5 + 12.0 * speed / 3.5) / 2)
    assert figures.mean_speed == pytest.approx(6.0 / 21.0)
    assert figures.mean_closest == pytest.approx(0.3)
    assert figures.longest_tenth_success_rate == 1.0, "the third world has the longest path"
    assert figures.endings == {"bump": 1, "goal": 2}
    assert figures.barn_score is None


def test_the_longest_tenth_are_the_worlds_with_the_longest_paths(suite, evaluation):
    failed = [*evaluation.drives[:2], drive(2, "time limit")]
    figures = replace(evaluation, drives=failed).figures()
    assert (figures.longest_tenth_success_rate, figures.time_limit_rate) == (0.0, pytest.approx(1 / 3))
    longer = replace(suite, worlds=suite.worlds * 7, families=suite.families * 7, path_lengths=tuple(range(1, 22)))
    drives = [drive(number, "goal" if number != 19 else "bump") for number in range(21)]
    many = replace(evaluation, suite=longer, drives=drives).figures()
    assert many.longest_tenth_success_rate == pytest.approx(2 / 3), "three of 21, rounded up"


def test_each_family_has_figures_of_its_own(evaluation):
    assert evaluation.families == ["a", "b"]
    assert [evaluation.figures(family).worlds for family in "ab"] == [2, 1]
    assert [evaluation.figures(family).success_rate for family in "ab"] == [1.0, 0.0]
    assert evaluation.figures("b").time_ratio is None
    assert evaluation.figures("b").mean_closest is None


def test_a_score_stands_where_there_are_reference_paths(suite, evaluation):
    barn = replace(suite, references=(10.0, 10.0, 20.0))  # OT 5, 5 and 10 s
    figures = replace(evaluation, suite=barn).figures()
    assert figures.barn_score == pytest.approx((5.0 / 10.0 + 0.0 + 10.0 / 20.0) / 3)
    assert "2024" in figures.barn_formula


def test_the_result_names_policy_suite_and_worlds(evaluation):
    config = resolve("dwa", "navigate", settings={"task.world": "loop", "task.guide": "plan"})
    result = evaluation.result(config, "agent dwa", None)
    assert result.title == "agent dwa, guide plan (map known), turtlebot2, PyBullet: suite tiny"
    assert (result.suite_digest, result.suite_path) == (evaluation.suite.digest, None)
    assert list(result.figures) == ["all", "a", "b"]
    assert list(result.rows) == ["a", "b", "all"]
    assert [(drive.name, drive.family) for drive in result.each] == [("at -1", "a"), ("at 0", "b"), ("at 1", "a")]
    assert [drive.name for drive in result.missed] == ["at 0"]
    alone = replace(evaluation.suite, families=("barn",) * 3, path=Path("barn.npz"))
    barn = replace(evaluation, suite=alone).result(config, "agent dwa", None)
    assert (list(barn.rows), list(barn.figures)) == (["all"], ["all", "barn"])
    assert barn.suite_path == str(Path.cwd() / "barn.npz")


# ---- again


def test_a_result_is_driven_again_step_by_step(suite, monkeypatch, tmp_path):
    tiny = replace(suite, worlds=suite.worlds * 2, families=suite.families * 2, path_lengths=suite.path_lengths * 2)
    monkeypatch.setattr(suites, "find_suite", lambda name, path: tiny)
    config = resolve("random", "navigate", settings={"task.world": "loop", "task.laser_noise": 0.01})
    scene = suite_scene(config.scene, tiny)
    with suite_evaluator(scene, 1, "kinematic") as evaluator:
        episodes = list(evaluator.drive(make_baseline(config)))
    drives = [Drive.of(episode, 0.1) for episode in episodes]
    result = SuiteEvaluation(tiny, scene, drives, "kinematic").result(config, "agent random", None)
    evaluator, policy = evaluator_of(result, tmp_path)
    for number in (4, 1, 5):
        path = [moment.after.pose[0, :2] for moment in evaluator.moments(policy, number)]
        np.testing.assert_array_equal(np.array(path, dtype=np.float32), episodes[number].path[1:])


def test_a_result_of_other_worlds_is_not_driven_again(evaluation, monkeypatch, tmp_path):
    config = resolve("random", "navigate", settings={"task.world": "loop"})
    result = evaluation.result(config, "agent random", None)
    with pytest.raises(InputError, match="unknown suite 'tiny'"):
        evaluator_of(result, tmp_path)
    other = replace(evaluation.suite, worlds=(*evaluation.suite.worlds[:2], world(2.0)))
    monkeypatch.setattr(suites, "find_suite", lambda name, path: other)
    with pytest.raises(InputError, match="the worlds of suite tiny have changed since"):
        evaluator_of(result, tmp_path)


# ---- into its worlds


def test_every_world_is_driven_once_from_its_start_to_its_goal(suite, task):
    suite = replace(suite, goal_radius=0.8, time_limit=4.0)
    scene = suite_scene(make_scene(task, "raw"), suite)
    assert (scene.task.start, scene.task.episode_steps, scene.task.goal_radius) == ("fixed", 40, 0.8)
    policy = Straight()
    with suite_evaluator(scene, workers=1) as evaluator:
        episodes = list(evaluator.drive(policy))
        rest = list(drives_of(evaluator, policy, first=1))
    assert [episode.start for episode in episodes] == [world.start for world in suite.worlds]
    assert [episode.world for episode in episodes] == [0, 1, 2]
    for episode, there in zip(episodes, suite.worlds, strict=True):
        assert (episode.ended, episode.success) == ("goal", True)
        distances = np.hypot(*(episode.path[:, :2] - there.goal[:2]).T)
        assert distances[-1] <= 0.8 < distances[-2]
        gap = 3.4 - episode.path[:, 1].max() - 0.178  # to the wall in the north, which each drive runs along
        assert episode.closest == pytest.approx(gap, abs=1e-3)
    assert rest == [Drive.of(episode, 0.1) for episode in episodes[1:]]


class Straight:
    """Full speed ahead."""

    def predict(self, observation, *, deterministic=False):
        return np.array([1.0, 0.0], dtype=np.float32), None


def test_the_time_limit_is_that_of_the_suite(suite, task):
    turned = replace(suite, worlds=tuple(world(y, yaw=3.1) for y in (-1.0, 0.0, 1.0)), time_limit=0.72)
    with suite_evaluator(suite_scene(make_scene(task, "raw"), turned), 1, "kinematic") as evaluator:
        drives = list(drives_of(evaluator, Straight()))
    assert [(drive.ended, drive.time) for drive in drives] == [("time limit", pytest.approx(0.7))] * 3


def test_a_world_without_obstacles_has_no_gap(task):
    empty = World.from_shapes("empty", start=(0.0, 0.0, 0.0), goal=(3.0, 0.0, 0.0), bounds=BOUNDS)
    suite = Suite("empty", (empty,), ("a",), (3.0,), 1.0)
    with suite_evaluator(suite_scene(make_scene(task, "raw"), suite), 1, "kinematic") as evaluator:
        assert [drive.closest for drive in drives_of(evaluator, Straight())] == [None]


def test_tasks_without_goals_of_the_worlds_are_refused(suite, northward):
    with pytest.raises(InputError, match="leads to the goals of its worlds, such as navigate"):
        suite_scene(make_scene(Wander(), "raw"), suite)
    with pytest.raises(InputError, match="leads to the goals"):
        suite_scene(make_scene(northward(), "raw"), suite)
    with pytest.raises(InputError, match=r"task\.goal_radius"):
        suite_scene(make_scene(ReachGoal(), "raw"), replace(suite, goal_radius=1.0))


def test_a_goal_of_the_tasks_own_gives_way_to_those_of_the_worlds(suite):
    assert suite_scene(make_scene(ReachGoal(goal=(1.0, 1.0)), "raw"), suite).goal_in(2) == (0.0, 1.0)
