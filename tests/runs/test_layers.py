"""Layers of presets and settings; later ones win."""

from __future__ import annotations

from itertools import product

import pytest
import yaml

from tb2rl.core.files import top_folder
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.runs.layers import as_preset, parse_settings, resolve
from tb2rl.tasks.wander import Wander

CONFIGS = top_folder("configs")


def test_later_layers_win(tmp_path, monkeypatch):
    fields = ("turn_rate", "turn_speed", "laser_noise", "forward_speed")  # each layer sets one field less
    files = [tmp_path / name for name in ("tasks/maze.yaml", "agents/qlearn.yaml", "mine.yaml")]
    for layer, file in enumerate(files):
        file.parent.mkdir(exist_ok=True)
        file.write_text(yaml.safe_dump({"task": dict.fromkeys(fields[layer:], 0.1 * (layer + 1))}))
    monkeypatch.setattr("tb2rl.runs.layers.top_folder", lambda _: tmp_path)
    task = resolve("qlearn", "maze", "mine", {"task.forward_speed": 0.4}).task
    assert [getattr(task, field) for field in fields] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert task.control_period == Wander().control_period, "the default of the signature"


def test_settings_of_a_robot_lie_between_built_in_and_user_presets(tmp_path):
    (tmp_path / "mine.yaml").write_text("task: {robot: turtlebot3, laser_noise: 0.01}")
    (tmp_path / "slow.yaml").write_text("task: {robot: turtlebot3, control_period: 1.0}")
    for preset, settings, period in (
        ("mine", {}, 0.4),
        ("slow", {}, 1.0),
        (None, {"task.robot": "turtlebot3"}, 0.4),
        ("slow", {"task.control_period": 0.3}, 0.3),
        ("mine", {"task.robot": "turtlebot2"}, 0.2),
    ):
        preset = preset and str(tmp_path / f"{preset}.yaml")
        assert resolve("ppo", "wall", preset, settings).task.control_period == period


def test_a_policy_on_another_robot_gets_that_robots_settings():
    trained = resolve("ppo")
    assert trained.with_task({"robot": "turtlebot3"}).task.control_period == 0.4
    assert trained.with_task({"robot": "turtlebot3", "control_period": 0.1}).task.control_period == 0.1


def test_the_name_on_the_command_line_wins_over_the_presets():
    assert resolve(preset="tutorial").agent_name == "qlearn"
    assert resolve(settings={"agent.name": "ppo", "task.name": "wall"}).task_name == "wall"
    assert resolve("dqn", settings={"agent.name": "ppo"}).agent_name == "dqn"


def test_a_preset_made_of_arguments_resolves_to_the_same_config(tmp_path):
    arguments = {"preset": "tutorial-wall", "settings": {"agent.gamma": 0.5}}
    (tmp_path / "all.yaml").write_text(yaml.safe_dump(as_preset(**arguments)))
    assert resolve(preset=str(tmp_path / "all.yaml")) == resolve(**arguments)


def test_schedules_and_numbers_replace_each_other(tmp_path):
    (tmp_path / "mine.yaml").write_text("agent: {learning_rate: {start: 0.5, end: 0.4, fraction: 0.3}}")
    line = {"start": 0.2, "end": 0.1}
    assert resolve("dqn", settings={"agent.learning_rate": line}).agent_arguments["learning_rate"] == line
    assert resolve("ppo", settings={"agent.learning_rate": 0.1}).agent_arguments["learning_rate"] == 0.1
    mine = resolve(preset=str(tmp_path / "mine.yaml"), settings={"agent.learning_rate": line})
    assert mine.agent_arguments["learning_rate"] == line, "without parts of the replaced schedule"


PRESETS = sorted(file for file in CONFIGS.rglob("*.yaml") if file.parent.name not in ("tuning", "worlds"))


@pytest.mark.parametrize("file", PRESETS, ids=lambda file: str(file.relative_to(CONFIGS)))
def test_every_shipped_config_resolves(file):
    if file.parent.name == "kinematic":
        assert file.stem in agent_names(), "a preset that nobody reads"
        kinematic, bullet = (
            resolve(file.stem, settings={"train.simulation": name}) for name in ("kinematic", "bullet")
        )
        assert kinematic.train.n_envs > bullet.train.n_envs
    elif file.parent.name == "tasks" and file.stem not in task_names():
        task, _, agent = file.stem.rpartition("-")
        assert (task, agent) in product(task_names(), agent_names()), "a preset that nobody reads"
        assert resolve(agent, task).agent_arguments["gamma"] != resolve(agent).agent_arguments.get("gamma")
    elif file.parent.name in ("agents", "tasks"):
        kind = file.parent.name.removesuffix("s")
        assert file.stem in (agent_names() if kind == "agent" else task_names()), "a preset that nobody reads"
        assert getattr(resolve(**{kind: file.stem}), f"{kind}_name") == file.stem
    else:
        assert resolve(preset=file.stem) == resolve(preset=str(file))


