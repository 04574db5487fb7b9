"""Every policy of the zoo loads, drives and is what its card says; the keeper builds entries and finds false cards."""

from __future__ import annotations

import json
from importlib import import_module

import pytest

import tb2rl
from tb2rl.settings import room

keeper = import_module("tb2rl.zoo.__main__")
ENTRIES = keeper.entries()
PLACES = ("maze-loop", "maze-circuit", "maze-round", "maze-maze", "my-maze-loop", "wall-wall")
SMALL = "--agent qlearn --simulation kinematic --total-timesteps 2560 --set train.eval_episodes=2 train.eval_steps=20"


def test_every_agent_has_a_policy_for_every_place():
    expected = {f"{place}-{agent}" for place in PLACES for agent in ("qlearn", "dqn", "ppo")}
    assert {entry.name for entry in ENTRIES} == expected


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_policy_drives_its_maze(entry):
    policy = tb2rl.load(f"zoo:{entry.name}")
    env = tb2rl.make_env(policy)
    observation, _ = env.reset(seed=2)
    info = {"ended": None}
    for _ in range(200):
        action, _ = policy.predict(observation, deterministic=True)
        observation, _, _, _, info = env.step(action)
        if info["ended"]:
            break
    assert info["ended"] == ("goal" if entry.good == "success" else None)
    assert info["distance"] > (10.0 if entry.good == "crash_free" else 1.0)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_card_is_what_its_files_say_and_tells_what_falls_short(entry):
    text = (entry.folder / "README.md").read_text(encoding="utf-8")
    assert text == keeper.card(entry)
    short = entry.figures[f"{entry.good}_rate"] < entry.promised or entry.speed_share < entry.promised_speed
    assert ("Falls short" in text) == short
    assert entry.figures["episodes"] == len(entry.figures["each"]) == 100
    assert entry.config.to_dict() == entry.requested.to_dict(), "trained as its recipe says"
    assert all((entry.folder / name).is_file() for name in ("paths.png", "config.yaml", "best/policy.safetensors"))


def test_the_table_is_what_the_entries_say():
    assert (room("zoo") / "README.md").read_text(encoding="utf-8") == keeper.table(ENTRIES)


def test_the_zoo_is_small():
    assert sum(file.stat().st_size for file in room("zoo").rglob("*") if file.is_file()) < 10e6


@pytest.mark.slow
def test_the_cards_hold(capsys):
    keeper.main(["check", "--episodes", "4"])
    assert f"{len(ENTRIES)} cards hold" in capsys.readouterr().out


@pytest.fixture
def own_zoo(tmp_path, monkeypatch):
    """A zoo of one recipe, whose policy learns next to nothing; trainings go beside it."""
    zoo = tmp_path / "zoo"
    zoo.mkdir()
    (zoo / "recipes.yaml").write_text(f"mine: {SMALL}\n")
    monkeypatch.setattr(keeper, "room", lambda name: zoo)
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
        each.update(ended="time limit", distance=2 * each["distance"])
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


def test_a_build_that_is_interrupted_keeps_what_was_trained(own_zoo, monkeypatch, capsys):
    training = keeper.train

    def interrupted(arguments: list[str]) -> None:
        training([*arguments, "--no-evaluation"])  # as after Ctrl-C

    monkeypatch.setattr(keeper, "train", interrupted)
    with pytest.raises(SystemExit, match="2"):
        keeper.main(["build"])
    (folder,) = own_zoo.parent.glob("runs/maze/qlearn/mine-*")
    assert f"{folder.name} has no standard evaluation" in capsys.readouterr().err
    assert (folder / "best" / "policy.safetensors").is_file()
    assert [file.name for file in own_zoo.iterdir()] == ["recipes.yaml"]


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("build nothing", ["unknown zoo policy 'nothing'", "maze-loop-dqn"]),
        ("check --episodes 0", ["--episodes", "1 to 100"]),
        ("feed", ["feed", "build", "check"]),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(line, named, capsys):
    with pytest.raises(SystemExit, match="2"):
        keeper.main(line.split())
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert [part for part in named if part not in said] == []
