"""The report: one page that stands alone, with the numbers of the runs in it."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
import torch as th
import yaml
from PIL import Image

from tb2rl import report, train
from tb2rl.actions import OVER, UNMET, action_map, action_names
from tb2rl.charts import draw_curves, draw_time, draw_ways, time_shares
from tb2rl.config import config_from
from tb2rl.curves import Curve, Family, read_curves
from tb2rl.envs import TurtleBot2Env, make_env
from tb2rl.evaluation import EPISODES, SEED, STEPS, Episode, Evaluation, bootstrap_interval, keep
from tb2rl.maze import load_maze
from tb2rl.registry import find_task
from tb2rl.runs import EVALUATION, WAYS, Run, Spaces, load, make_algorithm
from tb2rl.tasks.wander import Wander

SECTIONS = ["runs", "curves", "evaluation", "paths", "time", "actions", "map"]
QUICK = {"simulation": "kinematic", "n_envs": 8, "eval_episodes": 2, "eval_steps": 20, "save_freq": 0}
LINKS = {"src", "href", "xlink:href", "data", "action", "poster", "srcset"}
LARGEST = 3_000_000  # bytes of a page of five runs


class Page(HTMLParser):
    """What a test asks a page: its text, its elements, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source, self.words = text, []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes) -> None:
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        """All that stands between tags, with plain single spaces."""
        return spaced("".join(self.words))

    @property
    def ids(self) -> list[str]:
        return [attributes["id"] for _, attributes in self.elements if attributes.get("id")]

    @property
    def links(self) -> list[str]:
        """All that it refers to: within itself ("#..."), along with it ("data:..."), or elsewhere."""
        links = [value or "" for _, attributes in self.elements for key, value in attributes.items() if key in LINKS]
        return links + [
            link for found in re.findall(r"url\(([^)]*)\)|@import\s*([^;]*)", self.source) for link in found
        ]


def spaced(text: str) -> str:
    """With plain single spaces."""
    return " ".join(text.split())


def page_of(*arguments: object) -> Page:
    report.main([*map(str, arguments)])
    out = arguments[arguments.index("--out") + 1] if "--out" in arguments else Path(arguments[0]) / "report.html"
    return Page(Path(out).read_text(encoding="utf-8"))


def evaluated(folder: Path, episodes: int, steps: int, ended: str = "time limit") -> Evaluation:
    """Episodes that walk at random through the maze, kept in the run folder."""
    config, rng = Run.open(folder).config, np.random.default_rng(0)
    x0, y0, x1, y1 = load_maze(config.task_settings.maze).bounds
    walks = rng.uniform((x0, y0), (x1, y1), (episodes, 1, 2)) + rng.normal(0, 0.1, (episodes, steps + 1, 2)).cumsum(1)
    paths = np.clip(walks, (x0, y0), (x1, y1)).astype(np.float32)
    actions = rng.integers(3, size=(episodes, steps)).astype(np.uint8)
    each = [episode(path, taken, ended) for path, taken in zip(paths, actions, strict=True)]
    evaluation = Evaluation(each, config.task_settings, steps, SEED)
    keep(evaluation, evaluation.summary(), config, str(folder), folder)
    return evaluation


def episode(path: object, actions: object, ended: str = "time limit") -> Episode:
    path, actions = np.asarray(path, dtype=np.float32), np.asarray(actions, dtype=np.uint8)
    return Episode((0.0, 0.0, 0.0), ended, ended == "goal", False, len(actions), 123.4, 5.0, path, actions)


def renamed(run: Path, folder: Path, part: str = "train", **settings: object) -> Path:
    """A copy of a run folder that says to have been trained with other settings of a part of its config."""
    folder.mkdir(parents=True)
    for file in run.rglob("*"):
        if file.is_file():
            (folder / file.relative_to(run)).parent.mkdir(parents=True, exist_ok=True)
            (folder / file.relative_to(run)).write_bytes(file.read_bytes())
    tree = yaml.safe_load((folder / "config.yaml").read_text())
    tree[part].update(settings)
    (folder / "config.yaml").write_text(yaml.safe_dump(tree))
    return folder


