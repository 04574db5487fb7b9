"""A folder for a robot: its program observes and acts as the policy does in simulation, with numpy and nothing else."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import sysconfig
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tb2rl.commands.export import export_folder
from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.deploy import SensorData, TrainedPolicy
from tb2rl.deploy.folder import program
from tb2rl.deploy.portable.main import main as drive
from tb2rl.deploy.portable.policy import ExportedPolicy
from tb2rl.envs.seeded_loop import SeededLoop
from tb2rl.runs.loading import config_of

NAMES = sorted(entry.parent.name for entry in top_folder("zoo").glob("*/config.yaml"))
PPO, RAW = "stable_baselines3:PPO", {"task.observation": "raw"}
SENSORS = ["laser", "bumper", "twist", {"last_action": {"count": 3}}, "free_paths", "visited"]
TASKS = {  # observations that no policy of the zoo has
    "another robot": (PPO, "drive", {**RAW, "task.robot": "turtlebot3", "task.observe": SENSORS}),
    "classes": ("qlearn", "maze", {"task.observe": ["bumper", "twist", "last_action", "free_paths"]}),
    "classes of a goal": ("qlearn", "wall", {"task.observe": ["goal", "goal_direction"], "task.frame_stack": 2}),
    "a goal": (PPO, "navigate", {**RAW, "task.frame_stack": 3}),
    "a plan": (PPO, "navigate", {**RAW, "task.guide": "plan"}),
    "classes of a plan": ("qlearn", "navigate", {"task.named_actions": True, "task.observe": ["waypoint_bearing"]}),
    "some beams": (PPO, "maze", {**RAW, "task.beams": 720, "task.beam_indices": [0, 144, 360, 576]}),
}


def sensor_data(robot_state, index: int, waypoints=None) -> SensorData:
    """The sensor data of one robot; with waypoints by its true pose, which a planner knows."""
    pose = robot_state.odometry if waypoints is None else robot_state.pose
    return SensorData(
        ranges=robot_state.ranges[index],
        pose=tuple(pose[index]),
        twist=tuple(robot_state.odometry_twist[index]),
        bumped=bool(robot_state.bumped[index]),
        command=tuple(robot_state.command[index]),
        goal=tuple(robot_state.goal[index]),
        waypoint=None if waypoints is None else tuple(waypoints[index]),
    )


def compare_in_simulation(policy, folder: Path, steps: int) -> None:
    """Drive two robots at random; compare observations and commands of the program, of a driver and of the policy."""
    scene = config_of(policy).scene.changed(variation="none")  # without latency
    exported, trained = (
        [kind(of) for _ in range(2)] for kind, of in ((ExportedPolicy, folder), (TrainedPolicy, policy))
    )
    needs = exported[0].needs
    scene.action_space.seed(0)
    with closing(SeededLoop.open(scene, "kinematic", 2)) as loop:
        loop.seed(0)
        observations, ended = loop.reset_all(), np.arange(2)
        for _ in range(steps):
            for index in ended:
                exported[index].reset(), trained[index].reset()
            waypoints = loop.robot_state.lookahead_point(needs.lookahead) if needs.goal == "plan" else None
            for index in range(2):
                sensed = sensor_data(loop.robot_state, index, waypoints)
                action, _ = policy.predict(observations[index], deterministic=True)
                expected = scene.actions.commands(action[None])[0]
                for one in (exported[index], trained[index]):
                    np.testing.assert_allclose(one.act(sensed), expected, rtol=0.0, atol=1e-5)
                np.testing.assert_array_equal(exported[index].observed[0], observations[index])
                assert exported[index].observed.dtype == observations[index].dtype
            step = loop.step_and_reset(np.stack([scene.action_space.sample() for _ in range(2)]))
            observations = step.observations
            ended = step.finished.indices if step.finished else ()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_policy_of_the_zoo_observes_and_acts_the_same_on_a_robot(name, loaded, tmp_path):
    export_folder(f"zoo:{name}", tmp_path)
    compare_in_simulation(loaded(f"zoo:{name}"), tmp_path, 200)


@pytest.mark.parametrize("kind", TASKS)
def test_each_sensor_of_a_robot_is_read_as_in_simulation(kind, untrained, loaded, tmp_path):
    folder = untrained(*TASKS[kind])
    export_folder(folder, tmp_path)
    compare_in_simulation(loaded(folder), tmp_path, 40)


def test_a_policy_that_draws_a_map_needs_a_plan_on_a_robot(untrained, tmp_path):
    folder = untrained(PPO, "navigate", {**RAW, "task.guide": "plan", "task.map": "online", "task.lookahead": 1.2})
    export_folder(folder, tmp_path)
    needs = ExportedPolicy(tmp_path).needs
    assert (needs.goal, needs.lookahead, needs.uses_odometry) == ("plan", 1.2, True)


def test_the_imu_is_read_as_by_a_driver_of_tb2rl(untrained, loaded, tmp_path):
    folder = untrained(PPO, "drive", {**RAW, "task.observe": ["laser", "imu"]})
    export_folder(folder, tmp_path)
    exported, trained, rng = ExportedPolicy(tmp_path), TrainedPolicy(loaded(folder)), np.random.default_rng(0)
    exported.reset(), trained.reset()
    for _ in range(20):
        ranges, twist = rng.uniform(0.1, 30.0, len(trained.needs.beams)), tuple(rng.uniform(-0.6, 0.6, 2))
        sensed = SensorData(ranges=ranges, twist=twist)
        np.testing.assert_allclose(exported.act(sensed), trained.act(sensed), rtol=0.0, atol=1e-5)
    assert np.abs(exported.observed[0, -1]) > 0.01, "it accelerates"


@pytest.fixture
def alone(robot, tmp_path):
    """A function that runs code with the standard library, numpy and an exported folder, and nothing else."""
    for name in ("numpy", "numpy.libs"):
        if (installed := Path(sysconfig.get_path("purelib"), name)).exists():
            (tmp_path / name).symlink_to(installed)

    def run(code: str, lines: str = "", folder: Path = robot, python: str = "") -> subprocess.CompletedProcess[str]:
        start = f"import sys; sys.path += {[str(folder)] if python else [str(tmp_path), str(folder)]}"
        command = [python, "-c"] if python else [sys.executable, "-I", "-S", "-c"]
        command += [f"{start}\n{code}"]
        return subprocess.run(command, cwd=folder, input=lines, capture_output=True, text=True, check=False)

    return run


FOREIGN = """
import importlib.util
names = ["torch", "stable_baselines3", "gymnasium", "numba", "onnx", "onnxruntime", "tb2rl", "yaml", "drive"]
print([name for name in names if importlib.util.find_spec(name)])
"""
MAIN = "import drive; drive.main({})"


def lines_of(ranges, angles) -> str:
    """Input lines: a scan, a start, and two times."""
    facts = {"angle_min": angles[0], "angle_increment": angles[1] - angles[0], "range_min": 0.1, "range_max": 30.0}
    first = {"time": 1.0, "scan": {"ranges": list(ranges), **facts}}
    return "\n".join(map(json.dumps, [first, {"time": 1.0, "start": True}, {"time": 1.1}, {"time": 9.0}]))


@pytest.mark.parametrize("python", ["", "python3.8"])
def test_the_program_drives_with_numpy_and_nothing_else(python, alone, loaded):
    if python and subprocess.run([python, "-c", "import numpy"], capture_output=True, check=False).returncode:
        pytest.skip("the oldest Python is not here")
    if not python:
        assert alone(FOREIGN).stdout == "['drive']\n"
    policy = loaded("zoo:drive-loop-ppo")
    scene = config_of(policy).scene
    scene.observation_space.seed(3)
    seen = scene.observation_space.sample()
    done = alone(MAIN.format("['--speed', '0.1']"), lines_of(seen.tolist(), scene.laser.angles), python=python)
    assert done.returncode == 0
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    whys = ["not started", "driving", "driving", "the last scan is 8.0 s old", "the input ended"]
    assert [line["why"] for line in answers] == whys
    v, w = scene.actions.commands(policy.predict(seen, deterministic=True)[0][None])[0]
    scale = min(1.0, 0.1 / abs(v))
    for line, factor in zip(answers, (0.0, scale, scale, 0.0, 0.0), strict=True):
        assert (line["v"], line["w"]) == pytest.approx((factor * v, factor * w), abs=1e-5)


def test_the_program_is_imported_as_its_readme_says(alone, robot):
    (code,) = re.findall(r"^```python\n(.*?)^```$", (robot / "README.md").read_text(), flags=re.DOTALL | re.MULTILINE)
    values = "ranges, angle_min, angle_increment, range_min, range_max = [2.0] * 37, -1.58, 3.16 / 36, 0.1, 30.0"
    done = alone(f"{values}\n{code}\nprint(command.why)")
    assert (done.stdout, done.stderr) == ("driving\n", "")


MY_FILTER = """
from math import inf as far

