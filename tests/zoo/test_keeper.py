"""The commands of the zoo build entries from recipes, and find cards that do not hold."""

from __future__ import annotations

import json
import sys
from functools import partial
from importlib import import_module
from io import StringIO

import pytest

from tb2rl.commands import seeds
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.execution.local import LocalExecutor
from tb2rl.zoo import building, entry, maintenance
from tb2rl.zoo.entry import entries

keeper = import_module("tb2rl.zoo.__main__")

SMALL = "--agent qlearn --simulation kinematic --total-timesteps 2560 --set train.eval_episodes=2 train.eval_steps=20"


@pytest.fixture
def own_zoo(tmp_path, monkeypatch):
    """A zoo of one recipe, whose policy learns next to nothing; trainings go beside it."""
    zoo = tmp_path / "zoo"
    zoo.mkdir()
    (zoo / "recipes.yaml").write_text(f"mine: {SMALL}\n")
    monkeypatch.setattr(entry, "top_folder", lambda name: zoo)
    monkeypatch.chdir(tmp_path)
    return zoo


@pytest.mark.slow
def test_a_recipe_becomes_an_entry_that_holds_until_its_figures_are_touched(own_zoo, capsys):
    keeper.main(["build"])
    card = (own_zoo / "mine" / "README.md").read_text()
    assert SMALL in card
    assert "Falls short" in card
    assert "[mine](mine/README.md)" in (own_zoo / "README.md").read_text()
    before = (own_zoo / "mine" / "best" / "policy.safetensors").stat().st_mtime_ns
    keeper.main(["build"])
    assert (own_zoo / "mine" / "best" / "policy.safetensors").stat().st_mtime_ns == before, "what is there stays"

    keeper.main(["check"])
    assert "1 cards hold" in capsys.readouterr().out
    figures = own_zoo / "mine" / "evaluation.json"
    tree = json.loads(figures.read_text())
    for each in tree["each"]:
        each.update(ended="time limit", failed=False, distance=2 * each["distance"])
    figures.write_text(json.dumps(tree))
    (own_zoo / "README.md").write_text("all is well")
    with pytest.raises(SystemExit, match="1"):
        keeper.main(["check", "--episodes", "10"])
    said = capsys.readouterr().out
    assert "mine: 0 % good episodes, below the card's interval from 72.2 %" in said
    assert "m/s, " in said
    assert "when the card was written" in said
    assert "the table in README.md is not what the files say" in said

    (own_zoo / "recipes.yaml").write_text(f"mine: {SMALL} agent.gamma=0.5\n")
    with pytest.raises(SystemExit, match="1"):
        keeper.main(["check", "--episodes", "1"])
    said = capsys.readouterr().out
    assert "mine: it was not trained as its recipe says" in said
    assert "mine: its card is not what its files say" in said
    keeper.main(["build"])
    keeper.main(["check", "--episodes", "1"])
    assert "agent.gamma=0.5" in (own_zoo / "mine" / "README.md").read_text()
    assert sorted(file.name for file in own_zoo.iterdir()) == ["README.md", "mine", "recipes.yaml"]

    figures.write_text("<<<<<<< HEAD")
    with pytest.raises(SystemExit, match="2"):
        keeper.main(["check", "--episodes", "1"])
    assert "evaluation.json is not JSON" in capsys.readouterr().err


def test_a_build_that_is_interrupted_keeps_what_was_trained(own_zoo, monkeypatch):
    (own_zoo / "recipes.yaml").write_text(f"mine: {SMALL}\nnext: {SMALL} train.seed=1\n")
    monkeypatch.setattr(seeds, "evaluate", partial(evaluate, episodes=2, steps=20, workers=1))

    def interrupted(_, function, jobs, shared):
        yield jobs[0], function(*shared, *jobs[0].arguments, jobs[0].folder)
        raise KeyboardInterrupt

    monkeypatch.setattr(LocalExecutor, "as_completed", interrupted)
    with pytest.raises(SystemExit, match="130"):
        keeper.main(["build"])
    assert (own_zoo / "mine" / "best" / "policy.safetensors").is_file()
    assert sorted(file.name for file in own_zoo.iterdir()) == ["mine", "recipes.yaml"]


def test_a_build_trains_nothing_that_is_there_as_its_recipe_says(monkeypatch, capsys):
    monkeypatch.setattr(building, "Job", lambda *arguments: pytest.fail("trained or driven"))
    written = []
    monkeypatch.setattr(maintenance, "write_text", lambda path, text: written.append((path, text)))
    keeper.main(["build", "maze-loop-dqn"])
    assert capsys.readouterr().out == ""
    assert len(written) == len(entries()) + 1, "all cards and the table"
    assert all(path.read_text(encoding="utf-8") == text for path, text in written), "and they stay what they were"


def test_a_check_prints_the_figures_of_a_policy_and_draws_bars_on_a_terminal(monkeypatch, capsys):
    stream = StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    keeper.main(["check", "wall-wall-ppo", "--episodes", "1"])
    assert "checking:" in stream.getvalue()
    assert "evaluating:" in stream.getvalue()
    out = capsys.readouterr().out
    assert "wall-wall-ppo: 100 % good episodes, " in out
    assert out.endswith("1 cards hold\n")


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("build nothing", ["unknown zoo policy 'nothing'", "maze-loop-dqn"]),
        ("check --episodes 0", ["--episodes", "1 to 100"]),
        ("feed", ["feed", "build", "check"]),
    ],
)
def test_arguments_that_do_not_fit_are_refused_in_one_line(line, named, capsys):
    with pytest.raises(SystemExit, match="2"):
        keeper.main(line.split())
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert [part for part in named if part not in said] == []
