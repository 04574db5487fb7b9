"""The report: one page that stands alone, with the numbers of the runs in it."""

from __future__ import annotations

import json
import math
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import shapely
import torch as th
import yaml

from tb2rl import report, train
from tb2rl.actions import action_map, action_names
from tb2rl.charts import time_shares
from tb2rl.curves import Curve, Family, read_curves
from tb2rl.envs import TurtleBot2Env
from tb2rl.evaluation import EPISODES, SEED, STEPS, Episode, Evaluation, bootstrap_interval, keep
from tb2rl.maze import load_maze
from tb2rl.runs import Run, load

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
        return " ".join("".join(self.words).split())

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
    each = [
        Episode((0.0, 0.0, 0.0), ended, ended == "goal", False, steps, 123.4, 5.0, path, taken)
        for path, taken in zip(paths, actions, strict=True)
    ]
    evaluation = Evaluation(each, config.task_settings, steps, SEED)
    keep(evaluation, evaluation.summary(), config, str(folder), folder)
    return evaluation


def renamed(run: Path, folder: Path, **settings: object) -> Path:
    """A copy of a run folder that says to have been trained with other settings of its training."""
    folder.mkdir(parents=True)
    for file in run.rglob("*"):
        if file.is_file():
            (folder / file.relative_to(run)).parent.mkdir(parents=True, exist_ok=True)
            (folder / file.relative_to(run)).write_bytes(file.read_bytes())
    tree = yaml.safe_load((folder / "config.yaml").read_text())
    tree["train"].update(settings)
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


def test_a_run_without_evaluations_is_evaluated_and_the_page_says_so(goal_run, brief, tmp_path):
    page = page_of(goal_run, "--out", tmp_path / "it.html")
    assert "1 episode was driven for this page" in page.text
    assert "goal reached" in page.text
    assert [name for name in SECTIONS if name not in page.ids] == []
    assert "coverage" not in page.ids
    assert not (goal_run / "evaluation.json").exists()


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
    assert set(np.unique(actions.actions)) <= {-1, 0, 1, 2}
    assert 0.0 < actions.known < 1.0
    policy.policy.visits[:] = 1
    policy.policy.q[:] = 0.0
    policy.policy.q[:, 2] = 1.0
    assert (action_map(policy, policy.trained_with).actions == 2).all()


def test_the_map_shows_the_action_that_the_policy_takes_there(seeds):
    policy, rng = load(seeds / "seed-0"), np.random.default_rng(0)
    policy.policy.visits[:] = 1
    policy.policy.q[:] = th.from_numpy(rng.random(policy.policy.q.shape))
    shown = action_map(policy, policy.trained_with)
    env = TurtleBot2Env("maze", "discrete")
    for _ in range(30):
        heading, place = rng.integers(len(shown.actions)), rng.integers(len(shown.places))
        pose = (*shown.places[place], heading * math.tau / len(shown.actions))
        observation, _ = env.reset(options={"pose": pose})
        assert policy.predict(observation, deterministic=True)[0] == shown.actions[heading, place]
    env.close()


def test_the_map_shows_a_network_at_a_task_with_a_goal(goal_run):
    policy = load(goal_run)
    assert set(np.unique(action_map(policy, policy.trained_with).actions)) <= {0, 1, 2}


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
