"""The command `export`: a file or a folder, what they say of themselves, and what it refuses in one line."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from tb2rl import export
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve

MINE = """
from stable_baselines3.common.policies import ActorCriticPolicy
from tb2rl.sensors import Sensor

class Otherwise(ActorCriticPolicy):
    "It does more than its layers say."

    def _predict(self, observation, deterministic=False):
        return 2 - super()._predict(observation, deterministic)

class Compass(Sensor):
    name, unit, low, high = "compass", "rad", -4.0, 4.0

    def read(self, reading):
        return reading.odometry[:, 2:]
"""


@pytest.fixture
def untrained(tmp_path, monkeypatch):
    """A function that keeps a policy that nobody trained as a run folder, beside classes of a user's own."""
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    yield lambda **settings: _keep(tmp_path / "run", {f"task.{key}": value for key, value in settings.items()})
    sys.modules.pop("mine", None)


def _keep(folder, settings):
    config = resolve("stable_baselines3:PPO", settings={"train.n_envs": 2, "task.observation": "raw", **settings})
    run = Run.create(folder, config)
    run.save(make_algorithm(config, Spaces.vectorised(config)), "final/policy")
    return run.folder


def refusal(line: list[str], capsys) -> str:
    with pytest.raises(SystemExit) as stopped:
        export.main(line)
    message = capsys.readouterr().err
    assert (stopped.value.code, message.count("\n")) == (2, 1)
    return message


def test_a_file_says_what_goes_in_and_what_comes_out(tmp_path, capsys):
    onnx = pytest.importorskip("onnx")
    export.main(["zoo:wall-wall-dqn", str(tmp_path / "policy.onnx")])
    assert str(tmp_path / "policy.onnx") in capsys.readouterr().out
    model = onnx.load(tmp_path / "policy.onnx")
    assert (model.opset_import[0].version, model.ir_version) == (17, 8)
    assert [each.name for each in model.graph.input] == ["observation"]
    assert [each.name for each in model.graph.output] == ["action", "command"]
    about = json.loads({each.key: each.value for each in model.metadata_props}["tb2rl"])
    sensors = [(sensor["name"], sensor["unit"]) for sensor in about["observation"]["sensors"]]
    assert sensors == [("laser", "m"), ("goal distance", "m"), ("goal bearing", "rad")]
    assert (about["control_period"], about["config"]["agent"]["name"], len(about["beams"])) == (0.2, "dqn", 36)
    assert about["actions"]["names"] == ["forward", "left", "right"]


def test_a_folder_is_written_again_and_keeps_what_else_is_in_it(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for name in ("zoo:maze-loop-dqn", "zoo:maze-loop-qlearn"):
        export.main([name, str(tmp_path)])
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "README.md", "drive.py", "notes.txt", "policy.json", "weights.npz",
    ]  # fmt: skip
    assert json.loads((tmp_path / "policy.json").read_text())["agent"] == "qlearn"
    assert [*np.load(tmp_path / "weights.npz", allow_pickle=False)] == ["0.strides", "0.best"]
    assert "zoo:maze-loop-qlearn" in (tmp_path / "README.md").read_text()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("zoo:none x.onnx", ["none", "zoo"]),
        ("nowhere x", ["nowhere"]),
        ("wallfollower x", ["wallfollower", "does not learn"]),
        ("ppo x", ["ppo", "run folder"]),
        ("zoo:maze-loop-dqn /proc/none/x.onnx", ["cannot write", "/proc/none"]),
        ("zoo:maze-loop-dqn /proc/none", ["/proc/none"]),
        ("zoo:maze-loop-dqn taken", ["taken"]),
    ],
)
def test_bad_input_is_one_line(line, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    message = refusal(line.split(), capsys)
    assert [word for word in words if word not in message] == []
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


def test_without_onnx_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.delitem(sys.modules, "tb2rl.deploy.graph", raising=False)
    assert "pip install onnx" in refusal(["zoo:maze-loop-dqn", str(tmp_path / "policy.onnx")], capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_sensor_of_ones_own_goes_into_a_file_and_not_into_a_folder(untrained, tmp_path, capsys):
    pytest.importorskip("onnx")
    run = untrained(observe=["laser", "mine:Compass"])
    message = refusal([str(run), str(tmp_path / "robot")], capsys)
    assert "'compass'" in message
    assert "policy.onnx" in message
    export.main([str(run), str(tmp_path / "policy.onnx")])
    assert not (tmp_path / "robot").exists()


def test_images_go_into_a_file_and_not_into_a_folder(untrained, tmp_path, capsys):
    pytest.importorskip("onnx")
    run = untrained(observe=["laser", {"camera": {"width": 36, "height": 36}}])
    assert "'camera'" in refusal([str(run), str(tmp_path / "robot")], capsys)
    export.main([str(run), str(tmp_path / "policy.onnx")])


def test_a_policy_that_does_more_than_its_layers_say_is_refused(untrained, tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnx")
    run = untrained()
    from mine import Otherwise
    from stable_baselines3 import PPO

    monkeypatch.setitem(PPO.policy_aliases, "MlpPolicy", Otherwise)
    for target in ("policy.onnx", "robot"):
        assert "Otherwise" in refusal([str(run), str(tmp_path / target)], capsys)
        assert not (tmp_path / target).exists()
