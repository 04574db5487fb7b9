"""Replays in the report: the values of an episode, and a few replays of the best runs. test_browser.py plays them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.evaluation.episodes import EpisodeStep
from tb2rl.viz import page as page_module
from tb2rl.viz import replay as replay_module
from tb2rl.viz.film import FilmOptions, open_episodes
from tb2rl.viz.page import page
from tb2rl.viz.replay import make_replay, run_replays
from tb2rl.viz.run_views import RunView, group_runs


@pytest.fixture(scope="module")
def drive(make):
    """The control steps and the scene of an episode of five steps, straight ahead among people."""
    config = make.config("maze", dynamic_obstacles=[{"people": 2}, {"boxes": 1}], beams=181)
    options = FilmOptions(steps=5, simulation="kinematic")
    with open_episodes(make.policy(), config, None, options, "driving") as (scene, episodes):
        (steps,) = map(list, episodes)
    return steps, scene


def test_a_replay_has_the_states_the_beams_and_the_texts_of_an_episode(drive):
    steps, scene = drive
    replay = json.loads(json.dumps(make_replay(steps, scene)))
    states = [steps[0].before, *(step.after for step in steps)]
    np.testing.assert_allclose(replay["poses"], 1000 * np.array([state.pose[0] for state in states]), atol=0.5)
    np.testing.assert_allclose(replay["times"], scene.task.control_period * np.arange(6))
    assert [len(row) for row in replay["ranges"]] == [36] * 6
    outer = [0, -1]  # the only beams that are among all and among the drawn ones for certain
    for state, ranges in zip(states, np.array(replay["ranges"]), strict=True):
        np.testing.assert_allclose(ranges[outer], 100 * state.ranges[0, outer], atol=1)
    assert [len(row) for row in replay["obstacles"]] == [3] * 6
    assert sorted(width > 0 for _, width in replay["shapes"]) == [False, False, True]
    *numbers, action, reason = replay["rows"][-1]
    assert numbers[2:] == pytest.approx([steps[-1].reward, steps[-1].episode_return], abs=1e-3)
    assert [replay["texts"][index] for index in (action, reason)] == ["forward", ""]
    assert replay["ended"] == steps[-1].info["ended"]


def test_walls_are_a_union_with_holes(drive):
    walls = make_replay(*drive)["walls"]
    assert sorted(len(rings) for rings in walls) == [1, 2], "an island, and outer walls around the corridor"


def test_a_long_episode_keeps_few_states_and_its_last_one(drive, monkeypatch):
    monkeypatch.setattr(replay_module, "_MAX_STATES", 3)
    steps, scene = drive
    replay = make_replay(steps, scene)
    numbers = [round(time / scene.task.control_period) for time in replay["times"]]
    assert numbers == [0, 2, 4, 5]
    assert {len(replay[key]) for key in ("poses", "ranges", "obstacles")} == {4}


@pytest.fixture
def short(views, monkeypatch) -> RunView:
    """A run whose replays have three steps at most, although its evaluation has fifty."""
    monkeypatch.setattr(replay_module, "RUN_STEPS", 3)
    return views[0]


def test_replays_of_a_run_are_the_first_steps_of_its_evaluation(short):
    shown = run_replays(short)
    assert (shown["simulator"], shown["error"]) == ("kinematic", "")
    assert [(replay["ended"], len(replay["times"])) for replay in shown["replays"]] == [("", 4)] * 3
    assert len({tuple(replay["poses"][0]) for replay in shown["replays"]}) == 3, "three initial states"


def test_a_policy_that_cannot_drive_is_a_line_on_the_page(short, make, pages):
    other = make.evaluation([make.episode(np.zeros((2, 2)), [0])], beams=5)
    shown = pages(page(group_runs([replace(short, evaluation=other)])))
    assert "There are no replays of seed-0: the policy has the observation space" in shown.text
    assert "map" in shown.ids
    assert shown.count("canvas") == 0


def test_of_many_runs_the_best_have_replays_and_their_texts_run_no_code(short, make, pages, monkeypatch):
    def describe(steps: list[EpisodeStep], scene) -> dict:
        return {**make_replay(steps, scene), "texts": ["</script><b>"]}

    monkeypatch.setattr(replay_module, "make_replay", describe)
    monkeypatch.setattr(page_module, "action_map", lambda *_: None)  # takes most of the time
    endings = [[make.episode(np.zeros((2, 2)), [0], ended)] for ended in ("collision", "goal")]
    evaluations, config = [replace(short.evaluation, episodes=each) for each in endings], short.config
    configs = [replace(config, train=replace(config.train, seed=seed)) for seed in range(5)]
    named = [{"name": f"run {i}", "config": configs[i], "evaluation": evaluations[i % 2]} for i in range(5)]
    shown = pages(page(group_runs([replace(short, **changes) for changes in named])))
    assert "The first episodes of the evaluation by the best 3 of 5 runs" in shown.text
    names = [attributes["aria-label"] for tag, attributes in shown.elements if attributes.get("class") == "replay"]
    assert names[::3] == ["run 1, episode 1", "run 3, episode 1", "run 0, episode 1"]
    assert shown.count("b") == 0
