"""Layers of presets and settings; later ones win."""

import pytest
import yaml

from tb2rl.core.files import top_folder
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.runs.config import as_preset, parse_settings, resolve
from tb2rl.tasks.wander import Wander

CONFIGS = top_folder("configs")


def test_later_layers_win(tmp_path, monkeypatch):
    fields = ("turn_rate", "turn_speed", "laser_noise", "forward_speed")  # each layer sets one field less
    files = [tmp_path / name for name in ("tasks/maze.yaml", "agents/qlearn.yaml", "mine.yaml")]
    for layer, file in enumerate(files):
        file.parent.mkdir(exist_ok=True)
        file.write_text(yaml.safe_dump({"task": dict.fromkeys(fields[layer:], 0.1 * (layer + 1))}))
    monkeypatch.setattr("tb2rl.runs.config.top_folder", lambda _: tmp_path)
    task = resolve("qlearn", "maze", "mine", {"task.forward_speed": 0.4}).task
    assert [getattr(task, field) for field in fields] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert task.control_period == Wander().control_period, "the default of the signature"


def test_settings_of_a_robot_lie_between_built_in_and_user_presets(tmp_path):
    (tmp_path / "mine.yaml").write_text("task: {robot: turtlebot3, laser_noise: 0.01}")
    (tmp_path / "slow.yaml").write_text("task: {robot: turtlebot3, control_period: 1.0}")
    for preset, settings, period in (
        ("mine", {}, 0.4),
        ("slow", {}, 1.0),
        ("slow", {"task.control_period": 0.3}, 0.3),
        ("mine", {"task.robot": "turtlebot2"}, 0.2),
    ):
        assert resolve("ppo", "wall", str(tmp_path / f"{preset}.yaml"), settings).task.control_period == period
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
def test_every_shipped_config_is_read_and_resolves(file):
    kind, name = file.parent.name, file.stem
    if kind == "kinematic":
        envs = [resolve(name, settings={"train.simulation": each}).train.n_envs for each in ("kinematic", "bullet")]
        assert envs[0] > envs[1]
    elif kind == "tasks" and name not in task_names():
        task, _, agent = name.rpartition("-")
        assert resolve(agent, task).agent_arguments["gamma"] != resolve(agent).agent_arguments.get("gamma")
    elif kind in ("agents", "tasks"):
        resolve(**{kind.removesuffix("s"): name})
    else:
        assert resolve(preset=name) == resolve(preset=str(file))


def test_settings_of_the_command_line_are_yaml():
    pairs = ["a.b=1", "a.c=2.5", "a.d=circuit", "a.e=[1, 2]", "a.f={start: 1, end: 0}", "a.g=null", "a.h=x=y", "a.i="]
    line = {"start": 1, "end": 0}
    assert list(parse_settings(pairs).values()) == [1, 2.5, "circuit", [1, 2], line, None, "x=y", None]


@pytest.mark.parametrize("pair", ["a.b", "a.b=[1", "a.b=&x [*x]", "a.b=" + "9" * 5000, "a.b=!!python/name:os.mkdir"])
def test_a_pair_that_is_not_a_setting_is_refused(pair, refused):
    assert "a.b" in refused(parse_settings, [pair])


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
        ({"settings": {"agnt.gamma": 0.9}}, ["'agnt'", "did you mean 'agent'", "task", "train"]),
        ({"settings": {"agent.gama": 0.9}}, ["'gama'", "did you mean 'gamma'", "learning_rate"]),
        ({"settings": {"task.turnrate": 1}}, ["'turnrate'", "did you mean 'turn_rate'", "forward_speed"]),
        ({"settings": {"train.sead": 1}}, ["'sead'", "did you mean 'seed'", "n_envs"]),
        ({"settings": {"task.start": "anywhere"}}, ["task.start", "fixed", "random", "'anywhere'"]),
        ({"settings": {"train.n_envs": 2.5}}, ["train.n_envs", "integer", "2.5"]),
        ({"settings": {"train.reward_scale": -1}}, ["train.reward_scale", "greater than 0", "-1"]),
        ({"settings": {"task.world": "lop"}}, ["'lop'", "did you mean 'loop'", "circuit"]),
        ({"settings": {"task.observation": "raw"}}, ["qlearn", "discrete", "'raw'"]),
        ({"settings": {"task.robot.x": 1, "task.robot": "jackal", "task.robot.y": 1}}, ["contradict each other"]),
        (
            {"settings": {"world": 1}},
            ["setting 'world' needs its section, one of agent.world, task.world, train.world"],
        ),
    ],
)
def test_what_does_not_fit_is_refused(arguments, named, refused):
    message = refused(resolve, **arguments)
    assert [part for part in named if part not in message] == [], message


@pytest.mark.parametrize("agent", agent_names())
def test_no_agent_ignores_a_setting(agent, refused):
    assert "'no_such_key'" in refused(resolve, agent, settings={"agent.no_such_key": 1})


@pytest.mark.parametrize("content", ["- 1", "agent: qlearn", "agents: {}", "agent: {gama: 1}", "\x00"])
def test_a_preset_file_that_does_not_fit_is_refused(content, refused, tmp_path):
    (tmp_path / "mine.yaml").write_text(content)
    refused(resolve, preset=str(tmp_path / "mine.yaml"))