@pytest.fixture(scope="module")
def seeds(tmp_path_factory) -> Path:
    """A folder of runs of two seeds, as `train --seeds` leaves it."""
    folder = tmp_path_factory.mktemp("runs") / "seeds"
    for seed in (0, 1):
        run = folder / f"seed-{seed}"
        train("qlearn", total_timesteps=24_000, eval_freq=12_000, seed=seed, folder=run, **QUICK)
        evaluated(run, episodes=3, steps=50, ended="crash")
    return folder


@pytest.fixture(scope="module")
def goal_run(tmp_path_factory) -> Path:
    """A run of a network at a task with a goal, without evaluations of any kind."""
    folder = tmp_path_factory.mktemp("runs") / "goal"
    train("dqn", task="wall", total_timesteps=8, eval_freq=0, folder=folder, **QUICK)
    return folder


@pytest.fixture
def brief(monkeypatch) -> None:
    """Evaluations that are made for the page: one episode, in this process."""
    monkeypatch.setattr(report, "_HERE", 1)


# ---- the page


def test_one_run_has_every_section_and_its_page_in_its_folder(seeds, capsys):
    run = seeds / "seed-0"
    page = page_of(run)
    assert [name for name in [*SECTIONS, "coverage"] if name not in page.ids] == []
    for part in ("qlearn at maze in loop", "24 000 control steps", "seed 0", "kinematic"):
        assert part in page.text
    printed = capsys.readouterr().out
    assert printed.startswith(f"{run / 'report.html'}: 1 run")
    assert printed.count("\n") == 1
    (run / "report.html").unlink()


def test_it_loads_nothing_and_its_ids_are_its_own(seeds, tmp_path):
    page = page_of(seeds, "--out", tmp_path / "it.html")
    links = [link for link in page.links if link and not link.startswith("data:")]
    assert links
    assert {link.removeprefix("#") for link in links} <= set(page.ids), "it refers to its own parts only"
    assert len(page.ids) == len(set(page.ids))
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", page.source)


def test_the_evaluation_table_has_the_figures_of_the_evaluation(seeds, tmp_path):
    page = page_of(seeds / "seed-0", "--out", tmp_path / "it.html")
    for part in ("0.0 % 0.0 % to 56.1 %", "123.4 ± 0.0", "crash 3", "3 episodes, 3 crashes"):
        assert part in page.text
    assert "goal reached" not in page.text


@pytest.mark.parametrize(
    ("title", "tag"),
    [
        ("Return while training", "rollout/ep_rew_mean"),
        ("Length while training", "rollout/ep_len_mean"),
        ("Crashes while training", "rollout/crash_rate"),
        ("Evaluations on the way: crash-free", "crash_free_rate"),
    ],
)
def test_curves_are_drawn_with_the_numbers_of_the_runs(title, tag, seeds):
    subjects = [report.read_subject(seeds / name, name) for name in ("seed-0", "seed-1")]
    (group,) = report.grouped(subjects)
    (chart,) = [chart for chart in report.charts([group]) if chart.title == title]
    mean = chart.families[0].mean
    drawn = {name: np.array(points) for name, points in curves_in(chart.picture).items()}
    assert drawn.keys() == {"mean-0", "seed-0-0", "seed-0-1"}
    lines = [mean.values, *(subject.curves[tag].values for subject in subjects)]
    heights = np.concatenate([drawn[name][:, 1] for name in ("mean-0", "seed-0-0", "seed-0-1")])
    assert on_a_line(np.concatenate(lines), heights), "as high as their values"
    assert on_a_line(mean.steps, drawn["mean-0"][:, 0]), "as far right as their steps"


def curves_in(picture: str) -> dict[str, list[tuple[float, float]]]:
    found = re.findall(r'<g id="((?:mean|seed)[-\d]+)">\s*<path d="([^"]*)"', picture)
    return {name: [(float(x), float(y)) for x, y in re.findall(r"[ML] (\S+) (\S+)", path)] for name, path in found}


