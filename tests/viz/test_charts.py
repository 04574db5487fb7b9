"""Charts show their data: curves at the height of their values, marks and colours at their positions."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.viz.charts import ACTION_COLOURS, MAX_WORLDS, distinct_colours, draw_episodes
from tb2rl.viz.page import learning_curves
from tb2rl.viz.run_views import group_runs
from tb2rl.worlds.registry import find_world


def marks(picture: str, kind: str) -> np.ndarray:
    """Positions of marks in a picture, shape (marks, 2)."""
    uses = ElementTree.fromstring(picture).findall(f".//{{*}}g[@id='{kind}']//{{*}}use")
    return np.array([(float(use.attrib["x"]), float(use.attrib["y"])) for use in uses]).reshape(-1, 2)


def lines_in(picture: str) -> dict[str, np.ndarray]:
    """The points of each curve in a picture."""
    found = re.findall(r'<g id="((?:mean|seed)[-\d]+)">\s*<path d="([^"]*)"', picture)
    return {name: np.array(re.findall(r"[ML] (\S+) (\S+)", path), dtype=float) for name, path in found}


def is_linear(values: np.ndarray, positions: np.ndarray) -> bool:
    """Whether positions in a picture are a linear function of the values, up to rounding."""
    assert len(values) == len(positions)
    fitted = np.polyval(np.polyfit(values, positions, 1), values) if np.ptp(values) else positions.mean()
    return bool(np.abs(positions - fitted).max() < 0.01)


# ---- learning curves


def test_curves_show_the_numbers_of_the_runs(views):
    keys = {
        "Return in training (exploring policy)": "rollout/ep_rew_mean",
        "Length in training (exploring policy)": "rollout/ep_len_mean",
        "Failures in training (exploring policy)": "rollout/failure_rate",
        "Evaluations (greedy policy): failure-free": "failure_free_rate",
    }
    charts = learning_curves(group_runs(views))
    assert [chart["title"] for chart in charts] == list(keys)
    for chart in charts:
        mean = chart["groups"][0].mean
        drawn = lines_in(chart["picture"])
        assert drawn.keys() == {"mean-0", "seed-0-0", "seed-0-1"}
        values = [mean.values, *(view.curves[keys[chart["title"]]].values for view in views)]
        heights = np.concatenate([drawn[name][:, 1] for name in ("mean-0", "seed-0-0", "seed-0-1")])
        assert is_linear(np.concatenate(values), heights)
        assert is_linear(mean.steps, drawn["mean-0"][:, 0])


def test_colours_are_distinct():
    for count in (1, len(ACTION_COLOURS), len(ACTION_COLOURS) + 1, 40):
        found = distinct_colours(count, ACTION_COLOURS)
        assert len(set(found)) == count
        assert all(re.fullmatch("#[0-9a-f]{6}", colour) for colour in found)


# ---- episodes


def test_starts_failures_and_the_goal_are_marked(make):
    paths = [[(0, 0), (1, 2), (3, 1)], [(1, -2), (2, 2.5), (4, 2)], [(5, 1), (0, 1), (1, -1)]]
    endings = [("collision", True), ("goal", False), ("out of bounds", True)]
    episodes = [make.episode(path, [0, 0], *ending) for path, ending in zip(paths, endings, strict=True)]
    picture = draw_episodes(make.evaluation(episodes, ReachGoal()))
    drawn = [marks(picture, kind) for kind in ("starts", "failures", "goal")]
    assert [len(positions) for positions in drawn] == [3, 2, 1]
    expected = [*(path[0] for path in paths), paths[0][-1], paths[2][-1], find_world("wall").goal[:2]]
    (x, y), positions = np.array(expected).T, np.concatenate(drawn)
    assert is_linear(x, positions[:, 0])
    assert is_linear(y, positions[:, 1])
    assert (positions[y.argmax(), 1], positions[x.argmax(), 0]) == (positions[:, 1].min(), positions[:, 0].max())


def test_each_of_several_worlds_has_axes_of_its_own(make):
    """Worlds with failures come first, and only some of many worlds are drawn."""
    worlds = [0, 0, 2, *range(3, 16)]
    episodes = [
        replace(make.episode([(1, 1), (2, world)], [0], "collision" if world == 2 else "time limit"), world=world)
        for world in worlds
    ]
    generated = {"generator": "clutter", "worlds": 16, "difficulty": 0.3}
    evaluation = make.evaluation(episodes, ReachGoal(world=generated, start_clearance=0.3))
    picture = draw_episodes(evaluation)
    assert re.findall(r'id="starts-(\d+)"', picture) == ["2", "0", *map(str, range(3, MAX_WORLDS + 1))]
    assert [len(marks(picture, f"starts-{world}")) for world in (2, 0, 3)] == [1, 2, 1]
    assert [len(marks(picture, f"failures-{world}")) for world in (2, 0, 3)] == [1, 0, 0]
