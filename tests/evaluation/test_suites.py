"""The figures of a suite, by hand for a few episodes; and drives through its worlds."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation import suites
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.evaluation.suites import (
    SuiteEpisode,
    SuiteMetrics,
    SuiteResult,
    barn_score,
    restore_evaluation,
    run_suite,
    suite_evaluator,
    suite_metrics,
    suite_result,
    suite_scene,
)
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
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


def drive(number=0, ended="goal", time=10.0, distance=2.0, min_clearance=0.5, moving=None) -> SuiteEpisode:
    success, failed, family = ended == "goal", ended == "bump", "aba"[number % 3]
    moving = time if moving is None else moving
    return SuiteEpisode(
        number, ended, success, failed, time, moving, distance, min_clearance, f"world {number}", family
    )


# ---- BARN's score


@pytest.mark.parametrize(("time", "score"), [(20.0, 0.25), (9.0, 0.5), (11.0, 5 / 11), (39.0, 5 / 39), (41.0, 0.125)])
def test_the_score_of_barn_in_2024(time, score):
    """OT is 5 s; less than twice and more than eight times of it count alike."""
    assert barn_score(drive(moving=time, time=200.0), reference_length=10.0) == pytest.approx(score)
    assert barn_score(drive(ended="bump", moving=time), reference_length=10.0) == 0.0


def test_the_clock_of_barn_starts_after_a_tenth_of_a_metre(suite, make_episode):
    standing = make_episode("goal", True, 6, 1.0)
    path = np.array([[1.0, 1.0]] * 3 + [[1.0, 1.05], [1.0, 1.1001], [1.0, 1.2], [1.0, 1.3]], dtype=np.float32)
    started = SuiteEpisode.of(replace(standing, path=path, min_clearance=0.25), suite, control_period=0.5)
    assert (started.time, started.moving_time, started.min_clearance) == (3.0, 1.0, 0.25)
    assert SuiteEpisode.of(replace(standing, ended="time limit", success=False), suite, 0.5).moving_time == 0.0
    assert barn_score(SuiteEpisode.of(standing, suite, 0.5), 10.0) == 0.5, "at the goal without a move"


# ---- the figures

# A success along a detour, a collision, and a success after a path of 4 m that took 12 s.
DRIVES = (
    drive(0, time=8.0, distance=2.5),
    drive(1, "bump", 1.0, 0.1),
    drive(2, time=12.0, distance=3.4, min_clearance=0.1),
)


@pytest.fixture
def figures(suite, task) -> Callable[..., SuiteMetrics]:
    """A function that makes the figures of drives in the suite, or in a changed one."""
    scene = suite_scene(make_scene(task, "raw"), suite)
    return lambda drives=DRIVES, **changes: suite_metrics(replace(suite, **changes), scene, drives)


@pytest.fixture
def result(suite, task) -> SuiteResult:
    """The result of these drives."""
    config = resolve("dwa", "navigate", settings={"task.world": "loop", "task.guide": "plan"})
    scene, about = suite_scene(make_scene(task, "raw"), suite), {"policy": "agent dwa", "policy_digest": None}
    return suite_result(suite, scene, DRIVES, config, simulation="bullet", **about)


def test_the_figures_of_three_drives(figures):
    found, speed = figures(), ROBOT.max_speed
    assert found.worlds == 3
    assert found.success_rate == pytest.approx(2 / 3)
    assert found.success_interval == wilson_interval(2, 3)
    assert (found.failed_rate, found.time_limit_rate) == (pytest.approx(1 / 3), 0.0)
    # The goal is reached at half a metre from it. A drive that is shorter than the path counts as the path.
    assert found.spl == pytest.approx((1.5 / 2.5 + 0.0 + 1.0) / 3)
    assert found.time_ratio == pytest.approx((8.0 * speed / 1.5 + 12.0 * speed / 3.5) / 2)
    assert found.mean_speed == pytest.approx(6.0 / 21.0)
    assert found.mean_min_clearance == pytest.approx(0.3)
    assert found.longest_tenth_success_rate == 1.0, "the third world has the longest path"
    assert found.endings == {"bump": 1, "goal": 2}
    assert found.barn_score is None
    assert (figures(DRIVES[1:2]).time_ratio, figures(DRIVES[1:2]).mean_min_clearance) == (None, None)


def test_the_longest_tenth_are_the_worlds_with_the_longest_paths(figures):
    failed = figures([*DRIVES[:2], drive(2, "time limit")])
    assert (failed.longest_tenth_success_rate, failed.time_limit_rate) == (0.0, pytest.approx(1 / 3))
    many = figures([drive(i, "goal" if i != 19 else "bump") for i in range(21)], path_lengths=tuple(range(1, 22)))
    assert many.longest_tenth_success_rate == pytest.approx(2 / 3), "three of 21, rounded up"


def test_a_score_stands_where_there_are_reference_paths(figures):
    found = figures(reference_lengths=(10.0, 10.0, 20.0))  # OT 5, 5 and 10 s
    assert found.barn_score == pytest.approx((5.0 / 10.0 + 0.0 + 10.0 / 20.0) / 3)
    assert "2024" in found.barn_formula


def test_the_result_has_rows_for_families_and_names_the_misses(result, suite):
    assert result.title == "agent dwa, guide plan (map known), turtlebot2, PyBullet: suite tiny"
    assert (result.suite_digest, result.suite_path) == (suite.digest, None)
    assert [(name, row.worlds, row.success_rate) for name, row in result.rows.items()][:2] == [("a", 2, 1), ("b", 1, 0)]
    assert list(result.figures) == ["all", "a", "b"]
    assert [drive.world for drive in result.unsuccessful_episodes] == [1]
    assert list(replace(result, figures={"all": result.figures["all"], "a": result.figures["a"]}).rows) == ["all"]


# ---- again


def test_a_result_is_driven_again_step_by_step(suite, monkeypatch, tmp_path):
    tiny = replace(suite, worlds=suite.worlds * 2, families=suite.families * 2, path_lengths=suite.path_lengths * 2)
    monkeypatch.setattr(suites, "find_suite", lambda name, path: tiny)
    config = resolve("random", "navigate", settings={"task.world": "loop", "task.laser_noise": 0.01})
    scene = suite_scene(config.scene, tiny)
    with suite_evaluator(scene, 1, "kinematic") as evaluator:
        episodes = list(evaluator.run_from(make_baseline(config)))
    drives, about = (
        [SuiteEpisode.of(each, tiny, 0.1) for each in episodes],
        {"policy": "agent random", "policy_digest": None},
    )
    result = suite_result(tiny, scene, drives, config, simulation="kinematic", **about)
    evaluator, policy = restore_evaluation(result, tmp_path)
    for number in (4, 1, 5):
        path = [step.after.pose[0, :2] for step in evaluator.replay(policy, number)]
        np.testing.assert_array_equal(np.array(path, dtype=np.float32), episodes[number].path[1:])


def test_a_result_of_other_worlds_is_not_driven_again(result, suite, monkeypatch, tmp_path):
    with pytest.raises(InputError, match="unknown suite 'tiny'"):
        restore_evaluation(result, tmp_path)
    other = replace(suite, worlds=(*suite.worlds[:2], world(2.0)))
    monkeypatch.setattr(suites, "find_suite", lambda name, path: other)
    with pytest.raises(InputError, match="the worlds of suite tiny have changed since"):
        restore_evaluation(result, tmp_path)


# ---- into its worlds


def test_every_world_is_driven_once_from_its_start_to_its_goal(suite, task):
    suite = replace(suite, goal_radius=0.8, time_limit=4.0)
    scene = suite_scene(make_scene(task, "raw"), suite)
    assert (scene.task.start, scene.task.episode_steps, scene.task.goal_radius) == ("fixed", 40, 0.8)
    policy = Straight()
    with suite_evaluator(scene, workers=1) as evaluator:
        episodes = list(evaluator.run_from(policy))
        rest = list(run_suite(evaluator, policy, suite, first=1))
    assert [episode.start for episode in episodes] == [world.start for world in suite.worlds]
    assert [episode.world for episode in episodes] == [0, 1, 2]
    for episode, there in zip(episodes, suite.worlds, strict=True):
        assert (episode.ended, episode.success) == ("goal", True)
        distances = np.hypot(*(episode.path[:, :2] - there.goal[:2]).T)
        assert distances[-1] <= 0.8 < distances[-2]
        gap = 3.4 - episode.path[:, 1].max() - 0.178  # to the wall in the north, which each drive runs along
        assert episode.min_clearance == pytest.approx(gap, abs=1e-3)
    assert rest == [SuiteEpisode.of(episode, suite, 0.1) for episode in episodes[1:]]


class Straight:
    """Full speed ahead."""

    def predict(self, observation, *, deterministic=False):
        return np.array([1.0, 0.0], dtype=np.float32), None


def test_the_time_limit_is_that_of_the_suite_and_an_empty_world_has_no_gap(suite, task):
    empty = World.from_shapes("empty", start=(0.0, 0.0, 0.0), goal=(3.0, 0.0, 0.0), bounds=BOUNDS)
    turned = replace(suite, worlds=(world(-1.0, yaw=3.1), world(0.0, yaw=3.1), empty), time_limit=0.72)
    with suite_evaluator(suite_scene(make_scene(task, "raw"), turned), 1, "kinematic") as evaluator:
        drives = list(run_suite(evaluator, Straight(), turned))
    assert [(drive.ended, drive.time) for drive in drives] == [("time limit", pytest.approx(0.7))] * 3
    assert [drive.min_clearance is None for drive in drives] == [False, False, True]


def test_an_episode_that_exceeds_the_time_limit_of_its_own_world_has_not_succeeded(suite, task):
    limited = replace(suite, time_limit=8.0, time_limits=(8.0, 1.0, 8.0))
    with suite_evaluator(suite_scene(make_scene(task, "raw"), limited), 1, "kinematic") as evaluator:
        drives = list(run_suite(evaluator, Straight(), limited))
    assert [(drive.ended, drive.success) for drive in drives] == [("goal", True), ("time limit", False), ("goal", True)]


def test_tasks_without_goals_of_the_worlds_are_refused(suite, northward):
    with pytest.raises(InputError, match="leads to the goals of its worlds, such as navigate"):
        suite_scene(make_scene(Wander(), "raw"), suite)
    with pytest.raises(InputError, match="leads to the goals"):
        suite_scene(make_scene(northward(), "raw"), suite)
    own_goal = make_scene(ReachGoal(goal=(1.0, 1.0)), "raw")
    with pytest.raises(InputError, match=r"task\.goal_radius"):
        suite_scene(own_goal, replace(suite, goal_radius=1.0))
    assert suite_scene(own_goal, suite).goal_in(2) == (0.0, 1.0), "a goal of the task gives way to those of the worlds"


# ---- files

FIGURES = SuiteMetrics(1, 0.0, (0.0, 0.8), 1.0, 0.0, 0.0, None, 0.2, None, 0.0, {"bump": 1})
CONFIG = {"agent": {"name": "dwa"}, "task": {"name": "navigate", "robot": "turtlebot2"}, "train": {}}
SUMMARY = SuiteResult("unseen", "abc", "kinematic", "agent dwa", None, {"all": FIGURES}, CONFIG, {"numpy": "2"})
RESULT = replace(SUMMARY, suite_path="/somewhere/of/mine", episodes=(drive(),))


@pytest.mark.parametrize("kept", [RESULT, SUMMARY])
def test_a_result_is_read_as_it_was_written_and_its_summary_names_no_path(kept, tmp_path):
    file = tmp_path / "it.json"
    file.write_text(json.dumps(asdict(kept), allow_nan=False))
    assert SuiteResult.read(file) == kept
    assert kept.summary == SUMMARY


@pytest.mark.parametrize(
    ("task", "conditions"),
    [
        (
            {"dynamic_obstacles": [{"people": 3}, {"boxes": 1}, {"people": 1}, {"posts": 2, "presence": 0.5}]},
            "among 4 people and 1 box and 2 posts in 50% of the episodes, ",
        ),
        ({"variation": {"preset": "mild"}, "dynamic_obstacles": {"people": 1}}, "among 1 person, mild variation, "),
        (
            {"variation": {"laser_noise": 0.1}, "guide": "plan", "map": "online"},
            "guide plan (map online), variation of laser_noise, ",
        ),
    ],
)
def test_a_title_names_the_conditions(task, conditions):
    driven = replace(SUMMARY, config={**CONFIG, "task": {**CONFIG["task"], **task}})
    assert driven.title == f"agent dwa, {conditions}turtlebot2, kinematic simulator: suite unseen"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"episodes": [asdict(drive(1))]}, "its worlds are not in order"),
        ({"figures": {"all": asdict(FIGURES) | {"mean_speed": float("nan")}}}, "result.figures.all.mean_speed"),
        ({"simulation": "gazebo"}, "unknown simulator 'gazebo'"),
        ({"drives": 100}, "unknown key of result 'drives'"),
        (None, ""),
    ],
)
def test_files_that_are_no_results_are_refused_by_name(changes, named, tmp_path):
    file = tmp_path / "it.json"
    file.write_text("[" * 100_000 if changes is None else json.dumps(asdict(RESULT) | changes))
    with pytest.raises(InputError, match=r"it\.json is not the result of a suite: .*") as refused:
        SuiteResult.read(file)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