import numpy as np

from tb2rl.envs.filters import Filter

class StopNear(Filter):
    def __init__(self, distance):
        self.distance = distance

    def __call__(self, commands, robot_state):
        near = np.min(robot_state.ranges, axis=1, initial=far) < self.distance
        return np.where(near[:, None], 0.0, commands)
"""


def test_a_filter_of_ones_own_is_packed_into_the_program(alone, robot, tmp_path):
    folder = shutil.copytree(robot, tmp_path / "copy")
    (tmp_path / "my_filter.py").write_text(MY_FILTER)
    (folder / "drive.py").write_text(program([tmp_path / "my_filter.py"]))
    about = json.loads((folder / "policy.json").read_text())
    about["filters"] = [{"class": "StopNear", "arguments": {"distance": 0.5}}]
    (folder / "policy.json").write_text(json.dumps(about))
    for distance, stands in ((0.3, True), (3.0, False)):
        lines = lines_of(np.full(181, distance), np.linspace(-1.6, 1.6, 181))
        answers = [json.loads(line) for line in alone(MAIN.format("[]"), lines, folder).stdout.splitlines()]
        assert answers[1]["why"] == "driving"
        assert ((answers[1]["v"], answers[1]["w"]) == (0.0, 0.0)) == stands
    (tmp_path / "my_filter.py").write_text(MY_FILTER + "\nclass Driver: pass\n")
    with pytest.raises(InputError, match=r"drive\.py defines Driver"):
        program([tmp_path / "my_filter.py"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed=-5"], ["speed", "above 0", "-5"]),
        (["--turn-rate=nan"], ["turn_rate", "above 0", "nan"]),
        (["--scanner", "0", "nan", "0"], ["mounting", "nan"]),
        (["--speed=fast"], ["--speed", "fast"]),
        (["--spead=1"], ["--spead"]),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(arguments, words, robot, capsys):
    with pytest.raises(SystemExit) as stopped:
        drive([str(robot), *arguments])
    message = capsys.readouterr().err
    assert (stopped.value.code, message.count("\n")) == (2, 1)
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("damaged", ["weights.npz", "policy.json"])
def test_a_damaged_folder_is_refused_in_one_line(damaged, robot, tmp_path, capsys):
    folder = shutil.copytree(robot, tmp_path / "copy")
    (folder / damaged).write_bytes((folder / damaged).read_bytes()[:200])
    with pytest.raises(SystemExit) as stopped:
        drive([str(folder)])
    output = capsys.readouterr()
    assert (stopped.value.code, output.err.count("\n")) == (2, 1)
    assert "damaged" in output.err
    assert json.loads(output.out)["v"] == 0.0
