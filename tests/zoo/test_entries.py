"""Every policy of the zoo loads, drives and agrees with its card."""

from functools import partial

import numpy as np
import pytest

import tb2rl
from tb2rl.core.agent import find_agent
from tb2rl.evaluation.evaluate import EPISODES, SEED, STEPS, evaluate
from tb2rl.runs.config import config_from
from tb2rl.runs.loading import config_of
from tb2rl.zoo import maintenance
from tb2rl.zoo.cards import card, overview, table
from tb2rl.zoo.entry import WORLDS, entries, policies_of_suites_yaml, suites_folder, zoo_folder

ENTRIES = entries()
PLACES = ("maze-loop", "maze-circuit", "maze-round", "maze-maze", "my-maze-loop", "wall-wall")  # of every agent


def test_every_agent_has_a_policy_for_every_place():
    expected = {f"{place}-{agent}" for place in PLACES for agent in ("qlearn", "dqn", "ppo")}
    expected |= {f"drive-loop-{agent}" for agent in ("sac", "td3", "ppo")}
    expected |= {f"anywhere-{agent}" for agent in ("qlearn", "dqn", "ppo", "sac")}
    expected |= {f"navigate-{kind}-ppo" for kind in ("plan", "online", "goal")}
    assert {entry.name for entry in ENTRIES} == expected | {"maze-loop-turtlebot3-ppo"}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_policy_drives_in_its_world(entry):
    policy = tb2rl.load(f"zoo:{entry.name}")
    env = tb2rl.make_env(policy, simulation="kinematic")
    assert entry.config.task.world in (env.scene.world.name, "mixed") or not isinstance(entry.config.task.world, str)
    observation, _ = env.reset(seed=2)
    info = {"ended": ""}
    for _ in range(600 if entry.navigates else 200):
        action, _ = policy.predict(observation, deterministic=True)
        observation, _, _, _, info = env.step(action)
        if info["ended"]:
            break
    env.close()
    assert info["ended"] == ("goal" if entry.criterion == "success" else "")
    at_most = 200 * env.scene.task.control_period * env.scene.actions.max_speed  # [m]
    assert info["distance"] > (0.5 * at_most if entry.criterion == "failure_free" else 1.0)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_card_and_its_figures_agree_with_the_episodes(entry):
    text = (entry.folder / "README.md").read_text(encoding="utf-8")
    assert text == card(entry)
    short = entry.good_rate < entry.promised_rate or entry.relative_speed < entry.promised_speed
    assert ("Falls short" in text) == short
    assert all((entry.folder / name).is_file() for name in ("paths.png", "config.yaml", "best/policy.safetensors"))
    assert entry.matches_recipe, "trained as its recipe says"
    figures, each = entry.summary, entry.summary["each"]
    assert (figures["episodes"], figures["steps"], figures["seed"]) == (EPISODES, STEPS, SEED)
    assert len(each) == EPISODES
    assert figures["success_rate"] == pytest.approx(np.mean([episode["success"] for episode in each]))
    assert figures["failure_free_rate"] == pytest.approx(1 - np.mean([episode["failed"] for episode in each]))
    assert figures["mean_distance"] == pytest.approx(np.mean([episode["distance"] for episode in each]))
    assert [episode["failed"] for episode in each] == [e["ended"] in ("collision", "out of bounds") for e in each]
    assert config_from(figures["config"]).task == entry.config.task, "settings that came later have their default"
    expected = {"maze", "mixed"} if entry.criterion == "success" else set(WORLDS)  # only these have a goal
    assert set(entry.unseen_world_summaries) == (set() if entry.navigates else expected - {entry.config.task.world})
    assert entry.is_built
    for figures in entry.unseen_world_summaries.values():
        assert sum(figures["endings"].values()) == figures["episodes"] == EPISODES


@pytest.mark.parametrize("policy", policies_of_suites_yaml(), ids=lambda policy: policy.name)
def test_policies_of_suites_yaml_have_the_name_of_their_agent_or_entry_and_variation(policy):
    reference, agent, task = policy.evaluate_options.policy, policy.evaluate_options.agent, policy.config.task
    who = reference.removeprefix("zoo:") if reference else f"{agent}-{'online' if task.maps_online else task.guide}"
    usual = "none" if agent else config_of(tb2rl.load(reference)).task.variation
    how = "exact" if task.variation == "none" else task.variation
    assert policy.name == (who if task.variation == usual else f"{who}-{how}")
    assert (policy.digest is None) == (reference is None)
    assert reference or find_agent(agent).algorithm is None


def test_the_table_agrees_with_the_entries_and_has_every_result_of_a_suite():
    text = (zoo_folder() / "README.md").read_text(encoding="utf-8")
    assert text == table(ENTRIES)
    _, _, suites = text.partition("## Suites\n")
    rows = [line for line in suites.splitlines() if line.startswith("| ") and "| guide |" not in line]
    assert len(rows) == len(list(suites_folder().glob("*"))), "a result is stale"


def test_the_overview_has_a_row_for_every_place_and_a_cell_for_every_policy():
    lines = overview(ENTRIES).splitlines()
    assert len(lines) == 2 + len(PLACES) + 7
    assert any(line.startswith("| `maze, loop with turtlebot3` | ") for line in lines)
    assert sum(line.count(" m/s") for line in lines) == len(ENTRIES)


def test_the_zoo_is_small():
    assert sum(file.stat().st_size for file in zoo_folder().rglob("*") if file.is_file()) < 10e6


@pytest.mark.slow
def test_the_cards_hold(main, capsys, monkeypatch):
    # Processes for two episodes would cost more than they save.
    monkeypatch.setattr(maintenance, "evaluate", partial(evaluate, workers=1))
    main(["check", "--episodes", "2"])
    assert f"{len(ENTRIES)} cards pass" in capsys.readouterr().out
