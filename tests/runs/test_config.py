"""A config and its tree of plain values."""

from itertools import cycle

import pytest
import yaml

from tb2rl.core.agent import find_agent
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.runs.config import config_from, resolve

MY_WORLD = "drawing: |\n  #####\n  #S..#\n  #...#\n  #####\n"
PAIRS = [*zip(agent_names(), cycle(task_names()), strict=False)]  # every agent, with the tasks in turn
CHANGES = [
    {"task.variation": {"preset": "strong", "latency": [0, 2], "bias": 0.1}},
    {"task.dynamic_obstacles": [{"boxes": 1, "path": [[0, 0], [1, 0]], "speed": 0.5}]},
    {"task.beam_indices": [0, 3, 6], "task.range_bins": [0.5, 2], "train.episodes": 7, "agent.exploration_decay": 0.99},
    {"agent.policy_kwargs": {"initial_value": 1.5}},
]


@pytest.mark.parametrize(("agent", "task"), PAIRS)
def test_every_agent_and_every_task_come_back_from_yaml(agent, task):
    config = resolve(agent, task)
    assert (config.agent_name, config.task_name) == (agent, task)
    assert config.observation == find_agent(agent).observation
    assert config_from(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


@pytest.mark.parametrize("changes", CHANGES, ids=lambda changes: next(iter(changes)))
def test_a_changed_config_comes_back_from_yaml(changes):
    config = resolve("qlearn", settings=changes)
    again = config_from(yaml.safe_load(yaml.safe_dump(config.to_dict())))
    assert again == config
    assert again.scene.spec.dynamic_obstacles == config.scene.spec.dynamic_obstacles


@pytest.mark.parametrize("tree", [[], {"agent": {}, "task": {}}, {"agent": {"name": "qlearn"}}], ids=str)
def test_a_tree_without_its_names_is_refused(tree, refused):
    refused(config_from, tree)


@pytest.mark.parametrize("key", ["world", "robot", "variation"])
def test_unknown_names_in_a_task_are_refused(key, refused):
    tree = resolve().to_dict()
    assert "unknown" in refused(config_from, {**tree, "task": {**tree["task"], key: "lop"}})
    assert "unknown" in refused(resolve().with_task, {key: "lop"})


def test_with_task_changes_and_checks_the_task_only(refused):
    config = resolve("qlearn", settings={"train.seed": 3})
    changed = config.with_task({"world": "circuit", "laser_noise": 0.01})
    assert (changed.task.world, changed.task.laser_noise, changed.scene.world.name) == ("circuit", 0.01, "circuit")
    assert changed.train == config.train
    assert config.task.world == "loop"
    assert config.with_task({}) is config
    assert "did you mean 'laser_noise'" in refused(config.with_task, {"lasernoise": 1})
    assert "task.laser_noise" in refused(config.with_task, {"laser_noise": -1})


def test_a_world_file_is_found_from_another_folder(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(MY_WORLD)
    monkeypatch.chdir(tmp_path)
    config = resolve(settings={"task.world": "mine.yaml"})
    assert config.task.world == str(tmp_path / "mine.yaml")
    monkeypatch.chdir("/")
    assert config_from(config.to_dict()) == config


@pytest.mark.parametrize(
    ("agent", "key", "value"),
    [
        ("qlearn", "agent.gamma", 10**400),
        ("qlearn", "agent.exploration", "epsilon\0"),
        ("qlearn", "task.range_bins", [1e308, float("inf")]),
        ("ppo", "agent.learning_rate.end", float("nan")),
        ("ppo", "train.eval_steps", "é🤖"),
    ],
)
def test_a_value_that_nobody_means_is_refused_with_its_key(agent, key, value, refused):
    assert key in refused(resolve, agent, settings={key: value})
