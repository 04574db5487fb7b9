"""Files of suite results: read as they were written, or refused by name."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest

from tb2rl.core.errors import InputError
from tb2rl.evaluation.suite_result import Figures, NamedDrive, SuiteResult, SuiteSummary, kept_result, kept_summary

FIGURES = Figures(1, 0.0, (0.0, 0.8), 1.0, 0.0, 0.0, None, 0.2, None, 0.0, {"bump": 1})
DRIVE = NamedDrive(0, "bump", False, True, 5.0, 4.5, 1.0, 0.0, name="rooms 0", family="rooms")
CONFIG = {"agent": {"name": "dwa"}, "task": {"name": "navigate", "robot": "turtlebot2"}, "train": {}}
SUMMARY = SuiteSummary("unseen", "abc", "kinematic", "agent dwa", None, {"all": FIGURES}, CONFIG, {"numpy": "2"})
RESULT = SuiteResult(**vars(SUMMARY), suite_path="/somewhere/of/mine", each=(DRIVE,))


def test_a_result_is_read_as_it_was_written(tmp_path):
    file = tmp_path / "it.json"
    file.write_text(json.dumps(asdict(RESULT), allow_nan=False))
    assert kept_result(file) == RESULT
    assert RESULT.title == "agent dwa, turtlebot2, kinematic simulator: suite unseen"


@pytest.mark.parametrize(
    ("task", "conditions"),
    [
        (
            {"dynamic_obstacles": [{"people": 3}, {"boxes": 1}, {"people": 1}, {"posts": 2, "presence": 0.5}]},
            "among 4 people and 1 box and 2 posts in 50% of the episodes, ",
        ),
        ({"variation": "strong"}, "strong variation, "),
        ({"variation": {"preset": "mild"}, "dynamic_obstacles": {"people": 1}}, "among 1 person, mild variation, "),
        ({"variation": {"laser_noise": 0.1}}, "variation of laser_noise, "),
        ({"variation": "none", "guide": "plan", "map": "online"}, "guide plan (map online), "),
        ({"guide": "goal", "map": "known"}, "guide goal, "),
    ],
)
def test_a_title_names_the_conditions(task, conditions):
    driven = replace(SUMMARY, config={**CONFIG, "task": {**CONFIG["task"], **task}})
    assert driven.title == f"agent dwa, {conditions}turtlebot2, kinematic simulator: suite unseen"


def test_a_summary_names_no_path_and_is_read_as_it_was_written(tmp_path):
    assert RESULT.summary == SUMMARY
    file = tmp_path / "it.json"
    file.write_text(json.dumps(asdict(RESULT.summary), allow_nan=False))
    assert "somewhere" not in file.read_text()
    assert kept_summary(file) == SUMMARY
    file.write_text(json.dumps(asdict(RESULT)))
    with pytest.raises(InputError, match=r"it\.json is not the summary of a suite: .*'suite_path'"):
        kept_summary(file)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"each": []}, "result.each"),
        ({"each": [asdict(DRIVE) | {"world": 1}]}, "its worlds are not in order"),
        ({"each": [asdict(DRIVE) | {"time": "long"}]}, "result.each.0.time"),
        ({"figures": {"rooms": asdict(FIGURES)}}, "the figures of all worlds"),
        ({"figures": {"all": asdict(FIGURES) | {"spl": 7}}}, "result.figures.all.spl"),
        ({"figures": {"all": asdict(FIGURES) | {"mean_speed": float("nan")}}}, "result.figures.all.mean_speed"),
        ({"simulation": "gazebo"}, "unknown simulator 'gazebo'"),
        ({"config": {"task": 3}}, "result.config.task"),
        ({"episodes": 100}, "unknown key of result 'episodes'"),
    ],
)
def test_values_that_do_not_fit_are_refused_by_name(changes, named, tmp_path):
    check_refused(json.dumps(asdict(RESULT) | changes), named, tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, '{"suite": "unseen"}'])
def test_a_file_without_a_result_is_refused(text, tmp_path):
    check_refused(text, "", tmp_path)


def check_refused(text: str, named: str, tmp_path) -> None:
    file = tmp_path / "it.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"it\.json is not the result of a suite: .*") as refused:
        kept_result(file)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
