"""`report --compare`: the verdicts, the page, and one line for runs that cannot be compared."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.report import main as report
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.viz import comparison


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """A function that makes a folder of runs with given shares of good episodes."""

    def stored(run):
        metrics = json.loads((run.folder / "metrics.json").read_text(encoding="utf-8"))
        return SimpleNamespace(good_rate=metrics["good"], summary=lambda: {"mean_speed": metrics["speed"]})

    def make(name, rates, **settings):
        config = resolve("qlearn", "maze", settings=settings)
        for seed, rate in enumerate(rates):
            seeded = replace(config, train=replace(config.train, seed=seed))
            run = Run.create(tmp_path / name / f"seed-{seed}", seeded)
            (run.folder / "metrics.json").write_text(json.dumps({"good": rate, "speed": 0.25 + seed / 1000}))
        return str(tmp_path / name)

    monkeypatch.setattr(comparison, "load_evaluation", stored)
    monkeypatch.chdir(tmp_path)
    return make


def test_the_page_says_which_runs_are_better_and_draws_both(runs, tmp_path, capsys):
    good, bad = runs("<good>", np.linspace(0.9, 1.0, 10)), runs("bad", np.linspace(0.2, 0.4, 10))
    report(["--compare", good, bad])
    out = capsys.readouterr().out
    assert f"{good} is better than {bad}" in out
    assert "Good episodes: 95.0 % (" in out
    assert "Speed, relative to the fastest action: 50.9 % (" in out
    assert f"do not tell {good} and {bad} apart" in out, "their speeds are equal"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "&lt;good&gt;" in page
    assert "<good>" not in page
    assert page.count("profile-0") == 2
    assert "maze in loop: 10 and 10 runs" in page
    assert "100.0\u202f% <small>100.0\u202f% to 100.0\u202f%</small>" in page, "the probability of improvement"


def test_too_few_seeds_give_no_verdict(runs, capsys):
    report(["--compare", runs("a", [0.9, 1.0]), runs("b", [0.1] * 10)])
    assert "Too few seeds to tell: 2 seeds where at least 5 are needed" in capsys.readouterr().out


def test_runs_that_cannot_be_compared_are_refused(runs, tmp_path, capsys):
    one, other = runs("one", [0.5] * 5), runs("other", [0.5] * 5, **{"task.world": "circuit"})
    for words, message in (
        ([one, other], "the same tasks and worlds, not maze in loop with maze in circuit"),
        ([one, other, other], "--compare takes two folders of runs"),
        ([one, other, "--world", "loop"], "--world"),
        ([one, f"{one}/."], "--compare takes two different sets of runs, but "),
    ):
        with pytest.raises(SystemExit, match="2"):
            report(["--compare", *words])
        assert message in capsys.readouterr().err
    Run.create(tmp_path / "one" / "again", resolve("qlearn", "maze"))
    (tmp_path / "one" / "again" / "metrics.json").write_text('{"good": 1, "speed": 1}')
    with pytest.raises(InputError, match="has two runs of seed 0"):
        comparison.read_compared_runs(one)