def on_a_line(values: np.ndarray, places: np.ndarray) -> bool:
    """Whether places in a picture are a linear function of the values, as far as its digits go."""
    assert len(values) == len(places)
    fitted = np.polyval(np.polyfit(values, places, 1), values) if np.ptp(values) else places.mean()
    return bool(np.abs(places - fitted).max() < 0.01)


def test_curves_come_from_the_files_of_the_run(seeds):
    curves = read_curves(seeds / "seed-0")
    notes = [json.loads(line) for line in (seeds / "seed-0" / "evaluations.jsonl").read_text().splitlines()]
    assert curves["crash_free_rate"].steps.tolist() == [note["timesteps"] for note in notes] == [12_000, 24_000]
    assert curves["crash_free_rate"].values.tolist() == [note["crash_free_rate"] for note in notes]
    assert curves["rollout/ep_rew_mean"].steps[-1] == 24_000
    assert (np.diff(curves["rollout/ep_len_mean"].steps) > 0).all()


def test_seeds_have_a_mean_and_an_interval_where_all_of_them_have_values():
    first = Curve(np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0, 2.0]))
    second = Curve(np.array([10.0, 30.0]), np.array([3.0, 5.0]))
    family = Family("", "", [first, second])
    assert family.mean.steps.tolist() == [10.0, 20.0]
    assert family.mean.values.tolist() == [2.0, 3.0]
    assert family.interval.tolist() == [list(bootstrap_interval([1.0, 3.0])), list(bootstrap_interval([2.0, 4.0]))]
    apart = Family("", "", [first, Curve(second.steps + 100.0, second.values)])
    assert (len(apart.mean.steps), apart.interval.shape) == (0, (0, 2))


def test_a_folder_of_seeds_is_one_group_and_other_settings_make_another(seeds, tmp_path, capsys):
    other = renamed(seeds / "seed-0", tmp_path / "other", total_timesteps=30_000)
    page = page_of(seeds, other, seeds / "seed-1", "--out", tmp_path / "it.html")
    assert ": 3 runs" in capsys.readouterr().out, "one that is named twice counts once"
    assert "mean of 2 seeds" in page.text
    assert page.text.count("Thin lines") == 1
    differing = page.source.partition("What differs")[2].partition("</table>")[0]
    assert re.findall(r"<tr><th>(.*?)</th>", differing)[1:] == ["train.total_timesteps"]
    assert re.findall(r"<td>(.*?)</td>", differing) == ["24000", "30000"]


def test_versions_make_another_group_too(seeds, tmp_path):
    other = renamed(seeds / "seed-0", tmp_path / "other", "versions", torch="0.1")
    page = page_of(seeds / "seed-0", other, "--out", tmp_path / "it.html")
    differing = page.source.partition("What differs")[2].partition("</table>")[0]
    assert re.findall(r"<tr><th>(.*?)</th>", differing)[1:] == ["version.torch"]
    assert re.findall(r"<td>(.*?)</td>", differing)[1] == "0.1"
    shared = page.source.partition('id="versions"')[2].partition("</section>")[0]
    assert "numpy" in shared
    assert "torch" not in shared


def subjects_of(seeds: Path, names: Sequence[str]) -> list[report.Subject]:
    """Runs of seeds 0, 1, ... in each folder; those of different folders differ in their settings."""
    subject, folders = report.read_subject(seeds / "seed-0", ""), [str(Path(name).parent) for name in names]
    trainings = [
        replace(subject.config.train, seed=folders[:i].count(folder), eval_steps=100 + folders.index(folder))
        for i, folder in enumerate(folders)
    ]
    return [
        replace(subject, name=name, config=replace(subject.config, train=training))
        for name, training in zip(names, trainings, strict=True)
    ]


