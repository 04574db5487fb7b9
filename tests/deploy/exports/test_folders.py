"""A folder for a robot: its program observes and acts as the policy does in simulation, with numpy and nothing else."""

import ast
import json
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from tb2rl.commands.export import export_folder
from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import FILTERS
from tb2rl.deploy import SensorData, TrainedPolicy
from tb2rl.deploy.folder import build_program
from tb2rl.deploy.portable.main import main as drive
from tb2rl.deploy.portable.policy import ExportedPolicy
from tb2rl.envs.make import make_env
from tb2rl.runs.loading import config_of

NAMES = sorted(entry.parent.name for entry in top_folder("zoo").glob("*/config.yaml"))
PPO, RAW = "stable_baselines3:PPO", {"task.observation": "raw"}
SENSORS = ["laser", "bumper", "twist", {"last_action": {"count": 3}}, "free_paths", "visited"]
TASKS = {  # observations that no policy of the zoo has
    "another robot": (PPO, "drive", {**RAW, "task.robot": "turtlebot3", "task.observe": SENSORS}),
    "classes": ("qlearn", "maze", {"task.observe": ["bumper", "twist", "last_action", "free_paths"]}),
    "classes of a goal": ("qlearn", "wall", {"task.observe": ["goal", "goal_direction"], "task.frame_stack": 2}),
    "a plan": (PPO, "navigate", {**RAW, "task.guide": "plan", "task.frame_stack": 3}),
    "classes of a plan": ("qlearn", "navigate", {"task.named_actions": True, "task.observe": ["waypoint_bearing"]}),
    "some beams": (PPO, "maze", {**RAW, "task.beams": 720, "task.beam_indices": [0, 144, 360, 576]}),
}


def compare_in_simulation(policy, folder: Path, steps: int) -> None:
    """Drive at random; compare observations and commands of the program, of a driver and of the policy."""
    env = make_env(policy, simulation="kinematic", variation="none", dynamic_obstacles=None)
    exported, trained, ended = ExportedPolicy(folder), TrainedPolicy(policy), True
    plans = exported.needs.goal == "plan"
    env.action_space.seed(0)
    for step in range(steps):
        if ended:
            observation, _ = env.reset(seed=step)
            exported.reset(), trained.reset()
        state = env.robot_state
        sensed = SensorData(
            ranges=state.ranges[0],
            pose=tuple((state.pose if plans else state.odometry)[0]),  # a planner knows the true pose
            twist=tuple(state.odometry_twist[0]),
            bumped=bool(state.bumped[0]),
            command=tuple(state.command[0]),
            goal=tuple(state.goal[0]),
            waypoint=tuple(state.lookahead_point(exported.needs.lookahead)[0]) if plans else None,
        )
        action, _ = policy.predict(observation, deterministic=True)
        expected = env.scene.actions.commands(action[None])[0]
        for each in (exported, trained):
            np.testing.assert_allclose(each.act(sensed), expected, rtol=0.0, atol=1e-5)
        np.testing.assert_array_equal(exported.observation[0], observation)
        assert exported.observation.dtype == observation.dtype
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "navigate-online-ppo"])
def test_a_policy_of_the_zoo_observes_and_acts_the_same_on_a_robot(name, loaded, tmp_path):
    export_folder(f"zoo:{name}", tmp_path)
    compare_in_simulation(loaded(f"zoo:{name}"), tmp_path, 200)


def test_a_policy_with_two_points_of_a_plan_has_no_folder(tmp_path):
    with pytest.raises(InputError, match=r"^the sensors read 2 points of a plan, and a driver has only one$"):
        export_folder("zoo:navigate-online-ppo", tmp_path)  # another program would have to plan


@pytest.mark.parametrize("kind", TASKS)
def test_each_sensor_of_a_robot_is_read_as_in_simulation(kind, untrained, loaded, tmp_path):
    folder = untrained(*TASKS[kind])
    export_folder(folder, tmp_path)
    compare_in_simulation(loaded(folder), tmp_path, 60)


def test_a_policy_that_draws_a_map_needs_a_plan_on_a_robot(untrained, tmp_path):
    folder = untrained(PPO, "navigate", {**RAW, "task.guide": "plan", "task.map": "online", "task.lookahead": 1.2})
    export_folder(folder, tmp_path)
    needs = ExportedPolicy(tmp_path).needs
    assert (needs.goal, needs.lookahead, needs.uses_odometry) == ("plan", 1.2, True)


def test_the_imu_is_read_as_by_a_driver_of_tb2rl(untrained, loaded, tmp_path):
    folder = untrained(PPO, "drive", {**RAW, "task.observe": ["imu"]})
    export_folder(folder, tmp_path)
    exported, trained, rng = ExportedPolicy(tmp_path), TrainedPolicy(loaded(folder)), np.random.default_rng(0)
    exported.reset(), trained.reset()
    for _ in range(20):
        sensed = SensorData(ranges=np.full(len(trained.needs.beams), 5.0), twist=tuple(rng.uniform(-0.6, 0.6, 2)))
        np.testing.assert_allclose(exported.act(sensed), trained.act(sensed), rtol=0.0, atol=1e-5)
    assert np.abs(exported.observation[0, -1]) > 0.01, "it accelerates"


