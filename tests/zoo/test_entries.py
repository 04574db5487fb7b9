"""Every policy of the zoo loads, drives and is what its card says."""

from __future__ import annotations

from collections import Counter
from functools import partial
from importlib import import_module

import numpy as np
import pytest

import tb2rl
from tb2rl.evaluation.evaluator import EPISODES, SEED, STEPS, evaluate
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.runs.config import config_from
from tb2rl.worlds.generators import GENERATORS
from tb2rl.worlds.registry import world_names
from tb2rl.zoo import checking
from tb2rl.zoo.cards import card, overview, table
from tb2rl.zoo.entry import MAZES, WORLDS, entries, zoo_folder

keeper = import_module("tb2rl.zoo.__main__")

ENTRIES = entries()
PLACES = ("maze-loop", "maze-circuit", "maze-round", "maze-maze", "my-maze-loop", "wall-wall")  # of every agent

TURTLEBOT3 = "maze-loop-turtlebot3-ppo"


def test_every_agent_has_a_policy_for_every_place():
    expected = {f"{place}-{agent}" for place in PLACES for agent in ("qlearn", "dqn", "ppo")}
    expected |= {f"drive-loop-{agent}" for agent in ("sac", "td3", "ppo")}
    expected |= {f"anywhere-{agent}" for agent in ("qlearn", "dqn", "ppo", "sac")}
    expected |= {f"navigate-{kind}-ppo" for kind in ("plan", "goal")}
    assert {entry.name for entry in ENTRIES} == expected | {TURTLEBOT3}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_policy_drives_in_its_world(entry):
    policy = tb2rl.load(f"zoo:{entry.name}")
    env = tb2rl.make_env(policy)
    assert entry.world in (env.scene.world.name, "mixed")
    observation, _ = env.reset(seed=2)
    info = {"ended": ""}
    for _ in range(600 if entry.navigates else 200):
        action, _ = policy.predict(observation, deterministic=True)
        observation, _, _, _, info = env.step(action)
        if info["ended"]:
            break
    env.close()
    assert info["ended"] == ("goal" if entry.good == "success" else "")
    at_most = 200 * env.scene.task.control_period * env.scene.actions.max_speed  # [m]
    assert info["distance"] > (0.5 * at_most if entry.good == "failure_free" else 1.0)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_card_is_what_its_files_say_and_tells_what_falls_short(entry):
    text = (entry.folder / "README.md").read_text(encoding="utf-8")
    assert text == card(entry)
    short = entry.figures[f"{entry.good}_rate"] < entry.promised or entry.speed_share < entry.promised_speed
    assert ("Falls short" in text) == short
    assert entry.figures["episodes"] == len(entry.figures["each"]) == 100
    assert entry.config.to_dict() == entry.requested.to_dict(), "trained as its recipe says"
    assert entry.is_as_requested
    assert all((entry.folder / name).is_file() for name in ("paths.png", "config.yaml", "best/policy.safetensors"))


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_its_figures_are_those_of_its_episodes(entry):
    figures, each = entry.figures, entry.figures["each"]
    assert (figures["episodes"], figures["steps"], figures["seed"]) == (EPISODES, STEPS, SEED)
    failed, success = ([episode[name] for episode in each] for name in ("failed", "success"))
    assert figures["failure_free_rate"] == pytest.approx(1 - np.mean(failed))
    assert figures["failure_free_interval"] == pytest.approx(wilson_interval(100 - sum(failed), 100))
    assert figures["success_rate"] == pytest.approx(np.mean(success))
    assert figures["success_interval"] == pytest.approx(wilson_interval(sum(success), 100))
    assert figures["endings"] == Counter(episode["ended"] for episode in each)
    assert figures["mean_distance"] == pytest.approx(np.mean([episode["distance"] for episode in each]))
    assert [episode["failed"] for episode in each] == [e["ended"] in ("collision", "out of bounds") for e in each]
    assert config_from(figures["config"]).task == entry.config.task, "settings that came later have their default"


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_it_was_driven_in_every_world_that_it_never_saw_and_can_drive_in(entry):
    expected = {"maze", "mixed"} if entry.good == "success" else set(WORLDS)  # only these have a goal
    assert set(entry.elsewhere) == (set() if entry.navigates else expected - {entry.world})
    assert entry.is_built
    for figures in entry.elsewhere.values():
        assert sum(figures["endings"].values()) == figures["episodes"] == EPISODES
        failing = figures["endings"].get("collision", 0) + figures["endings"].get("out of bounds", 0)
        assert figures["failure_free_rate"] == pytest.approx(1 - failing / EPISODES)


def test_the_closed_mazes_are_worlds_and_mixed_ones_generated():
    assert set(MAZES) < set(world_names())
    assert "mixed" in GENERATORS


def test_the_table_is_what_the_entries_say():
    assert (zoo_folder() / "README.md").read_text(encoding="utf-8") == table(ENTRIES)


def test_the_overview_has_a_row_for_every_place_and_a_cell_for_every_policy():
    lines = overview(ENTRIES).splitlines()
    assert len(lines) == 2 + len(PLACES) + 6
    assert any(line.startswith("| `maze, loop with turtlebot3` | ") for line in lines)
    assert "`qlearn`" in lines[0]
    assert lines[2].startswith("| `maze, loop` | ")
    assert sum(line.count(" m/s") for line in lines) == len(ENTRIES)


def test_the_zoo_is_small():
    assert sum(file.stat().st_size for file in zoo_folder().rglob("*") if file.is_file()) < 10e6


@pytest.mark.slow
def test_the_cards_hold(capsys, monkeypatch):
    # Four episodes are one group: processes would start for each policy, and one of them drive.
    monkeypatch.setattr(checking, "evaluate", partial(evaluate, workers=1))
    keeper.main(["check", "--episodes", "4"])
    assert f"{len(ENTRIES)} cards hold" in capsys.readouterr().out