def test_groups_have_names_of_their_own(seeds):
    apart = report.grouped(subjects_of(seeds, ["ppo/a", "ppo/b", "dqn/a"]))
    assert [group.name for group in apart] == ["ppo", "dqn/a"]
    subjects = subjects_of(seeds, ["ppo/a", "ppo/b", "dqn/c", "dqn/d"])
    mixed = report.grouped([replace(subject, name=f"ppo/{subject.name[-1]}") for subject in subjects])
    assert [group.name for group in mixed] == ["ppo/a and 1 more", "ppo/c and 1 more"]


@pytest.mark.parametrize("count", [2, 8, 9, 20])
def test_groups_have_colours_of_their_own(count, seeds):
    groups = report.grouped(subjects_of(seeds, [f"{i}/run" for i in range(count)]))
    assert len({group.colour for group in groups}) == len(groups) == count


@dataclass(frozen=True)
class NineWays(Wander):
    """Wander with six turns more."""

    @property
    def commands(self) -> np.ndarray:
        return np.vstack([super().commands, *[(0.05, rate) for rate in (0.3, 0.4, 0.5, -0.3, -0.4, -0.5)]])


def test_nine_actions_have_colours_and_shares_of_their_own(seeds):
    subject = report.read_subject(seeds / "seed-0", "")
    episodes = [episode(np.zeros((6, 2)), [0, 0, 7, 7, 7]), episode(np.zeros((4, 2)), [0, 1, 7])]
    nine = replace(subject, evaluation=Evaluation(episodes, NineWays(), 5, SEED))
    assert nine.action_shares.tolist() == [3 / 8, 1 / 8, 0, 0, 0, 0, 0, 4 / 8, 0]
    page = Page(report.page(report.grouped([nine])))
    rules = dict(re.findall(r"\.a(\d) { fill: (#\w+);", page.source))
    assert list(rules) == list("012345678")
    assert len(set(rules.values())) == 9
    bar = re.findall(r'class="a(\d)" style="width: ([.\d]+)%"', page.source)
    assert (len(bar), bar[0], bar[7]) == (9, ("0", "37.500"), ("7", "50.000"))
    assert "right at 0.05 m/s, -0.4 rad/s 50.0 %" in page.text


def test_an_unfinished_training_counts_with_the_steps_that_it_has(seeds, tmp_path):
    page = page_of(renamed(seeds / "seed-0", tmp_path / "run", total_timesteps=30_000))
    assert "24 000 control steps" in page.text
    assert "24 000 of at most 30 000" in page.text


def test_a_mean_over_seeds_says_where_the_first_of_them_ends(seeds):
    whole, half = (report.read_subject(seeds / name, name) for name in ("seed-0", "seed-1"))
    half.policy.num_timesteps = 12_000
    curves = {tag: Curve(c.steps[c.steps <= 12_000], c.values[c.steps <= 12_000]) for tag, c in half.curves.items()}
    page = Page(report.page(report.grouped([whole, replace(half, curves=curves)])))
    assert "12 000 to 24 000 control steps" in page.text
    assert "12 000 of at most 24 000" in page.text
    said = re.findall(r"\(after ([\d ]+) steps, where the first of them ends\)", page.text)
    assert sorted(said) == sorted(f"{curve.steps[-1]:,.0f}".replace(",", " ") for curve in curves.values())
    as_long = report.page(report.grouped([whole, replace(whole, config=half.config)]))
    assert "where the first of them ends" not in as_long


def test_a_run_without_evaluations_is_evaluated_and_the_page_says_so(goal_run, brief, tmp_path):
    page = page_of(goal_run, "--out", tmp_path / "it.html")
    assert "1 episode was driven for this page" in page.text
    assert "goal reached" in page.text
    assert [name for name in SECTIONS if name not in page.ids] == []
    assert "coverage" not in page.ids
    assert not (goal_run / "evaluation.json").exists()


@pytest.mark.parametrize(("place", "stays"), [("final/policy", True), ("best/policy", False)])
def test_an_evaluation_goes_with_the_policy_that_it_is_of(place, stays, seeds, brief, tmp_path):
    run = Run.open(renamed(seeds / "seed-0", tmp_path / "run"))
    assert "was driven for this page" not in page_of(run.folder).text
    run.save(load(run.folder), place)
    assert [(run.folder / file).exists() for file in (EVALUATION, WAYS)] == [stays, stays]
    assert ("was driven for this page" not in page_of(run.folder).text) == stays


