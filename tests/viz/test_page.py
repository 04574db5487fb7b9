"""The report: one page that stands alone, with the numbers of the runs in it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch as th
import yaml

from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.evaluator import EPISODES, SEED, STEPS
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.layers import resolve
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.viz.action_map import action_map
from tb2rl.viz.curves import Curve
from tb2rl.viz.groups import grouped
from tb2rl.viz.page import page
from tb2rl.viz.subjects import Subject, read_subject

SECTIONS = ["runs", "curves", "evaluation", "paths", "time", "actions", "map"]
LARGEST = 3_000_000  # bytes of a page of five runs


def spaced(text: str) -> str:
    """With plain single spaces."""
    return " ".join(text.split())


@pytest.fixture
def subject(seeds) -> Subject:
    """A run of qlearn, to put other evaluations into."""
    return read_subject(seeds / "seed-0", "")


# ---- what stands on it


def test_one_run_has_every_section(seeds, pages, tmp_path):
    page = pages.of(seeds / "seed-0", "--out", tmp_path / "it.html")
    assert [name for name in [*SECTIONS, "coverage"] if name not in page.ids] == []
    for part in ("qlearn at maze in loop", "24 000 control steps", "seed 0", "kinematic", "8 environments"):
        assert part in page.text


def test_it_loads_nothing_and_its_ids_are_its_own(seeds, pages, tmp_path):
    page = pages.of(seeds, "--out", tmp_path / "it.html")
    links = [link for link in page.links if link and not link.startswith("data:")]
    assert links
    assert {link.removeprefix("#") for link in links} <= set(page.ids), "it refers to its own parts only"
    assert len(page.ids) == len(set(page.ids))
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", page.source)


def test_episodes_in_several_worlds_are_shown_in_theirs(subject, make, pages):
    worlds = [0, 1, *range(20)]
    ways = [replace(make.episode([(1, 1), (2, 2 + i / 5)], [0]), world=world) for i, world in enumerate(worlds)]
    task = Wander(world={"generator": "clutter", "worlds": 20, "difficulty": 0.3})
    scene = make_scene(task, "discrete")
    subject = replace(subject, evaluation=Evaluation(ways, scene, SEED))
    shown = pages(page(grouped([subject])))
    for part in ("22 episodes, 0 failed; 12 of 20 worlds", "drove in several worlds", "in 20 worlds of clutter"):
        assert part in " ".join(shown.text.split())
    assert [name for name in set(shown.ids) if shown.ids.count(name) > 1] == []
    assert sum("starts" in name for name in shown.ids) == 12


def test_the_evaluation_table_has_the_figures_of_the_evaluation(seeds, pages, tmp_path):
    page = pages.of(seeds / "seed-0", "--out", tmp_path / "it.html")
    for part in ("failure-free", "0.0 % 0.0 % to 56.1 %", "123.4 ± 0.0", "crash 3", "3 episodes, 3 failed"):
        assert part in page.text
    assert "goal reached" not in page.text


def test_endings_that_count_as_failed_are_counted_by_the_task_and_not_by_their_names(subject, make, pages):
    path = [(0.0, 2.0), (1.0, 2.0)]
    endings = [("out of bounds", True), ("goal", False), ("time limit", False), ("out of bounds", True)]
    episodes = [make.episode(path, [0], ended, failed) for ended, failed in endings]
    subject = replace(subject, evaluation=Evaluation(episodes, make_scene(ReachGoal(), "discrete"), SEED))
    assert subject.failures == 2
    text = pages(page(grouped([subject]))).text
    for part in ("4 episodes, 2 failed", "50.0 % 15.0 % to 85.0 %", "25.0 % 4.6 % to 69.9 %", "goal reached"):
        assert part in text
    assert "goal 1 out of bounds 2 time limit 1" in text


def test_a_run_without_evaluations_is_evaluated_and_the_page_says_so(goal_run, brief, pages, tmp_path):
    page = pages.of(goal_run, "--out", tmp_path / "it.html")
    assert "1 episode was driven for this page" in page.text
    assert "goal reached" in page.text
    assert [name for name in SECTIONS if name not in page.ids] == []
    assert "coverage" not in page.ids
    assert not (goal_run / "evaluation.json").exists()


def test_the_coverage_table_counts_what_was_updated(subject):
    visits = subject.policy.policy.visits
    eighth = len(visits) // 8
    visits[:] = 0
    visits[:eighth] = th.tensor([1, 50, 0])
    visits[eighth : 2 * eighth, 2] = 7
    table = page(grouped([subject])).partition('id="coverage"')[2].partition("</table>")[0]
    known = spaced(f"{100 * action_map(subject.policy, subject.config.scene).known:.1f} %")
    assert [spaced(cell) for cell in re.findall(r"<td>(.*?)</td>", table)] == ["19 683", "25.0 %", "12.5 %", "7", known]


# ---- actions


@dataclass(frozen=True)
class NineWays(Wander):
    """Wander with six turns more."""

    @property
    def actions(self):
        return Wander().actions.plus(
            soft_left=(0.05, 0.3), bent_left=(0.05, 0.4), hard_left=(0.05, 0.5),
            soft_right=(0.05, -0.3), bent_right=(0.05, -0.4), hard_right=(0.05, -0.5),
        )  # fmt: skip


def bar_of(page) -> list[tuple[str, str]]:
    """The number of each kind of action, and its share of the bar."""
    return re.findall(r'class="a(\d)" style="width: ([.\d]+)%"', page.source)


def test_nine_actions_have_colours_and_shares_of_their_own(subject, make, pages):
    episodes = [make.episode(np.zeros((6, 2)), [0, 0, 7, 7, 7]), make.episode(np.zeros((4, 2)), [0, 1, 7])]
    nine = replace(subject, evaluation=make.evaluation(episodes, NineWays(episode_steps=5)))
    assert nine.action_shares.tolist() == [3 / 8, 1 / 8, 0, 0, 0, 0, 0, 4 / 8, 0]
    shown = pages(page(grouped([nine])))
    rules = dict(re.findall(r"\.a(\d) { fill: (#\w+);", shown.source))
    assert list(rules) == list("012345678")
    assert len(set(rules.values())) == 9
    bar = bar_of(shown)
    assert (len(bar), bar[0], bar[7]) == (9, ("0", "37.500"), ("7", "50.000"))
    assert "bent_right 50.0 %" in shown.text


def test_velocities_have_shares_by_where_they_lead(subject, make, cruise, pages):
    config = resolve("stable_baselines3:PPO", cruise)
    policy = make_algorithm(config, Spaces.vectorised(config))
    actions = [[(1, 0), (1, 0.1), (-1, 1), (-1, -1)], [(1, 0), (1, 0), (-1, 0), (0.5, 0.9)]]
    evaluation = Evaluation([make.episode(np.zeros((5, 2)), each) for each in actions], config.scene, SEED)
    cruising = replace(subject, config=config, policy=policy, evaluation=evaluation)
    assert cruising.action_names == ("stand", "forward", "backward", "left", "right")
    assert cruising.action_shares.tolist() == [1 / 8, 4 / 8, 0, 2 / 8, 1 / 8]
    shown = pages(page(grouped([cruising])))
    assert bar_of(shown)[1] == ("1", "50.000")
    assert "forward 50.0 % backward 0.0 % left 25.0 % right 12.5 %" in shown.text
    assert set(re.findall(r'class="a(-?\d)"/>', shown.source)) <= set("01234") | {"-2"}


# ---- several runs


def test_a_folder_of_seeds_is_one_group_and_other_settings_make_another(seeds, make, pages, tmp_path, capsys):
    other = make.copied(seeds / "seed-0", tmp_path / "other", total_timesteps=30_000)
    page = pages.of(seeds, other, seeds / "seed-1", "--out", tmp_path / "it.html")
    assert ": 3 runs" in capsys.readouterr().out, "one that is named twice counts once"
    assert "mean of 2 seeds" in page.text
    assert page.text.count("Thin lines") == 1
    differing = page.source.partition("What differs")[2].partition("</table>")[0]
    assert re.findall(r"<tr><th>(.*?)</th>", differing)[1:] == ["train.total_timesteps"]
    assert re.findall(r"<td>(.*?)</td>", differing) == ["24000", "30000"]


def test_versions_make_another_group_too(seeds, make, pages, tmp_path):
    other = make.copied(seeds / "seed-0", tmp_path / "other", "versions", torch="0.1")
    page = pages.of(seeds / "seed-0", other, "--out", tmp_path / "it.html")
    differing = page.source.partition("What differs")[2].partition("</table>")[0]
    assert re.findall(r"<tr><th>(.*?)</th>", differing)[1:] == ["version.torch"]
    assert re.findall(r"<td>(.*?)</td>", differing)[1] == "0.1"
    shared = page.source.partition('id="versions"')[2].partition("</section>")[0]
    assert "numpy" in shared
    assert "torch" not in shared


def test_an_unfinished_training_counts_with_the_steps_that_it_has(seeds, make, pages, tmp_path):
    page = pages.of(make.copied(seeds / "seed-0", tmp_path / "run", total_timesteps=30_000))
    assert "24 000 control steps" in page.text
    assert "24 000 of at most 30 000" in page.text


def test_a_mean_over_seeds_says_where_the_first_of_them_ends(seeds, pages):
    whole, half = (read_subject(seeds / name, name) for name in ("seed-0", "seed-1"))
    half.policy.num_timesteps = 12_000
    curves = {tag: Curve(c.steps[c.steps <= 12_000], c.values[c.steps <= 12_000]) for tag, c in half.curves.items()}
    shown = pages(page(grouped([whole, replace(half, curves=curves)])))
    assert "12 000 to 24 000 control steps" in shown.text
    assert "12 000 of at most 24 000" in shown.text
    said = re.findall(r"\(after ([\d ]+) steps, where the first of them ends\)", shown.text)
    assert sorted(said) == sorted(f"{curve.steps[-1]:,.0f}".replace(",", " ") for curve in curves.values())
    as_long = page(grouped([whole, replace(whole, config=half.config)]))
    assert "where the first of them ends" not in as_long


def test_five_runs_with_full_evaluations_are_a_page_of_three_megabytes_at_most(seeds, make, pages, tmp_path):
    for seed in range(5):
        make.evaluated(make.copied(seeds / "seed-0", tmp_path / "runs" / f"seed-{seed}", seed=seed), EPISODES, STEPS)
    page = pages.of(tmp_path / "runs")
    assert len(page.source.encode()) < LARGEST
    assert "mean of 5 seeds" in page.text


def test_names_are_text_wherever_they_come_from(seeds, make, pages, tmp_path):
    named = make.copied(seeds / "seed-0", tmp_path / '<img src=x onerror=alert(1)>"$x_{', total_timesteps=30_000)
    tree = yaml.safe_load((named / "config.yaml").read_text())
    tree["versions"] = {"<b>bold": "</p><script>alert(2)</script>"}
    (named / "config.yaml").write_text(yaml.safe_dump(tree))
    page = pages.of(named, seeds, "--out", tmp_path / "it.html")
    assert '<img src=x onerror=alert(1)>"$x_{' in page.text
    tags = [tag for tag, _ in page.elements]
    assert (tags.count("img"), tags.count("b"), tags.count("script")) == (0, 0, 1)
