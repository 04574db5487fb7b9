"""Suite results on a page: metrics, and films of the drives that missed their goal."""

from __future__ import annotations

import io
from base64 import b64decode
from dataclasses import replace

import pytest
from PIL import Image

from tb2rl.evaluation import suites
from tb2rl.evaluation.suite_result import NamedDrive, SuiteResult
from tb2rl.evaluation.suites import SuiteEvaluation, drives_of, suite_evaluator, suite_scene
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.viz.page import page
from tb2rl.viz.suites import FILMS, SuiteSection, shown_drives, suite_section


def evaluated(suite, agent: str) -> SuiteResult:
    """The result of an agent that does not learn."""
    config = resolve(agent, "navigate", settings={"task.world": "loop"})
    scene, policy = suite_scene(config.scene, suite), make_baseline(config)
    with suite_evaluator(scene, workers=1) as evaluator:
        evaluation = SuiteEvaluation(suite, scene, list(drives_of(evaluator, policy)), evaluator.simulator.name)
    return evaluation.result(config, f"agent {agent}", None)


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


def drive(number: int, success: bool, closest: float | None = 0.5, distance: float = 2.0) -> NamedDrive:
    ended = "goal" if success else "bump"
    return NamedDrive(
        number, ended, success, not success, 9.0, 9.0, distance, closest, name=f"world {number}", family="a"
    )


def test_a_result_has_its_metrics_and_a_film_of_each_failure(result, pages, tmp_path):
    bumped = replace(result.each[2], ended="bump")
    result = replace(result, each=(*result.each[:2], bumped))
    shown = pages(page([], [suite_section(tmp_path / "it.json", result)]))
    low, high = (f"{100 * bound:.1f} %" for bound in result.figures["all"].success_interval)
    for part in (
        "agent random, guide goal, turtlebot2, PyBullet: suite unseen",
        f"all 3 0.0 % {low} to {high} 0.0 % 100.0 % 0.000",
        "The goal was missed in 3 of 3 worlds. The films show repeated episodes in PyBullet.",
        "at -1 (a): time limit after 1.0 s and",
        "playback speed 4",
    ):
        assert part in shown.text
    assert shown.text.count("the repeated episode ended by time limit") == 1
    assert "Score" not in shown.text
    films = {attributes["src"] for tag, attributes in shown.elements if tag == "img"}
    assert len(films) == 3
    with Image.open(io.BytesIO(b64decode(films.pop().removeprefix("data:image/gif;base64,")))) as picture:
        assert (picture.format, picture.n_frames > 1) == ("GIF", True)


def test_without_failures_the_drive_nearest_to_an_obstacle_is_shown(known, pages, tmp_path):
    result = evaluated(known(time_limit=6.0, references=(8.0, 8.0, 8.0)), "pursuit")
    section = suite_section(tmp_path / "it.json", result)
    assert [(drive.name, film.ended) for drive, film in section.shown] == [("at 1", "goal")]
    shown = pages(page([], [section]))
    assert "The goal was reached in every world. This is the drive nearest to an obstacle." in shown.text
    assert "Score: BARN 2024: 2 OT to 8 OT." in shown.text
    assert shown.count("img") == 1


def test_the_first_failures_or_the_nearest_or_the_longest_drive_are_shown(result, pages):
    def shown(*drives: NamedDrive) -> list[int]:
        return [drive.world for drive in shown_drives(replace(result, each=drives))]

    failures = tuple(drive(i, False) for i in range(FILMS + 1))
    assert shown(drive(9, True), *failures) == list(range(FILMS))
    assert shown(drive(0, True, 0.5), drive(1, True, 0.1), drive(2, True, None)) == [1]
    assert shown(drive(0, True, None, 2.0), drive(1, True, None, 3.0)) == [1]
    section = SuiteSection(replace(result, each=failures), [(one, None) for one in failures[:FILMS]], error="no policy")
    text = pages(page([], [section])).text
    assert f"missed in {FILMS + 1} of 3 worlds; the first {FILMS} are shown, and the result file lists all" in text
    assert "There are no films: no policy." in text


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"policy": "runs/gone", "policy_digest": "abc"}, "runs/gone"),
        ({"config": {"agent": {"name": "random"}, "task": {"name": "gone:Task"}, "train": {}}}, "gone"),
        ({"suite": "mine"}, "unknown suite 'mine'"),
    ],
)
def test_episodes_that_cannot_be_repeated_are_a_line_on_the_page(changes, error, result, pages, tmp_path, monkeypatch):
    if "suite" in changes:
        monkeypatch.undo()
    section = suite_section(tmp_path / "it.json", replace(result, **changes))
    assert error in section.error
    shown = pages(page([], [section]))
    assert f"There are no films: {' '.join(section.error.split())}." in shown.text
    assert "at -1" in shown.text, "failures are named all the same"
    assert shown.count("img") == 0


def test_names_are_text_whatever_they_contain(result, pages):
    named = replace(result, policy="<b>bold", each=(replace(result.each[0], name="<i>", ended="<u>"),))
    shown = pages(page([], [SuiteSection(named, [(named.each[0], None)], error="<s>")]))
    assert [part for part in ("<b>bold", "<i>", "<u>", "<s>") if part not in shown.text] == []
    assert [shown.count(tag) for tag in "bius"] == [0, 0, 0, 0]
