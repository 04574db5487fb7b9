"""The command `export`: a file or a folder, their descriptions, and refusals in one line."""

import json
import sys

import numpy as np
import pytest

from tb2rl import export
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run

MODULE = """
from stable_baselines3.common.policies import ActorCriticPolicy
from tb2rl.sensors import Sensor

class ReversedActions(ActorCriticPolicy):
    def _predict(self, observation, deterministic=False):
        return 2 - super()._predict(observation, deterministic)

class Compass(Sensor):
    name, unit, low, high = "compass", "rad", -4.0, 4.0

    def read(self, robot_state):
        return robot_state.odometry[:, 2:]
"""


@pytest.fixture
def untrained(module_folder):
    """A function that saves an untrained policy as a run folder, with the module `mine` of a user."""
    (module_folder / "mine.py").write_text(MODULE)

    def save(**settings):
        task = {f"task.{key}": value for key, value in settings.items()}
        config = resolve("stable_baselines3:PPO", settings={"train.n_envs": 2, "task.observation": "raw", **task})
        run = Run.create(module_folder / f"run_{len([*module_folder.iterdir()])}", config)
        run.save(make_algorithm(config), "final/policy")
        return str(run.folder)

    return save


def test_a_file_describes_its_inputs_and_outputs(workdir, capsys):
    onnx = pytest.importorskip("onnx")
    export.main(["zoo:wall-wall-dqn", "policy.onnx"])
    assert "policy.onnx" in capsys.readouterr().out
    model = onnx.load(workdir / "policy.onnx")
    assert (model.opset_import[0].version, model.ir_version) == (17, 8)
    assert [each.name for each in (*model.graph.input, *model.graph.output)] == ["observation", "action", "command"]
    about = json.loads({each.key: each.value for each in model.metadata_props}["tb2rl"])
    sensors = [(sensor["name"], sensor["unit"]) for sensor in about["observation"]["sensors"]]
    assert sensors == [("laser", "m"), ("goal distance", "m"), ("goal bearing", "rad")]
    assert (about["control_period"], about["config"]["agent"]["name"], len(about["beams"])) == (0.2, "dqn", 36)
    assert about["actions"]["names"] == ["forward", "left", "right"]


def test_a_folder_is_overwritten_and_keeps_its_other_files(workdir):
    (workdir / "notes.txt").write_text("mine")
    for name in ("zoo:maze-loop-dqn", "zoo:maze-loop-qlearn"):
        export.main([name, "."])
    files = ["README.md", "drive.py", "notes.txt", "policy.json", "weights.npz"]
    assert sorted(file.name for file in workdir.iterdir()) == files
    assert [*np.load(workdir / "weights.npz", allow_pickle=False)] == ["0.strides", "0.best"]
    assert "zoo:maze-loop-qlearn" in (workdir / "README.md").read_text()


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("ppo x", ["ppo", "run folder"]),
        ("zoo:maze-loop-dqn /proc/none/x.onnx", ["cannot write", "/proc/none"]),
        ("zoo:maze-loop-dqn taken", ["taken"]),
    ],
)
def test_wrong_input_is_refused_in_one_line(line, named, workdir, refused):
    (workdir / "taken").touch()
    refused(export.main, line, named)


def test_without_onnx_the_message_names_the_package(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.delitem(sys.modules, "tb2rl.deploy.graph", raising=False)
    refused(export.main, "zoo:maze-loop-dqn policy.onnx", ["needs onnx: pip install", ".[export]"])


def test_images_and_sensors_of_ones_own_go_into_a_file_but_not_into_a_folder(untrained, workdir, refused):
    pytest.importorskip("onnx")
    for sensor, name in (({"camera": {"width": 36, "height": 36}}, "'camera'"), ("mine:Compass", "'compass'")):
        run = untrained(observe=["laser", sensor])
        refused(export.main, [run, "robot"], [name, "policy.onnx"])
    export.main([run, "policy.onnx"])


def test_a_policy_that_computes_more_than_its_layers_is_refused(untrained, monkeypatch, refused):
    pytest.importorskip("onnx")
    run = untrained()
    from mine import ReversedActions
    from stable_baselines3 import PPO

    monkeypatch.setitem(PPO.policy_aliases, "MlpPolicy", ReversedActions)
    for target in ("policy.onnx", "robot"):
        refused(export.main, [run, target], ["ReversedActions"])