@pytest.fixture
def alone(robot, tmp_path):
    """A function that runs code with the standard library, numpy and an exported folder, and nothing else."""
    for name in ("numpy", "numpy.libs"):
        if (installed := Path(sysconfig.get_path("purelib"), name)).exists():
            (tmp_path / name).symlink_to(installed)

    def run(code: str, lines: str = "", folder: Path = robot) -> subprocess.CompletedProcess[str]:
        program = f"import sys; sys.path += {[str(tmp_path), str(folder)]}\n{code}"
        command = [sys.executable, "-I", "-S", "-c", program]
        return subprocess.run(command, cwd=folder, input=lines, capture_output=True, text=True, check=False)

    return run


@pytest.fixture
def copy(robot, tmp_path):
    return shutil.copytree(robot, tmp_path / "copy")


MAIN = "import drive; drive.main({})"


def lines_of(ranges, angles) -> str:
    """Input lines: a scan, a start, and two times."""
    facts = {"angle_min": angles[0], "angle_increment": angles[1] - angles[0], "range_min": 0.1, "range_max": 30.0}
    first = {"time": 1.0, "scan": {"ranges": list(ranges), **facts}}
    return "\n".join(map(json.dumps, [first, {"time": 1.0, "start": True}, {"time": 1.1}, {"time": 9.0}]))


def test_the_program_drives_with_numpy_and_nothing_else(alone, robot, loaded):
    ast.parse((robot / "drive.py").read_text(), feature_version=(3, 8))
    assert "No module named 'torch'" in alone("import torch").stderr
    policy = loaded("zoo:drive-loop-ppo")
    scene = config_of(policy).scene
    scene.observation_space.seed(3)
    seen = scene.observation_space.sample()
    done = alone(MAIN.format("['--speed', '0.1', '--safe', 'off']"), lines_of(seen.tolist(), scene.laser.angles))
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
from numpy import where as choose

from tb2rl.envs.filters import Filter

class StopNear(Filter):
    def __init__(self, distance):
        self.distance = distance

    def __call__(self, commands, robot_state):
        return choose(robot_state.ranges.min(axis=1)[:, None] < self.distance, 0.0, commands)
"""


def test_each_built_in_filter_is_in_the_program(untrained, alone, tmp_path):
    export_folder(untrained(PPO, "drive", {**RAW, "task.beams": 60, "task.filters": list(FILTERS)}), tmp_path / "all")
    code = "import drive; print([type(each).__name__ for each in drive.ExportedPolicy('.').filters])"
    assert alone(code, folder=tmp_path / "all").stdout == "['PassiveSafety', 'Recovery', 'Safety', 'SpeedLimits']\n"


def test_a_filter_of_ones_own_is_packed_into_the_program(alone, copy, tmp_path):
    (tmp_path / "my_filter.py").write_text(MY_FILTER)
    (copy / "drive.py").write_text(build_program([tmp_path / "my_filter.py"]))
    about = json.loads((copy / "policy.json").read_text())
    about["filters"] = [{"class": "StopNear", "arguments": {"distance": 0.5}}]
    (copy / "policy.json").write_text(json.dumps(about))
    for distance, stands in ((0.3, True), (3.0, False)):
        lines = lines_of(np.full(181, distance), np.linspace(-1.6, 1.6, 181))
        answers = [json.loads(line) for line in alone(MAIN.format("[]"), lines, copy).stdout.splitlines()]
        assert answers[1]["why"] == "driving"
        assert ((answers[1]["v"], answers[1]["w"]) == (0.0, 0.0)) == stands
    (tmp_path / "my_filter.py").write_text(MY_FILTER + "\nclass Driver: pass\n")
    with pytest.raises(InputError, match="rename Driver"):
        build_program([tmp_path / "my_filter.py"])


@pytest.mark.parametrize(
    ("arguments", "damaged", "words"),
    [
        (["--speed=-5"], "", ["speed", "above 0", "-5"]),
        (["--turn-rate=nan"], "", ["turn_rate", "above 0", "nan"]),
        (["--scanner", "0", "nan", "0"], "", ["mounting", "nan"]),
        ([], "weights.npz", ["damaged"]),
        ([], "policy.json", ["damaged"]),
    ],
)
def test_a_wrong_argument_or_a_damaged_folder_is_refused_in_one_line(arguments, damaged, words, copy, capsys):
    if damaged:
        (copy / damaged).write_bytes((copy / damaged).read_bytes()[:200])
    with pytest.raises(SystemExit) as stopped:
        drive([str(copy), *arguments])
    output = capsys.readouterr()
    assert (stopped.value.code, output.err.count("\n")) == (2, 1)
    assert [word for word in words if word not in output.err] == []
    assert all(json.loads(line)["v"] == 0.0 for line in output.out.splitlines())
