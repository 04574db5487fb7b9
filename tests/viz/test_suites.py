"""What a report says of a suite: the figures, and films of the drives that did not reach their goal."""

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


def driven(suite, agent: str) -> SuiteResult:
    """What an agent that does not learn does in a suite."""
    config = resolve(agent, "navigate", settings={"task.world": "loop"})
    scene, policy = suite_scene(config.scene, suite), make_baseline(config)
    with suite_evaluator(scene, workers=1) as evaluator:
        evaluation = SuiteEvaluation(suite, scene, list(drives_of(evaluator, policy)), evaluator.simulation)
    return evaluation.result(config, f"agent {agent}", None)


@pytest.fixture
def known(small_suite, monkeypatch):
    """A function that makes a suite the one that is found from now on."""

    def set_suite(**changes):
        suite = replace(small_suite(), **changes)
        monkeypatch.setattr(suites, "find_suite", lambda name, path: suite)
        return suite

    return set_suite


def drive(number: int, success: bool, closest: float | None = 0.5, distance: float = 2.0) -> NamedDrive:
    ended = "goal" if success else "bump"
    return NamedDrive(
        number, ended, success, not success, 9.0, 9.0, distance, closest, name=f"world {number}", family="a"
    )


def test_a_result_has_its_figures_and_a_film_of_each_world_that_failed(known, pages, tmp_path):
    result = driven(known(), "random")
    shown = pages(page([], [suite_section(tmp_path / "it.json", result)]))
    low, high = (f"{100 * bound:.1f} %" for bound in result.figures["all"].success_interval)
    for part in (
        "agent random, guide goal, turtlebot2, PyBullet: suite unseen",
        f"all 3 0.0 % {low} to {high} 0.0 % 100.0 % 0.000",
        "It did not reach the goal in 3 of 3 worlds. The films are of drives that were driven again in PyBullet.",
        "at -1 (a): time limit after 1.0 s and",
        "at 0 (b): time limit after 1.0 s and",
        "4 times as fast",
    ):
        assert part in shown.text
    assert "this time it ended by" not in shown.text
    assert "score" not in shown.text
    films = [attributes["src"] for tag, attributes in shown.elements if tag == "img"]
    for film in films:
        with Image.open(io.BytesIO(b64decode(film.removeprefix("data:image/gif;base64,")))) as picture:
            assert (picture.format, picture.n_frames > 1) == ("GIF", True)
    assert len(set(films)) == 3


def test_where_nothing_failed_the_page_says_so_and_shows_one_drive(known, pages, tmp_path):
    result = driven(known(time_limit=6.0), "pursuit")
    section = suite_section(tmp_path / "it.json", result)
    assert [drive.name for drive, _ in section.shown] == ["at 1"], "which is the nearest to the wall"
    assert section.shown[0][1].ended == "goal"
    shown = pages(page([], [section]))
    assert "It reached the goal in every world. This is where it came nearest to an obstacle." in shown.text
    assert [tag for tag, _ in shown.elements].count("img") == 1


def test_the_first_that_failed_are_shown_or_the_one_that_came_nearest_or_drove_farthest(known):
    result = driven(known(), "random")

    def shown(*drives: NamedDrive) -> list[int]:
        return [drive.world for drive in shown_drives(replace(result, each=drives))]

    assert shown(drive(0, True), *(drive(i, False) for i in range(1, 20))) == list(range(1, 1 + FILMS))
    assert shown(drive(0, True, 0.5), drive(1, True, 0.1), drive(2, True, None)) == [1]
    assert shown(drive(0, True, None, 2.0), drive(1, True, None, 3.0)) == [1]


def test_the_page_says_that_not_all_are_shown_and_where_a_drive_ended_otherwise(known, pages):
    each = tuple(drive(i, False) for i in range(FILMS + 1))
    result = replace(driven(known(), "random"), each=each)
    section = SuiteSection(result, [(one, None) for one in each[:FILMS]], trouble="the policy went away")
    text = pages(page([], [section])).text
    assert f"goal in {FILMS + 1} of 3 worlds; the first {FILMS} of them are shown, the file of the result" in text
    assert "There are no films: the policy went away." in text


def test_a_drive_that_ends_otherwise_is_told(known, pages, tmp_path):
    result = driven(known(), "random")
    collided = replace(result, each=tuple(replace(one, ended="bump") for one in result.each))
    text = pages(page([], [suite_section(tmp_path / "it.json", collided)])).text
    assert text.count("this time it ended by time limit") == 3


def test_a_score_stands_beside_its_formula(known, pages, tmp_path):
    result = driven(known(references=(8.0, 8.0, 8.0)), "pursuit")
    text = pages(page([], [suite_section(tmp_path / "it.json", result)])).text
    assert "The score goes by BARN 2024: 2 OT to 8 OT." in text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"policy": "runs/gone", "policy_digest": "abc"}, "the policy runs/gone that drove it is not there"),
        ({"suite_digest": "abc"}, "the worlds of suite unseen are not those that it drove in"),
        ({"config": {"agent": {"name": "random"}, "task": {"name": "gone:Task"}, "train": {}}}, "gone"),
    ],
)
def test_what_cannot_be_driven_again_is_a_line_on_the_page(changes, said, known, pages, tmp_path):
    check_trouble(replace(driven(known(), "random"), **changes), said, pages, tmp_path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"suite": "barn", "suite_path": "gone.npz"}, "gone.npz"), ({"suite": "mine"}, "unknown suite 'mine'")],
)
def test_worlds_that_are_not_there_are_a_line_on_the_page(changes, said, known, pages, tmp_path, monkeypatch):
    result = driven(known(), "random")
    monkeypatch.undo()
    check_trouble(replace(result, **changes), said, pages, tmp_path)


def check_trouble(result: SuiteResult, said: str, pages, tmp_path) -> None:
    section = suite_section(tmp_path / "it.json", result)
    assert said in section.trouble
    shown = pages(page([], [section]))
    assert f"There are no films: {' '.join(section.trouble.split())}." in shown.text
    assert "at -1" in shown.text, "what failed is named all the same"
    assert [tag for tag, _ in shown.elements].count("img") == 0


def test_names_are_text_wherever_they_come_from(known, pages):
    result = driven(known(), "random")
    named = replace(result, policy="<b>bold", each=(replace(result.each[0], name="<i>", ended="<u>"),))
    shown = pages(page([], [SuiteSection(named, [(named.each[0], None)], trouble="<s>")]))
    assert [part for part in ("<b>bold", "<i>", "<u>", "<s>") if part not in shown.text] == []
    assert {"b", "i", "u", "s"}.isdisjoint(tag for tag, _ in shown.elements)
