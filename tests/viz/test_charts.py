"""Charts show what they are made from: lines as high as values, marks where things happened, colour where time went."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.viz.charts import WIDTH, draw_curves, draw_time, draw_ways, shown_worlds, time_shares, with_own_ids
from tb2rl.viz.curves import Curve, Family
from tb2rl.viz.groups import grouped
from tb2rl.viz.page import charts
from tb2rl.viz.subjects import read_subject
from tb2rl.worlds.registry import find_world


def marks(picture: str, kind: str) -> np.ndarray:
    """Where marks stand in a picture, shape (marks, 2)."""
    uses = ElementTree.fromstring(picture).findall(f".//{{*}}g[@id='{kind}']//{{*}}use")
    return np.array([(float(use.attrib["x"]), float(use.attrib["y"])) for use in uses]).reshape(-1, 2)


def lines_in(picture: str) -> dict[str, np.ndarray]:
    """The points of each curve in a picture."""
    found = re.findall(r'<g id="((?:mean|seed)[-\d]+)">\s*<path d="([^"]*)"', picture)
    return {name: points_of(path) for name, path in found}


def points_of(path: str) -> np.ndarray:
    return np.array([(float(x), float(y)) for x, y in re.findall(r"[ML] (\S+) (\S+)", path)])


def on_a_line(values: np.ndarray, places: np.ndarray) -> bool:
    """Whether places in a picture are a linear function of the values, as far as its digits go."""
    assert len(values) == len(places)
    fitted = np.polyval(np.polyfit(values, places, 1), values) if np.ptp(values) else places.mean()
    return bool(np.abs(places - fitted).max() < 0.01)


# ---- learning curves


@pytest.mark.parametrize(
    ("title", "tag"),
    [
        ("Return while training", "rollout/ep_rew_mean"),
        ("Length while training", "rollout/ep_len_mean"),
        ("Failures while training", "rollout/failure_rate"),
        ("Evaluations on the way: failure-free", "failure_free_rate"),
    ],
)
def test_curves_are_drawn_with_the_numbers_of_the_runs(title, tag, seeds):
    subjects = [read_subject(seeds / name, name) for name in ("seed-0", "seed-1")]
    (chart,) = [chart for chart in charts(grouped(subjects)) if chart.title == title]
    mean = chart.families[0].mean
    drawn = lines_in(chart.picture)
    assert drawn.keys() == {"mean-0", "seed-0-0", "seed-0-1"}
    values = [mean.values, *(subject.curves[tag].values for subject in subjects)]
    heights = np.concatenate([drawn[name][:, 1] for name in ("mean-0", "seed-0-0", "seed-0-1")])
    assert on_a_line(np.concatenate(values), heights), "as high as their values"
    assert on_a_line(mean.steps, drawn["mean-0"][:, 0]), "as far right as their steps"


def test_what_is_shaded_is_the_interval_of_the_mean():
    steps = np.array([0.0, 10.0, 20.0])
    family = Family("", "red", [Curve(steps, np.array([0.0, 1.0, 2.0])), Curve(steps, np.array([4.0, 1.5, 5.0]))])
    picture = draw_curves([family], "", rate=False)
    ((_, down),) = marks(picture, "interval-0")
    outline = ElementTree.fromstring(picture).find(".//{*}g[@id='interval-0']//{*}path").attrib["d"]
    heights = down + points_of(outline)[:, 1]
    mean = lines_in(picture)["mean-0"][:, 1]
    values = np.concatenate([family.mean.values, np.unique(family.interval)[::-1]])
    assert on_a_line(values, np.concatenate([mean, np.unique(heights)]))
    assert "interval-" not in draw_curves([Family("", "red", family.curves[:1])], "", rate=False)


def test_charts_on_one_page_do_not_share_ids():
    steps = np.array([0.0, 1.0])
    picture = draw_curves([Family("", "red", [Curve(steps, steps)])], "", rate=True)
    first, second = (set(re.findall(r'\bid="([^"]*)"', with_own_ids(picture, number))) for number in (1, 2))
    assert first
    assert first.isdisjoint(second)
    used = re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', with_own_ids(picture, 1))
    assert {name for pair in used for name in pair if name} <= first


# ---- what happened where


@pytest.mark.parametrize("failing", ["collision", "out of bounds"])
def test_starts_failures_and_the_goal_are_marked_where_they_are(failing, make):
    paths = [[(0, 0), (1, 2), (3, 1)], [(1, -2), (2, 2.5), (4, 2)], [(5, 1), (0, 1), (1, -1)]]
    endings = [(failing, True), ("goal", False), (failing, True)]
    ways = [make.episode(path, [0, 0], *ending) for path, ending in zip(paths, endings, strict=True)]
    picture = draw_ways(make.evaluation(ways, ReachGoal()))
    drawn = [marks(picture, kind) for kind in ("starts", "failures", "goal")]
    assert [len(places) for places in drawn] == [3, 2, 1]
    goal = find_world("wall").goal[:2]
    meant = np.array([path[0] for path in paths] + [paths[0][-1], paths[2][-1], goal])
    (x, y), places = meant.T, np.concatenate(drawn)
    assert on_a_line(x, places[:, 0])
    assert on_a_line(y, places[:, 1])
    assert (places[y.argmax(), 1], places[x.argmax(), 0]) == (places[:, 1].min(), places[:, 0].max()), "y is up"


@pytest.mark.parametrize("ended", ["time limit", "collision"])
def test_without_failures_or_a_goal_only_starts_are_marked(ended, make):
    picture = draw_ways(make.evaluation([make.episode([(0, 4), (1, 4)], [0], ended, failed=False)]))
    assert [len(marks(picture, kind)) for kind in ("starts", "failures", "goal")] == [1, 0, 0]


def test_each_of_several_worlds_has_a_picture_of_its_own(make):
    """Episodes are drawn where they drove, and those worlds come first where one failed."""
    worlds = [0, 0, 2, *range(3, 20)]
    ways = [
        replace(make.episode([(1, 1), (2, world)], [0], "collision" if world == 2 else "time limit"), world=world)
        for world in worlds
    ]
    generated = {"generator": "clutter", "worlds": 20, "difficulty": 0.3}
    evaluation = make.evaluation(ways, ReachGoal(world=generated, start_clearance=0.3))
    together = shown_worlds(evaluation)
    assert list(together) == [2, 0, *range(3, 13)]
    assert together[0] == ways[:2]
    picture = draw_ways(evaluation)
    assert [len(marks(picture, f"starts-{world}")) for world in together] == [1, 2, *[1] * 10]
    assert [len(marks(picture, f"failures-{world}")) for world in together] == [1, *[0] * 11]
    ((x, y),), ((goal_x, goal_y),) = marks(picture, "starts-2"), marks(picture, "goal-2")
    goal = evaluation.scene.spec.worlds[2].goal
    scale = 72 * WIDTH / 3 / 8.2  # at most, [pt/m]
    assert np.sign([goal_x - x, y - goal_y]).tolist() == np.sign(np.subtract(goal[:2], 1.0)).tolist()
    assert 0.7 * scale < (goal_x - x) / (goal[0] - 1.0) <= scale


def test_the_heat_map_shares_out_all_the_time(seeds):
    evaluation = read_subject(seeds / "seed-0", "").evaluation
    shares, (left, right, bottom, top) = time_shares(evaluation)
    assert shares.sum() == pytest.approx(1.0)
    x, y = evaluation.episodes[0].path[1]
    column = int((x - left) / (right - left) * shares.shape[0])
    row = int((y - bottom) / (top - bottom) * shares.shape[1])
    assert shares[column, row] > 0.0


@pytest.mark.parametrize("corner", [(5.5, -2.5), (5.5, 2.5), (-0.5, -2.5)])
def test_the_heat_map_is_coloured_where_the_time_went(corner, make):
    picture = draw_time(make.evaluation([make.episode([corner] * 3, [0, 0])], ReachGoal()))
    x, y = centre_of_colour(picture)
    x0, y0, x1, y1 = find_world("wall").bounds
    ((left, bottom), (right, _), (_, top)) = corners_of(picture, "patch_2")[:3]
    place = x0 + (x - left) / (right - left) * (x1 - x0), y0 + (y - bottom) / (top - bottom) * (y1 - y0)
    assert place == pytest.approx(corner, abs=0.1)


def test_a_heat_map_can_be_drawn_of_robots_that_were_never_within_the_bounds(make):
    assert "<svg" in draw_time(make.evaluation([make.episode([(50.0, 50.0)] * 3, [0, 0])]))


def corners_of(picture: str, patch: str) -> np.ndarray:
    return points_of(ElementTree.fromstring(picture).find(f".//{{*}}g[@id='{patch}']/{{*}}path").attrib["d"])


def centre_of_colour(picture: str) -> tuple[float, float]:
    """Where the pixels of a picture's first image are that are not transparent."""
    image = ElementTree.fromstring(picture).find(".//{*}image").attrib
    data = next(value for key, value in image.items() if key.endswith("href")).partition(",")[2]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    rows, columns = np.nonzero(pixels[:, :, 3])
    x, y, width, height = (float(image[key]) for key in ("x", "y", "width", "height"))
    (shift,) = re.fullmatch(r"scale\(1 -1\) translate\(0 (\S+)\)", image["transform"]).groups()
    right, down = (columns.mean() + 0.5) / pixels.shape[1], (rows.mean() + 0.5) / pixels.shape[0]
    return x + right * width, -(y + down * height + float(shift))
