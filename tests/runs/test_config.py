"""A config and the tree of plain values that stands for it in a file."""

from __future__ import annotations

import pytest
import yaml

from tb2rl.core.agent import find_agent
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.envs import worlds
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.layers import resolve
from tb2rl.runs.plain import check_plain, check_sections, plain
from tb2rl.simulation.variation import find_variation
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles

MY_WORLD = "drawing: |\n  #####\n  #S..#\n  #...#\n  #####\n"


@pytest.mark.parametrize("agent", agent_names())
@pytest.mark.parametrize("task", task_names())
def test_every_agent_at_every_task_comes_back_from_its_yaml(agent, task):
    config = resolve(agent, task)
    assert (config.agent_name, config.task_name) == (agent, task)
    assert config.observation == find_agent(agent).observation
    assert config_from(config.to_dict()) == config
    assert config_from(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


@pytest.mark.parametrize("variation", ["mild", {"preset": "strong", "latency": [0, 2], "bias": 0.1}], ids=str)
def test_a_config_with_variation_comes_back_from_its_yaml(variation):
    config = resolve("qlearn", settings={"task.variation": variation})
    again = config_from(yaml.safe_load(yaml.safe_dump(config.to_dict())))
    assert again == config
    assert again.task.resolved_variation == find_variation(variation)


@pytest.mark.parametrize(
    "dynamic_obstacles", [{"people": 4}, [{"boxes": 1, "path": [[0, 0], [1, 0]], "speed": 0.5}]], ids=str
)
def test_a_config_with_movers_comes_back_from_its_yaml(dynamic_obstacles):
    config = resolve("qlearn", settings={"task.dynamic_obstacles": dynamic_obstacles})
    again = config_from(yaml.safe_load(yaml.safe_dump(config.to_dict())))
    assert again == config
    assert again.scene.spec.dynamic_obstacles == find_dynamic_obstacles(dynamic_obstacles, "dynamic_obstacles")


def test_a_changed_config_comes_back_from_its_yaml():
    changes = {
        "task.beam_indices": [0, 3, 6],
        "task.range_bins": [0.5, 2],
        "agent.policy_kwargs": {"initial_value": 1.5},
    }
    config = resolve("qlearn", settings={**changes, "train.episodes": 7, "agent.exploration_decay": 0.99})
    assert config_from(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


@pytest.mark.parametrize("tree", [{}, [], {"agent": {}, "task": {}}, {"agent": {"name": "qlearn"}}], ids=str)
def test_a_tree_without_its_names_is_refused(tree, refused):
    refused(config_from, tree)


@pytest.mark.parametrize("key", ["world", "robot", "variation"])
def test_what_does_not_fit_the_task_is_said_when_the_config_is_made(key, refused):
    tree = resolve().to_dict()
    assert "unknown" in refused(config_from, {**tree, "task": {**tree["task"], key: "lop"}})
    assert "unknown" in refused(resolve().with_task, {key: "lop"})


def test_the_names_in_a_config_become_objects_once(monkeypatch):
    found = []
    find_world = worlds.find_world
    monkeypatch.setattr(worlds, "find_world", lambda name: found.append(name) or find_world(name))
    config = resolve("dqn", "wall")
    assert config.scene is config.scene
    assert config.scene.task is config.task
    assert (config.scene.observation, config.scene.world.name) == ("raw", "wall")
    assert found == ["wall"]
    by_hand = Config("dqn", {}, "wall", config.task, "raw")
    assert by_hand.scene.observation_space == config.scene.observation_space


def test_a_changed_task_leaves_the_rest_and_is_checked(refused):
    config = resolve("qlearn", settings={"train.seed": 3})
    changed = config.with_task({"world": "circuit", "laser_noise": 0.01})
    assert (changed.task.world, changed.task.laser_noise, changed.scene.world.name) == ("circuit", 0.01, "circuit")
    assert changed.train == config.train
    assert config.task.world == "loop"
    assert config.with_task({}) is config
    assert "did you mean 'laser_noise'" in refused(config.with_task, {"nose": 1})
    assert "task.laser_noise" in refused(config.with_task, {"laser_noise": -1})


def test_the_file_of_a_world_is_found_from_another_folder(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(MY_WORLD)
    monkeypatch.chdir(tmp_path)
    config = resolve(settings={"task.world": "mine.yaml"})
    assert config.task.world == str(tmp_path / "mine.yaml")
    monkeypatch.chdir("/")
    assert config_from(config.to_dict()) == config


# ---- plain values


@pytest.mark.parametrize(
    "value", [None, True, 3, -1e12, 0.5, "text", "ü 1", [1, [2]], {"a": {"b": [None]}}, (1, 2)], ids=str
)
def test_plain_values_are_taken(value):
    check_plain(value, "")


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ({"a": float("nan")}, ["a:", "finite", "nan"]),
        ({"a": [0, float("inf")]}, ["a.1", "finite", "inf"]),
        ({"a": {"b": 10**13}}, ["a.b", "within 1e+12"]),
        ({"a": 10**400}, ["a:", "1329 bits"]),
        ({"a": "x\ny"}, ["a:", "printable"]),
        ({"a": "\ud800"}, ["a:", "printable"]),
        ({"a": {1: 2}}, ["a:", "key must be text"]),
        ({3: 2}, ["config:", "key must be text"]),
        ({"a": b"x"}, ["a:", "plain numbers"]),
        ({"a": {1, 2}}, ["a:", "plain numbers"]),
        ({"a": 1j}, ["a:", "plain numbers"]),
    ],
    ids=str,
)
def test_other_values_are_refused_with_their_place(value, named, refused):
    message = refused(check_plain, value, "")
    assert [part for part in named if part not in message] == [], message


def test_a_tree_of_plain_values_is_what_yaml_knows():
    assert plain({"a": (1, (2, "x")), "b": [{"c": None}]}) == {"a": [1, [2, "x"]], "b": [{"c": None}]}


@pytest.mark.parametrize("tree", [[], 3, None, {"agnt": {}}, {"agent": 3}, {"agent": None}], ids=str)
def test_sections_are_mappings_with_known_names(tree, refused):
    assert "the file" in refused(check_sections, tree, "the file")
