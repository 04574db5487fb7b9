"""The report: one self-contained page with the numbers of its runs."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch as th
import yaml

from tb2rl.evaluation.sim_to_sim import SimToSim
from tb2rl.viz import page as page_module
from tb2rl.viz.action_map import action_map
from tb2rl.viz.charts import Curve
from tb2rl.viz.page import page
from tb2rl.viz.run_views import group_runs, read_run_view

SECTIONS = ["runs", "curves", "evaluation", "replays", "paths", "actions", "map"]


@pytest.fixture
def without_pictures(monkeypatch) -> None:
    """Pages without charts, maps and replays, which take most of the time."""
    for name in ("draw_curves", "draw_episodes"):
        monkeypatch.setattr(page_module.charts, name, lambda *_: "<svg></svg>")
    monkeypatch.setattr(page_module, "action_map", lambda *_: None)
    no_replays = {"replays": [], "simulator": "", "error": ""}
    monkeypatch.setattr(page_module, "run_replays", lambda view: {"view": view, **no_replays})


@pytest.fixture(scope="module")
def page_of_seeds(seeds, pages, tmp_path_factory):
    return pages.of(seeds, out=tmp_path_factory.mktemp("page") / "it.html")


# ---- content


def test_a_page_has_every_section_and_the_metrics_of_its_runs(page_of_seeds):
    assert [name for name in [*SECTIONS, "coverage"] if name not in page_of_seeds.ids] == []
    for part in (
        "qlearn at maze in loop: 2 runs", "24 000 control steps", "seeds 0, 1", "simulator kinematic", "8 environments",
        "failure-free", "0.0 % 0.0 to 56.1 %", "123.4 ± 0.0", "collision 3", "3 episodes, 3 failed",
        "mean of 2 seeds",
    ):  # fmt: skip
        assert part in page_of_seeds.text
    assert page_of_seeds.text.count("Thin lines") == 1
    assert "goal reached" not in page_of_seeds.text
    assert "Differences" not in page_of_seeds.text


def test_a_page_loads_nothing_and_its_ids_are_unique(page_of_seeds):
    links = [link for link in page_of_seeds.links if link and not link.startswith("data:")]
    assert links
    assert {link.removeprefix("#") for link in links} <= set(page_of_seeds.ids), "links within the page only"
    assert len(page_of_seeds.ids) == len(set(page_of_seeds.ids))
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", page_of_seeds.source)


def test_a_run_without_an_evaluation_is_evaluated_and_the_page_says_so(
    goal_run, short_evaluations, pages, tmp_path, without_pictures
):
    page = pages.of(goal_run, out=tmp_path / "it.html")
    assert "1 episode was evaluated for this page" in page.text
    assert "goal reached" in page.text
    assert [name for name in SECTIONS if name not in page.ids] == []
    assert "coverage" not in page.ids
    assert not (goal_run / "evaluation.json").exists()


def test_the_coverage_table_counts_updates(seeds, pages):
    view = read_run_view(seeds / "seed-0", "")
    visits = view.policy.policy.visits
    eighth = len(visits) // 8
    visits[:] = 0
    visits[:eighth] = th.tensor([1, 50, 0])
    visits[eighth : 2 * eighth, 2] = 7
    table = page(group_runs([view])).partition('id="coverage"')[2].partition("</table>")[0]
    on_map = f"{100 * action_map(view.policy, view.config.scene).visited_share:.1f} %"
    cells = [" ".join(cell.split()) for cell in re.findall(r"<td>(.*?)</td>", table)]
    assert cells == ["19 683", "25.0 %", "12.5 %", "7", on_map]


def test_results_in_several_physics_simulators_are_side_by_side(views, make, pages, without_pictures, referees):
    lasted, collided = (make.episode(np.zeros((2, 2)), [0], ended) for ended in ("time limit", "collision"))
    evaluation = make.evaluation([lasted, collided])
    both = [replace(evaluation, simulation="first"), replace(evaluation, simulation="second", episodes=[lasted] * 2)]
    view = replace(views[0], evaluation=both[0], sim_to_sim=SimToSim.of(both))
    shown = pages(page(group_runs([view])))
    assert "sim-to-sim-1" in shown.ids
    assert "The greedy policy in First, from random" in shown.text
    assert "metric First Second failure-free 50.0 % 9.5 to 90.5 % 100.0 % 34.2 to 100.0 %" in shown.text
    assert "Second - First: 50.0 points" in shown.text


# ---- actions


def test_velocities_have_shares_by_their_kind(views, make, cruise, pages, without_pictures):
    actions = [[(1, 0), (1, 0.1), (-1, 1), (-1, -1)], [(1, 0), (1, 0), (-1, 0), (0.5, 0.9)]]
    evaluation = make.evaluation([make.episode(np.zeros((5, 2)), each) for each in actions], cruise())
    shown = pages(page(group_runs([replace(views[0], evaluation=evaluation)])))
    assert re.findall(r'class="a(\d)" style="width: ([.\d]+)%"', shown.source)[1] == ("1", "50.000")
    assert "stand 12.5 % forward 50.0 % backward 0.0 % left 25.0 % right 12.5 %" in shown.text


# ---- several runs


def test_settings_and_versions_that_differ_are_listed(seeds, make, pages, tmp_path, capsys, without_pictures):
    longer = make.copied(seeds / "seed-0", tmp_path / "longer", total_timesteps=30_000)
    other = make.copied(seeds / "seed-0", tmp_path / "other", "versions", torch="0.1")
    page = pages.of(seeds, longer, other, seeds / "seed-1", out=tmp_path / "it.html")
    assert ": 4 runs" in capsys.readouterr().out, "a run that is named twice counts once"
    assert "24 000 of at most 30 000" in page.text, "an unfinished training counts with its steps so far"
    table = page.source.partition("Differences")[2].partition("</table>")[0]
    assert re.findall(r"<tr><th>(.*?)</th>", table)[1:] == ["train.total_timesteps", "version.torch"]
    assert re.findall(r"<td>(.*?)</td>", table)[:3] == ["24000", "30000", "24000"]
    assert re.findall(r"<td>(.*?)</td>", table)[5] == "0.1"
    shared = page.source.partition('id="versions"')[2].partition("</section>")[0]
    assert "numpy" in shared
    assert "torch" not in shared


def test_a_mean_over_seeds_ends_with_the_shortest_training(seeds, views, pages, without_pictures):
    half = read_run_view(seeds / "seed-1", "half")
    half.policy.num_timesteps = 12_000
    curves = {key: Curve(c.steps[c.steps <= 12_000], c.values[c.steps <= 12_000]) for key, c in half.curves.items()}
    shown = pages(page(group_runs([views[0], replace(half, curves=curves)])))
    assert "12 000 to 24 000 control steps" in shown.text
    ends = re.findall(r"\(after ([\d ]+) steps, where the shortest training ends\)", shown.text)
    assert sorted(ends) == sorted(f"{curve.steps[-1]:,.0f}".replace(",", " ") for curve in curves.values())
    assert "where the shortest training ends" not in page(group_runs([views[0], replace(views[0], config=half.config)]))


def test_names_are_text_whatever_they_contain(seeds, make, pages, tmp_path, without_pictures):
    named = make.copied(seeds / "seed-0", tmp_path / '<img src=x onerror=alert(1)>"$x_{', total_timesteps=30_000)
    tree = yaml.safe_load((named / "config.yaml").read_text())
    tree["versions"] = {"<b>bold": "</p><script>alert(2)</script>"}
    (named / "config.yaml").write_text(yaml.safe_dump(tree))
    page = pages.of(named, seeds, out=tmp_path / "it.html")
    assert '<img src=x onerror=alert(1)>"$x_{' in page.text
    assert [page.count(tag) for tag in ("img", "b", "script")] == [0, 0, 2]