def test_a_zoo_entry_has_a_page_too(brief, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report.main(["zoo:maze-loop-ppo"])
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "zoo:maze-loop-ppo" in page.text
    assert [name for name in SECTIONS if name not in page.ids] == []


def test_five_runs_with_full_evaluations_are_a_page_of_three_megabytes_at_most(seeds, tmp_path):
    for seed in range(5):
        evaluated(renamed(seeds / "seed-0", tmp_path / "runs" / f"seed-{seed}", seed=seed), EPISODES, STEPS)
    page = page_of(tmp_path / "runs")
    assert len(page.source.encode()) < LARGEST
    assert "mean of 5 seeds" in page.text


def test_names_are_text_wherever_they_come_from(seeds, tmp_path):
    named = renamed(seeds / "seed-0", tmp_path / '<img src=x onerror=alert(1)>"$x_{', total_timesteps=30_000)
    tree = yaml.safe_load((named / "config.yaml").read_text())
    tree["versions"] = {"<b>bold": "</p><script>alert(2)</script>"}
    (named / "config.yaml").write_text(yaml.safe_dump(tree))
    page = page_of(named, seeds, "--out", tmp_path / "it.html")
    assert '<img src=x onerror=alert(1)>"$x_{' in page.text
    tags = [tag for tag, _ in page.elements]
    assert (tags.count("img"), tags.count("b"), tags.count("script")) == (0, 0, 1)


# ---- what it shows


def test_the_heat_map_shares_out_all_the_time(seeds):
    evaluation = report.read_subject(seeds / "seed-0", "").evaluation
    shares, (left, right, bottom, top) = time_shares(load_maze("loop"), evaluation)
    assert shares.sum() == pytest.approx(1.0)
    x, y = evaluation.episodes[0].path[1]
    column = int((x - left) / (right - left) * shares.shape[0])
    row = int((y - bottom) / (top - bottom) * shares.shape[1])
    assert shares[column, row] > 0.0


def marks(picture: str, kind: str) -> np.ndarray:
    """Where marks stand in a picture, shape (marks, 2)."""
    uses = ElementTree.fromstring(picture).findall(f".//{{*}}g[@id='{kind}']//{{*}}use")
    return np.array([(float(use.attrib["x"]), float(use.attrib["y"])) for use in uses]).reshape(-1, 2)


def test_starts_crashes_and_the_goal_are_marked_where_they_are():
    paths = [[(0, 0), (1, 2), (3, 1)], [(1, -2), (2, 2.5), (4, 2)], [(5, 1), (0, 1), (1, -1)]]
    ways = [episode(path, [0, 0], ended) for path, ended in zip(paths, ["crash", "goal", "crash"], strict=True)]
    maze = load_maze("wall")
    picture = draw_ways(maze, Evaluation(ways, find_task("wall")(), 2, SEED))
    drawn = [marks(picture, kind) for kind in ("starts", "crashes", "goal")]
    assert [len(places) for places in drawn] == [3, 2, 1]
    meant = np.array([path[0] for path in paths] + [paths[0][-1], paths[2][-1], maze.goal[:2]])
    (x, y), places = meant.T, np.concatenate(drawn)
    assert on_a_line(x, places[:, 0])
    assert on_a_line(y, places[:, 1])
    assert (places[y.argmax(), 1], places[x.argmax(), 0]) == (places[:, 1].min(), places[:, 0].max()), "y is up"


def test_without_crashes_or_a_goal_only_starts_are_marked():
    picture = draw_ways(load_maze("loop"), Evaluation([episode([(0, 4), (1, 4)], [0])], find_task("maze")(), 1, SEED))
    assert [len(marks(picture, kind)) for kind in ("starts", "crashes", "goal")] == [1, 0, 0]


def test_what_is_shaded_is_the_interval_of_the_mean():
    steps = np.array([0.0, 10.0, 20.0])
    family = Family("", "red", [Curve(steps, np.array([0.0, 1.0, 2.0])), Curve(steps, np.array([4.0, 1.5, 5.0]))])
    picture = draw_curves([family], "", rate=False)
    ((_, down),) = marks(picture, "interval-0")
    outline = ElementTree.fromstring(picture).find(".//{*}g[@id='interval-0']//{*}path").attrib["d"]
    heights = down + np.array([float(y) for y in re.findall(r"[ML] \S+ (\S+)", outline)])
    mean = np.array(curves_in(picture)["mean-0"])[:, 1]
    values = np.concatenate([family.mean.values, np.unique(family.interval)[::-1]])
    assert on_a_line(values, np.concatenate([mean, np.unique(heights)]))
    assert "interval-" not in draw_curves([Family("", "red", family.curves[:1])], "", rate=False)


@pytest.mark.parametrize("corner", [(5.5, -2.5), (5.5, 2.5), (-0.5, -2.5)])
def test_the_heat_map_is_coloured_where_the_time_went(corner):
    maze = load_maze("wall")
    picture = draw_time(maze, Evaluation([episode([corner] * 3, [0, 0])], find_task("wall")(), 2, SEED))
    x, y = centre_of_colour(picture)
    x0, y0, x1, y1 = maze.bounds
    ((left, bottom), (right, _), (_, top)) = corners_of(picture, "patch_2")[:3]
    place = x0 + (x - left) / (right - left) * (x1 - x0), y0 + (y - bottom) / (top - bottom) * (y1 - y0)
    assert place == pytest.approx(corner, abs=0.1)


def corners_of(picture: str, patch: str) -> list[tuple[float, float]]:
    path = ElementTree.fromstring(picture).find(f".//{{*}}g[@id='{patch}']/{{*}}path").attrib["d"]
    return [(float(x), float(y)) for x, y in re.findall(r"[ML] (\S+) (\S+)", path)]


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


def test_the_coverage_table_counts_what_was_updated(seeds):
    subject = report.read_subject(seeds / "seed-0", "")
    visits = subject.policy.policy.visits
    eighth = len(visits) // 8
    visits[:] = 0
    visits[:eighth] = th.tensor([1, 50, 0])
    visits[eighth : 2 * eighth, 2] = 7
    table = report.page(report.grouped([subject])).partition('id="coverage"')[2].partition("</table>")[0]
    known = spaced(f"{100 * subject.map.known:.1f} %")
    assert [spaced(cell) for cell in re.findall(r"<td>(.*?)</td>", table)] == ["16 384", "25.0 %", "12.5 %", "7", known]


@pytest.mark.parametrize(
    ("commands", "names"),
    [
        ([(0.5, 0.0), (0.05, 1.0), (0.05, -1.0), (-0.05, 0.0)], ["forward", "left", "right", "backward"]),
        ([(0.0, 0.0), (-0.1, 1.0), (0.0, -1.0)], ["stand", "back left", "right"]),
        ([(0.5, 0.0), (0.2, 0.0)], ["forward at 0.5 m/s, 0 rad/s", "forward at 0.2 m/s, 0 rad/s"]),
    ],
)
def test_actions_are_named_by_where_they_lead(commands, names):
    assert action_names(np.array(commands)) == names


def test_the_map_shows_what_the_policy_does_where_training_met_the_state(seeds):
    policy = load(seeds / "seed-0")
    actions = action_map(policy, policy.trained_with)
    free = load_maze("loop").free_space(0.0)
    assert 700 < len(actions.places) < 1100
    assert all(free.contains(shapely.Point(place)) for place in actions.places)
    assert set(np.unique(actions.actions)) == {OVER, UNMET, 0, 1, 2}
    assert 0.0 < actions.known < 1.0
    policy.policy.visits[:] = 1
    policy.policy.q[:] = 0.0
    policy.policy.q[:, 2] = 1.0
    learned = action_map(policy, policy.trained_with)
    assert (learned.actions == np.where(actions.actions == OVER, OVER, 2)).all()
    assert learned.known == 1.0


def test_known_is_a_share_of_the_states_that_the_robot_can_go_on_from():
    task = {"name": "maze", "kept": [3], "crash_range": 0.8}  # one beam, four classes: 0.7, 1.0 and 1.7 m between them
    config = config_from({"agent": {"name": "qlearn"}, "task": task})
    policy = make_algorithm(config, Spaces.vectorised(config))
    assert action_map(policy, config).known == 0.0
    policy.policy.visits[:2, 1] = 1
    shown = action_map(policy, config)
    assert shown.known == pytest.approx(1 / 3), "of classes 1, 2 and 3 it met 1; in class 0 an episode is over"
    assert (shown.actions >= 0).sum() < 0.1 * (shown.actions != OVER).sum(), "which few poses lead to"


def test_the_map_shows_the_action_that_the_policy_takes_there(seeds):
    policy, rng = load(seeds / "seed-0"), np.random.default_rng(0)
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(rng.random(policy.policy.q.shape))
    shown = action_map(policy, policy.trained_with)
    env = TurtleBot2Env("maze", "discrete")
    for heading, place in rng.permutation(np.argwhere(shown.actions != OVER))[:30]:
        pose = (*shown.places[place], heading * math.tau / len(shown.actions))
        observation, _ = env.reset(options={"pose": pose})
        assert policy.predict(observation, deterministic=True)[0] == shown.actions[heading, place]
    env.close()


def test_the_map_shows_a_network_at_a_task_with_a_goal(goal_run):
    policy = load(goal_run)
    shown = set(np.unique(action_map(policy, policy.trained_with).actions))
    assert OVER in shown
    assert {OVER} < shown <= {OVER, 0, 1, 2}


@pytest.mark.parametrize("task", ["maze", "wall"])
def test_the_map_is_empty_just_where_an_episode_ends_at_once(task, seeds, goal_run):
    policy = load({"maze": seeds / "seed-0", "wall": goal_run}[task])
    shown, env = action_map(policy, policy.trained_with), make_env(policy)
    goal = getattr(env.task, "goal", (math.inf, math.inf))
    over = []
    for heading, place in np.ndindex(shown.actions.shape):
        _, info = env.reset(options={"pose": (*shown.places[place], heading * math.tau / len(shown.actions))})
        at_goal = np.abs(shown.places[place] - goal).max() <= getattr(env.task, "goal_tolerance", 0.0)
        over.append(info["min_range"] < env.task.crash_range or at_goal)
    assert 0 < sum(over) < len(over)
    assert ((shown.actions == OVER).ravel() == over).all()
    env.close()


# ---- what is refused


def assert_refused(arguments: list[object], named: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        report.main([*map(str, arguments)])
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1, message
    assert [part for part in named if part not in message] == [], message


@pytest.mark.parametrize(
    ("reference", "named"),
    [
        ("missing", ["no run folder missing"]),
        (".", ["neither a run folder nor a folder of them"]),
        ("file", ["no run folder file"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
    ],
)
def test_what_is_no_run_is_refused(reference, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert_refused([reference], named, capsys)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("out", ["missing/it.html", "."])
def test_a_page_that_cannot_be_written_is_refused_before_any_work(out, seeds, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report, "read_subject", None)
    assert_refused([seeds, "--out", out], ["cannot write", out], capsys)


@pytest.mark.parametrize("argument", ["RUN", "--out"])
def test_a_name_that_is_too_long_is_refused(argument, seeds, capsys):
    arguments = ["r" * 300] if argument == "RUN" else [seeds, "--out", "r" * 300]
    assert_refused(arguments, ["too long", "rrr"], capsys)


def test_one_training_in_two_folders_is_refused(seeds, tmp_path, capsys):
    twins = [renamed(seeds / "seed-0", tmp_path / name) for name in ("first", "second")]
    assert_refused([*twins, "--out", tmp_path / "it.html"], ["first and second are the same training"], capsys)


@pytest.mark.parametrize("settings", [{"maze": "circuit"}, {"beams": 5}])
def test_a_config_that_is_not_its_policys_is_refused(settings, seeds, tmp_path, capsys):
    run = renamed(seeds / "seed-0", tmp_path / "run", "task", **settings)
    assert_refused([run], ["config.yaml is not what its policy was trained with"], capsys)


def put(*keys: str | int, value: object) -> Callable[[dict], None]:
    """A change to a tree: this value at these keys."""

    def change(tree: dict) -> None:
        part = tree
        for key in keys[:-1]:
            part = part[key]
        part[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (put("config", "task", "maze", value="circuit"), "not of the task in config.yaml"),
        (put("config", "task", "crash_range", value=0.4), "not of the task in config.yaml"),
        (put("each", 0, "distance", value=None), "each.0.distance"),
        (put("each", 1, "ended", value=None), "each.1.ended"),
        (put("each", 0, "start", value=[0.0, 0.0]), "each.0.start"),
        (put("each", value=[]), "not an evaluation"),
        (put("steps", value="1500x"), "steps"),
    ],
)
def test_an_evaluation_that_does_not_fit_is_refused(change, named, seeds, tmp_path, capsys):
    run = renamed(seeds / "seed-0", tmp_path / "run")
    tree = json.loads((run / EVALUATION).read_text())
    change(tree)
    (run / EVALUATION).write_text(json.dumps(tree))
    assert_refused([run], ["evaluation.json", named], capsys)


def test_ways_without_their_end_are_refused(seeds, tmp_path, capsys):
    run = renamed(seeds / "seed-0", tmp_path / "run")
    (run / WAYS).write_bytes((run / WAYS).read_bytes()[:-100])
    assert_refused([run], [WAYS, "damaged"], capsys)


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(seeds, tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert_refused([seeds, "--out", tmp_path / "it.html"], ["cannot write", "it.html"], capsys)


@pytest.mark.parametrize("damage", ["flipped", "junk", "length"])
def test_a_damaged_event_file_is_refused(damage, seeds, tmp_path, capsys):
    run = renamed(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    data = bytearray(file.read_bytes())
    place = {"flipped": len(data) // 2, "length": 0, "junk": 0}[damage]
    data[place] ^= 0xFF
    file.write_bytes(b"no events at all, and more of that" if damage == "junk" else data)
    assert_refused([run], [file.name, "damaged after"], capsys)


def test_an_event_file_without_its_end_is_read_as_far_as_it_goes(seeds, tmp_path):
    run = renamed(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    whole = read_curves(run)["rollout/ep_rew_mean"]
    data = file.read_bytes()
    file.write_bytes(data[: data.rindex(b"rollout/ep_rew_mean")])
    cut = read_curves(run)["rollout/ep_rew_mean"]
    assert 0 < len(cut.steps) < len(whole.steps)
    assert cut.values.tolist() == whole.values[: len(cut.values)].tolist()
    file.write_bytes(b"")
    assert read_curves(run).keys() == {"crash_free_rate", "success_rate"}


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("evaluations.jsonl", "{"),
        ("evaluations.jsonl", '{"timesteps": 1}\n'),
        ("evaluations.jsonl", "[]\n"),
        ("evaluations.jsonl", '{"timesteps": 1e999, "crash_free_rate": 1, "success_rate": 1}\n'),
        ("evaluations.jsonl", '{"timesteps": 1, "crash_free_rate": NaN, "success_rate": 1}\n'),
        ("evaluations.jsonl", f'{{"timesteps": 1{400 * "0"}, "crash_free_rate": 1, "success_rate": 1}}\n'),
        ("evaluation.json", "{}"),
        ("config.yaml", "agent: {name: qlern}\ntask: {name: maze}"),
        ("best/policy.safetensors", "no arrays"),
    ],
)
def test_other_damaged_files_are_refused_by_name(file, content, seeds, tmp_path, capsys):
    run = renamed(seeds / "seed-0", tmp_path / "run")
    (run / file).write_text(content)
    assert_refused([run], [file], capsys)
    assert not (run / "report.html").exists()