def test_settings_of_the_command_line_are_yaml():
    pairs = ["a.b=1", "a.c=2.5", "a.d=circuit", "a.e=[1, 2]", "a.f={start: 1, end: 0}", "a.g=null", "a.h=x=y", "a.i="]
    line = {"start": 1, "end": 0}
    assert list(parse_settings(pairs).values()) == [1, 2.5, "circuit", [1, 2], line, None, "x=y", None]


@pytest.mark.parametrize("pair", ["a.b", "a.b=[1", "a.b=&x [*x]"])
def test_a_pair_that_is_not_a_setting_is_refused(pair, refused):
    assert "a.b" in refused(parse_settings, [pair])


@pytest.mark.parametrize("value", ["9" * 5000, "!!timestamp 2001-99-01", "!!python/name:os.mkdir"])
def test_a_value_that_does_not_fit_its_tag_is_refused(value, refused):
    assert "is not YAML" in refused(parse_settings, [f"agent.gamma={value}"])


@pytest.mark.parametrize("value", ["1.0e-3", "1e-3", "0.001"])
def test_a_number_is_a_number_however_it_is_written(value):
    config = resolve("qlearn", settings=parse_settings([f"agent.gamma={value}", f"task.laser_noise={value}"]))
    assert (config.agent_arguments["gamma"], config.task.laser_noise) == (0.001, 0.001)


# ---- refusals, with the words of their messages


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"agent": "qlern"}, ["'qlern'", "did you mean 'qlearn'", *agent_names()]),
        ({"task": "wal"}, ["'wal'", "did you mean 'wall'", *task_names()]),
        ({"preset": "tutoral"}, ["'tutoral'", "did you mean 'tutorial'"]),
        ({"preset": "no/such.yaml"}, ["no/such.yaml"]),
        ({"preset": "x" * 5000 + ".yaml"}, ["preset file"]),
        ({"agent": "dqn", "settings": {"task.observation": "rw"}}, ["'rw'", "did you mean 'raw'", "discrete"]),
    ],
)
def test_an_unknown_name_is_refused(arguments, named, refused):
    message = refused(resolve, **arguments)
    assert [part for part in named if part not in message] == [], message


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"agnt.gamma": 0.9}, ["'agnt'", "did you mean 'agent'", "task", "train"]),
        ({"agent.gama": 0.9}, ["'gama'", "did you mean 'gamma'", "learning_rate"]),
        ({"task.turnrate": 1}, ["'turnrate'", "did you mean 'turn_rate'", "forward_speed"]),
        ({"train.sead": 1}, ["'sead'", "did you mean 'seed'", "n_envs"]),
        ({"agent.exploration": "greedy"}, ["agent.exploration", "epsilon_greedy", "noisy_values", "'greedy'"]),
        ({"task.start": "anywhere"}, ["task.start", "fixed", "random", "'anywhere'"]),
        ({"train.n_envs": 2.5}, ["train.n_envs", "integer", "2.5"]),
        ({"train.reward_scale": -1}, ["train.reward_scale", "greater than 0", "-1"]),
        ({"task.world": "lop"}, ["'lop'", "did you mean 'loop'", "circuit"]),
        ({"task.observation": "raw"}, ["qlearn", "discrete", "'raw'"]),
        ({"task": 3}, ["task"]),
    ],
)
def test_a_setting_that_does_not_fit_is_refused(settings, named, refused):
    message = refused(resolve, "qlearn", settings=settings)
    assert [part for part in named if part not in message] == [], message


@pytest.mark.parametrize("agent", agent_names())
def test_no_agent_ignores_a_setting(agent, refused):
    assert "'no_such_key'" in refused(resolve, agent, settings={"agent.no_such_key": 1})


@pytest.mark.parametrize("content", ["- 1", "agent: qlearn", "agents: {}", "agent: {gama: 1}", "\x00"])
def test_a_preset_file_that_does_not_fit_is_refused(content, refused, tmp_path):
    (tmp_path / "mine.yaml").write_text(content)
    refused(resolve, preset=str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize(
    ("key", "named"),
    [
        ("world", "task.world"),
        ("gamma", "agent.gamma"),
        ("observation", "task.observation"),
        ("name", "agent.name or task.name"),
        ("no_such", "agent.no_such, task.no_such or train.no_such"),
    ],
)
def test_a_setting_without_its_section_is_refused_with_the_sections_that_have_it(key, named, refused):
    assert refused(resolve, settings={key: 1}) == f"setting {key!r} needs its section: {named}"
