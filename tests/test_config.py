"""Layers of settings, and what happens to a setting that does not fit."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
import torch as th
import yaml

from tb2rl.agents._features import Nearness
from tb2rl.config import TrainSettings, algorithm_arguments, config_from, parse_settings, resolve
from tb2rl.errors import InputError
from tb2rl.registry import agent_names, find_agent, task_names
from tb2rl.settings import room
from tb2rl.tasks.wander import Wander

NAN, INF = float("nan"), float("inf")
CONFIGS = room("configs")


def test_later_layers_win(tmp_path, monkeypatch):
    fields = ("turn_rate", "turn_speed", "noise", "forward_speed")  # each layer sets one field less than the one before
    files = [tmp_path / name for name in ("tasks/maze.yaml", "agents/qlearn.yaml", "mine.yaml")]
    for layer, file in enumerate(files):
        file.parent.mkdir(exist_ok=True)
        file.write_text(yaml.safe_dump({"task": dict.fromkeys(fields[layer:], 0.1 * (layer + 1))}))
    monkeypatch.setattr("tb2rl.config.room", lambda _: tmp_path)
    task = resolve("qlearn", "maze", "mine", {"task.forward_speed": 0.4}).task_settings
    assert [getattr(task, field) for field in fields] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert task.control_period == Wander().control_period, "what no layer sets stands in the signature"


def test_the_name_on_the_command_line_wins_over_the_presets():
    assert resolve(preset="tutorial").agent == "qlearn"
    assert resolve(settings={"agent.name": "ppo", "task.name": "wall"}).task == "wall"
    assert resolve("dqn", settings={"agent.name": "ppo"}).agent == "dqn"


def test_a_schedule_of_a_later_layer_replaces_a_number_and_the_other_way_round():
    line = {"start": 0.4, "end": 0.1, "fraction": 0.5}
    assert resolve("dqn", settings={"agent.learning_rate": line}).agent_settings["learning_rate"] == line
    assert resolve("ppo", settings={"agent.learning_rate": 0.1}).agent_settings["learning_rate"] == 0.1
    assert resolve("ppo", settings={"agent.learning_rate": line}).agent_settings["learning_rate"] == line


def test_a_schedule_does_not_inherit_parts_of_the_schedule_that_it_replaces(tmp_path):
    (tmp_path / "mine.yaml").write_text("agent: {learning_rate: {start: 0.5, end: 0.4, fraction: 0.3}}")
    line = {"start": 0.2, "end": 0.1}
    mine = resolve(preset=str(tmp_path / "mine.yaml"), settings={"agent.learning_rate": line})
    assert mine.agent_settings["learning_rate"] == line


def test_one_key_of_policy_kwargs_leaves_the_others():
    kwargs = resolve("ppo").agent_settings["policy_kwargs"]
    changed = resolve("ppo", settings={"agent.policy_kwargs.net_arch": [8]}).agent_settings["policy_kwargs"]
    assert changed == {**kwargs, "net_arch": [8]}


@pytest.mark.parametrize("agent", agent_names())
@pytest.mark.parametrize("task", task_names())
def test_every_agent_at_every_task_comes_back_from_its_yaml(agent, task):
    config = resolve(agent, task)
    assert (config.agent, config.task) == (agent, task)
    assert config.observation == find_agent(agent).observation
    assert config_from(config.to_dict()) == config
    assert config_from(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


def test_a_changed_config_comes_back_from_its_yaml():
    changes = {"task.kept": [0, 3, 6], "task.edges": [0.5, 2], "agent.policy_kwargs": {"initial_value": 1.5}}
    config = resolve("qlearn", settings={**changes, "train.episodes": 7, "agent.exploration_decay": 0.99})
    assert config_from(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


@pytest.mark.parametrize("file", sorted(CONFIGS.rglob("*.yaml")), ids=lambda file: str(file.relative_to(CONFIGS)))
def test_every_shipped_config_resolves(file):
    if file.parent.name == "mazes":
        assert resolve(settings={"task.maze": file.stem}).task_settings.maze == file.stem
    elif file.parent.name == "kinematic":
        assert file.stem in agent_names(), "a preset that nobody reads"
        fast, slow = (resolve(file.stem, settings={"train.simulation": name}) for name in ("kinematic", "bullet"))
        assert fast.train.n_envs > slow.train.n_envs
    elif file.parent.name == "tasks" and file.stem not in task_names():
        task, _, agent = file.stem.rpartition("-")
        assert (task, agent) in product(task_names(), agent_names()), "a preset that nobody reads"
        assert resolve(agent, task).agent_settings["gamma"] != resolve(agent).agent_settings.get("gamma")
    elif file.parent.name in ("agents", "tasks"):
        kind = file.parent.name.removesuffix("s")
        assert file.stem in (agent_names() if kind == "agent" else task_names()), "a preset that nobody reads"
        assert getattr(resolve(**{kind: file.stem}), kind) == file.stem
    else:
        assert resolve(preset=file.stem) == resolve(preset=str(file))


def test_settings_of_the_command_line_are_yaml():
    pairs = ["a.b=1", "a.c=2.5", "a.d=circuit", "a.e=[1, 2]", "a.f={start: 1, end: 0}", "a.g=null", "a.h=x=y", "a.i="]
    line = {"start": 1, "end": 0}
    assert list(parse_settings(pairs).values()) == [1, 2.5, "circuit", [1, 2], line, None, "x=y", None]


@pytest.mark.parametrize("value", ["1.0e-3", "1e-3", "0.001"])
def test_a_number_is_a_number_however_it_is_written(value):
    settings = parse_settings([f"agent.gamma={value}", f"task.noise={value}"])
    config = resolve("qlearn", settings=settings)
    assert (config.agent_settings["gamma"], config.task_settings.noise) == (0.001, 0.001)


def test_a_schedule_becomes_a_line_over_the_remaining_training():
    rate = algorithm_arguments({"learning_rate": {"start": 0.5, "end": 0.1, "fraction": 0.8}})["learning_rate"]
    assert [rate(remaining) for remaining in (1.0, 0.6, 0.2, 0.0)] == pytest.approx([0.5, 0.3, 0.1, 0.1])


def test_classes_in_policy_kwargs_are_imported():
    kwargs = {"activation_fn": "torch.nn:ELU", "features_extractor_class": "tb2rl.agents._features:Nearness"}
    made = algorithm_arguments({"policy_kwargs": {**kwargs, "net_arch": [8]}, "gamma": 0.9})
    classes = {"activation_fn": th.nn.ELU, "features_extractor_class": Nearness}
    assert made == {"policy_kwargs": {**classes, "net_arch": [8]}, "gamma": 0.9}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"agent": "qlern"}, ["'qlern'", "did you mean 'qlearn'", *agent_names()]),
        ({"task": "wal"}, ["'wal'", "did you mean 'wall'", *task_names()]),
        ({"preset": "tutoral"}, ["'tutoral'", "did you mean 'tutorial'"]),
        ({"preset": "no/such.yaml"}, ["no/such.yaml"]),
        ({"task": "tb2rl.tasks:Task"}, ["tb2rl.tasks:Task"]),
    ],
)
def test_an_unknown_name_is_refused(arguments, named):
    assert_refused(named, **arguments)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"gamma": 0.9}, ["agent.gamma"]),
        ({"agnt.gamma": 0.9}, ["'agnt'", "did you mean 'agent'", "task", "train"]),
        ({"agent.gama": 0.9}, ["'gama'", "did you mean 'gamma'", "learning_rate"]),
        ({"task.turnrate": 1}, ["'turnrate'", "did you mean 'turn_rate'", "forward_speed"]),
        ({"train.sead": 1}, ["'sead'", "did you mean 'seed'", "n_envs"]),
        ({"agent.learning_rate.strat": 1}, ["'strat'", "did you mean 'start'", "fraction"]),
        ({"agent.gamma": {"start": 1, "end": 0}}, ["agent.gamma"]),
        ({"agent.gamma": 1, "agent.gamma.start": 1}, ["agent.gamma"]),
        ({"agent.gamma": "high"}, ["agent.gamma", "number", "'high'"]),
        ({"agent.exploration": "greedy"}, ["agent.exploration", "epsilon_greedy", "noisy_values", "'greedy'"]),
        ({"agent.gamma": NAN}, ["agent.gamma", "finite", "nan"]),
        ({"agent.learning_rate": {"start": NAN, "end": 0}}, ["agent.learning_rate.start", "finite", "nan"]),
        ({"task.turn_rate": NAN}, ["task.turn_rate", "finite", "nan"]),
        ({"task.turn_rate": INF}, ["task.turn_rate", "finite", "inf"]),
        ({"task.start": "anywhere"}, ["task.start", "fixed", "random", "'anywhere'"]),
        ({"task.edges": []}, ["task.edges"]),
        ({"train.n_envs": 2.5}, ["train.n_envs", "integer", "2.5"]),
        ({"train.n_envs": 0}, ["train.n_envs", "greater than or equal to 1", "0"]),
        ({"train.reward_scale": -1}, ["train.reward_scale", "greater than 0", "-1"]),
        ({"task.maze": "lop"}, ["'lop'", "did you mean 'loop'", "circuit"]),
        ({"task.observation": "raw"}, ["qlearn", "discrete", "'raw'"]),
        ({"task": 3}, ["task"]),
    ],
)
def test_a_setting_that_does_not_fit_is_refused(settings, named):
    assert_refused(named, agent="qlearn", settings=settings)


def test_an_unknown_observation_is_refused():
    assert_refused(["'rw'", "did you mean 'raw'", "discrete"], agent="dqn", settings={"task.observation": "rw"})


@pytest.mark.parametrize("agent", agent_names())
def test_no_agent_ignores_a_setting(agent):
    assert_refused(["'no_such_key'"], agent=agent, settings={"agent.no_such_key": 1})


@pytest.mark.parametrize("content", ["- 1", "agent: qlearn", "agents: {}", "agent: {gama: 1}", "agent: [", "\x00"])
def test_a_preset_file_that_does_not_fit_is_refused(content, tmp_path: Path):
    (tmp_path / "mine.yaml").write_text(content)
    assert_refused([], preset=str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize("tree", [{}, [], {"agent": {}, "task": {}}, {"agent": {"name": "qlearn"}}])
def test_a_tree_that_is_no_config_is_refused(tree):
    with pytest.raises(InputError):
        config_from(tree)


def test_the_defaults_of_the_training_are_the_signatures():
    assert resolve("stable_baselines3:A2C").train == TrainSettings()


def assert_refused(named: list[str], **arguments) -> None:
    """`resolve` raises an `InputError` whose message is one line and holds what is `named`."""
    with pytest.raises(InputError) as refused:
        resolve(**arguments)
    message = str(refused.value)
    assert [part for part in named if part not in message] == [], message
    assert "\n" not in message
