"""Suite results on a page: metrics, and replays of the drives that missed their goal."""

from dataclasses import replace

import pytest

from tb2rl.evaluation import suites
from tb2rl.evaluation.suites import SuiteEpisode, SuiteResult, run_suite, suite_evaluator, suite_result, suite_scene
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.simulation.simulator import default_physics
from tb2rl.viz.page import page
from tb2rl.viz.suites import MAX_REPLAYS, SuiteSection, select_episodes, suite_section, suite_sections


def evaluated(suite, agent: str) -> SuiteResult:
    """The result of an agent that does not learn."""
    config = resolve(agent, "navigate", settings={"task.world": "loop"})
    scene, policy = suite_scene(config.scene, suite), make_baseline(config)
    with suite_evaluator(scene, workers=1) as evaluator:
        drives, about = list(run_suite(evaluator, policy, suite)), {"policy": f"agent {agent}", "policy_digest": None}
    return suite_result(suite, scene, drives, config, simulation=evaluator.simulator.name, **about)


@pytest.fixture
def known(small_suite, monkeypatch):
    """A function that makes a suite the one that is found from now on."""

    def set_suite(**changes):
        suite = replace(small_suite(), **changes)
        monkeypatch.setattr(suites, "find_suite", lambda *_: suite)
        return suite

    return set_suite


@pytest.fixture
def result(known) -> SuiteResult:
    """The result of the random agent, which reaches no goal."""
    return evaluated(known(), "random")


def drive(number: int, success: bool, min_clearance: float | None = 0.5, distance: float = 2.0) -> SuiteEpisode:
    ended = "goal" if success else "bump"
    return SuiteEpisode(
        number, ended, success, not success, 9.0, 9.0, distance, min_clearance, world_name=f"world {number}", family="a"
    )


def test_a_result_has_its_metrics_and_a_replay_of_each_failure(result, pages, tmp_path):
    bumped = replace(result.episodes[2], ended="bump")
    result = replace(result, episodes=(*result.episodes[:2], bumped))
    shown = pages(page([], [suite_section(tmp_path / "it.json", result)]))
    low, high = (f"{100 * bound:.1f} %" for bound in result.figures["all"].success_interval)
    for part in (
        f"agent random, guide goal, turtlebot2, {default_physics().title}: suite unseen",
        f"all 3 0.0 % {low} to {high} 0.0 % 100.0 % 0.000",
        "The goal was missed in 3 of 3 worlds. The replays show repeated episodes.",
        "at -1 (a): time limit after 1.0 s and",
    ):
        assert part in shown.text
    assert shown.text.count("the repeated episode ended by time limit") == 1
    assert "Score" not in shown.text
    assert (shown.count("canvas"), shown.source.count("\nfunction show(")) == (3, 1), "the code is there once"


def test_without_failures_the_drive_nearest_to_an_obstacle_is_shown(known, pages, tmp_path):
    result = evaluated(known(time_limit=6.0, reference_lengths=(8.0, 8.0, 8.0)), "pursuit")
    section = suite_section(tmp_path / "it.json", result)
    assert [(drive.world_name, replay["ended"]) for drive, replay in section.episodes] == [("at 1", "goal")]
    shown = pages(page([], [section]))
    assert "The goal was reached in every world. This is the episode nearest to an obstacle." in shown.text
    assert "Score: BARN 2024: 2 OT to 8 OT." in shown.text
    assert shown.count("canvas") == 1


def test_the_first_failures_or_the_nearest_or_the_longest_drive_are_shown(result, pages):
    def shown(*drives: SuiteEpisode) -> list[int]:
        return [drive.world for drive in select_episodes(replace(result, episodes=drives))]

    failures = tuple(drive(i, False) for i in range(MAX_REPLAYS + 1))
    assert shown(*failures, drive(MAX_REPLAYS + 1, True)) == list(range(MAX_REPLAYS))
    assert shown(drive(0, True, 0.5), drive(1, True, 0.1), drive(2, True, None)) == [1]
    assert shown(drive(0, True, None, 2.0), drive(1, True, None, 3.0)) == [1]
    section = SuiteSection(
        replace(result, episodes=failures), [(one, None) for one in failures[:MAX_REPLAYS]], error="no policy"
    )
    text = pages(page([], [section])).text
    shown_count = f"missed in {MAX_REPLAYS + 1} of 3 worlds; the first {MAX_REPLAYS} are shown"
    assert f"{shown_count}, and the result file lists all" in text
    assert "There are no replays: no policy." in text


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"policy": "runs/gone", "policy_digest": "abc"}, "runs/gone"),
        ({"config": {"agent": {"name": "random"}, "task": {"name": "gone:Task"}, "train": {}}}, "gone"),
        ({"suite": "mine"}, "unknown suite 'mine'"),
    ],
)
def test_episodes_that_cannot_be_repeated_are_a_line_on_the_page(changes, error, result, pages, tmp_path, monkeypatch):
    monkeypatch.undo()
    section = suite_section(tmp_path / "it.json", replace(result, **changes))
    assert error in section.error
    shown = pages(page([], [section]))
    assert f"There are no replays: {' '.join(section.error.split())}." in shown.text
    assert "at -1" in shown.text, "failures are named all the same"
    assert shown.count("canvas") == 0


def test_results_of_several_simulators_end_with_their_difference(referees, result, pages, tmp_path):
    results = [replace(result.summary, simulation=name) for name in ("first", "second")]
    results[0] = replace(results[0], unsuccessful_worlds=(0, 1))
    first, second = suite_sections(tmp_path / "it.json", results)
    assert (first.comparison, len(second.comparison)) == ((), 1)
    text = pages(page([], [first, second])).text
    assert text.count("sim-to-sim difference (success) Second - First: -33.3 points") == 1
    assert text.index("First: suite unseen") < text.index("Second: suite unseen") < text.index("sim-to-sim")


def test_a_summary_has_its_figures_on_the_page_and_no_drives(result, pages, tmp_path):
    shown = pages(page([], [suite_section(tmp_path / "it.json", result.summary)])).text
    assert "all 3 0.0 %" in shown
    assert "No failures" not in shown
