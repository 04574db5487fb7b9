"""A folder for a robot: its program senses and acts as the policy does in simulation, with numpy and nothing else."""

from __future__ import annotations

import ast
import json
import math
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
from tb2rl.core.files import top_folder
from tb2rl.deploy import TrainedPolicy
from tb2rl.deploy.folder import program
from tb2rl.deploy.portable.main import main as drive
from tb2rl.deploy.portable.policy import ExportedPolicy
from tb2rl.deploy.portable.policy_contract import Sensed
from tb2rl.envs.batch import ControlLoop
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import config_of

NAMES = sorted(entry.parent.name for entry in top_folder("zoo").glob("*/config.yaml"))
QUICK = ("anywhere-qlearn", "wall-wall-dqn")
PPO, RAW = "stable_baselines3:PPO", {"task.observation": "raw"}
SENSORS = ["laser", "bumper", "twist", {"last_action": {"count": 3}}, "free_paths", "visited"]
TASKS = {  # what no policy of the zoo observes
    "all that needs no goal": (PPO, "drive", {**RAW, "task.observe": SENSORS}),
    "classes": ("qlearn", "maze", {"task.observe": ["bumper", "twist", "last_action", "free_paths"]}),
    "classes of a goal": ("qlearn", "wall", {"task.observe": ["goal", "goal_direction"], "task.frame_stack": 2}),
    "a goal": (PPO, "navigate", {**RAW, "task.frame_stack": 3}),
    "a plan": (PPO, "navigate", {**RAW, "task.guide": "plan"}),
    "classes of a plan": ("qlearn", "navigate", {"task.named_actions": True, "task.observe": ["waypoint_bearing"]}),
    "some beams": (PPO, "maze", {**RAW, "task.beams": 720, "task.beam_indices": [0, 144, 360, 576]}),
    "another robot": (PPO, "maze", {**RAW, "task.robot": "turtlebot3", "task.observe": SENSORS}),
}


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    """A function that keeps a policy that nobody trained as a run folder."""

    def keep(agent, task, settings) -> Path:
        config = resolve(agent, task, settings={"train.n_envs": 2, "task.world": "wall", **settings})
        run = Run.create(tmp_path_factory.mktemp("untrained") / "run", config)
        run.save(make_algorithm(config, Spaces.vectorised(config)), "final/policy")
        return run.folder

    return keep


def assert_senses_and_acts_the_same(policy, folder: Path, sensed, steps: int) -> None:
    """Two robots drive by chance in the twin; the program is asked beside, of what the simulation says they sense."""
    config = config_of(policy)
    scene = config.scene.changed(variation="none")  # nothing comes late
    exported = [ExportedPolicy(folder) for _ in range(2)]
    guided = exported[0].needs.goal == "plan"
    scene.action_space.seed(0)
    with closing(ControlLoop(scene, 2)) as batch:
        batch.seed(0)
        observations, ended = batch.reset(), np.arange(2)
        for _ in range(steps):
            for robot in ended:
                exported[robot].begin()
            waypoints = batch.robot_state.lookahead_point(exported[0].needs.lookahead) if guided else None
            for robot, one in enumerate(exported):
                now = sensed(batch.robot_state, robot, waypoints)
                seen = observations[robot]
                expected, _ = policy.predict(seen, deterministic=True)
                command = one.act(now)
                np.testing.assert_array_equal(one.observed[0], seen)
                assert one.observed.dtype == seen.dtype
                np.testing.assert_allclose(command, scene.actions.commands(expected[None])[0], rtol=0.0, atol=1e-5)
            step = batch.step(np.stack([scene.action_space.sample() for _ in range(2)]))
            observations = step.observations
            ended = step.finished.indices if step.finished else ()


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in NAMES])
def test_what_a_policy_of_the_zoo_senses_and_does_is_the_same_on_a_robot(name, loaded, sensed, tmp_path):
    export_folder(f"zoo:{name}", tmp_path)
    assert_senses_and_acts_the_same(loaded(f"zoo:{name}"), tmp_path, sensed, 200)


@pytest.mark.parametrize("kind", TASKS)
def test_every_sensor_that_a_robot_has_is_read_as_in_the_simulation(kind, untrained, loaded, sensed, tmp_path):
    folder = untrained(*TASKS[kind])
    export_folder(folder, tmp_path)
    assert_senses_and_acts_the_same(loaded(folder), tmp_path, sensed, 60)


def test_a_policy_that_drew_a_map_is_told_a_plan_on_a_robot(untrained, tmp_path):
    folder = untrained(PPO, "navigate", {**RAW, "task.guide": "plan", "task.map": "online", "task.lookahead": 1.2})
    export_folder(folder, tmp_path)
    needs = ExportedPolicy(tmp_path).needs
    assert (needs.goal, needs.lookahead, needs.uses_odometry) == ("plan", 1.2, True)


def test_the_inertial_unit_is_read_as_drivers_of_tb2rl_read_it(untrained, loaded, tmp_path):
    folder = untrained(PPO, "drive", {**RAW, "task.observe": ["laser", "imu"]})
    export_folder(folder, tmp_path)
    exported, trained, rng = ExportedPolicy(tmp_path), TrainedPolicy(loaded(folder)), np.random.default_rng(0)
    exported.begin(), trained.begin()
    for _ in range(20):
        ranges, twist = rng.uniform(0.1, 30.0, len(trained.needs.beams)), tuple(rng.uniform(-0.6, 0.6, 2))
        now = Sensed(ranges=ranges, twist=twist)
        np.testing.assert_allclose(exported.act(now), trained.act(now), rtol=0.0, atol=1e-5)
    assert np.abs(exported.observed[0, -1]) > 0.01, "it accelerates"


@pytest.fixture
def alone(robot, tmp_path):
    """A function that runs code where there is the standard library, numpy and a robot's folder, and nothing else."""
    for name in ("numpy", "numpy.libs"):
        if (installed := Path(sysconfig.get_path("purelib"), name)).exists():
            (tmp_path / name).symlink_to(installed)

    def run(code: str, lines: str = "", folder: Path = robot) -> subprocess.CompletedProcess[str]:
        start = f"import sys; sys.path += {[str(tmp_path), str(folder)]}"
        command = [sys.executable, "-I", "-S", "-c", f"{start}\n{code}"]
        return subprocess.run(command, cwd=folder, input=lines, capture_output=True, text=True, check=False)

    return run


FOREIGN = """
import importlib.util
names = ["torch", "stable_baselines3", "gymnasium", "numba", "scipy", "onnx", "onnxruntime", "tb2rl", "yaml", "drive"]
print([name for name in names if importlib.util.find_spec(name)])
"""
MAIN = "import drive; drive.main({})"


def lines_of(ranges, angles) -> str:
    """A robot that has a scan, is started, and is asked again."""
    facts = {"angle_min": angles[0], "angle_increment": angles[1] - angles[0], "range_min": 0.1, "range_max": 30.0}
    first = {"time": 1.0, "scan": {"ranges": list(ranges), **facts}}
    return "\n".join(map(json.dumps, [first, {"time": 1.0, "start": True}, {"time": 1.1}, {"time": 9.0}]))


def test_its_program_drives_where_there_is_numpy_and_nothing_else(alone, loaded):
    assert alone(FOREIGN).stdout == "['drive']\n"
    policy = loaded("zoo:drive-loop-ppo")
    scene = config_of(policy).scene
    scene.observation_space.seed(3)
    seen = scene.observation_space.sample()
    done = alone(MAIN.format("[]"), lines_of(seen.tolist(), scene.laser.angles))
    assert (done.returncode, done.stderr) == (0, "")
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["why"] for line in said[:3]] == ["not started", "driving", "driving"]
    assert "old" in said[3]["why"]
    v, w = scene.actions.commands(policy.predict(seen, deterministic=True)[0][None])[0]
    for line, expected in zip(said, [(0, 0), (v, w), (v, w), (0, 0), (0, 0)], strict=True):
        assert (line["v"], line["w"]) == pytest.approx(expected, abs=1e-5)
    slower = alone(MAIN.format("['--speed', '0.1']"), lines_of(seen.tolist(), scene.laser.angles)).stdout
    assert json.loads(slower.splitlines()[1])["v"] == pytest.approx(min(v, 0.1), abs=1e-5)


def test_its_program_is_imported_as_its_readme_says(alone, robot):
    (code,) = re.findall(r"^```python\n(.*?)^```$", (robot / "README.md").read_text(), flags=re.DOTALL | re.MULTILINE)
    values = "ranges, angle_min, angle_increment, range_min, range_max = [2.0] * 37, -1.58, 3.16 / 36, 0.1, 30.0"
    done = alone(f"{values}\n{code}\nprint(command.why)")
    assert (done.stdout, done.stderr) == ("driving\n", "")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "JSONDecodeError"),
        ("3", "object"),
        ('{"goal": 3}', "goal"),
        ('{"time": NaN}', "finite"),
        ('{"odometry": {"x": "far"}}', "far"),
        ('{"scan": {"ranges": []}}', "range_min"),
        ('{"scan": {"ranges": [[1, 2], [3, 4]]}}', "not a number"),
        ('{"odometry": {"x": 1e200}}', "finite number up to 1e+09"),
        ('{"time": 1' + 400 * "0" + "}", "finite"),
        ("[" * 100_000, "RecursionError"),
        ('{"start": "no"}', "true or false"),
    ],
)
def test_a_line_that_is_wrong_stops_the_robot_and_the_program(alone, line, words):
    done = alone(MAIN.format("[]"), line)
    said = json.loads(done.stdout)
    assert (done.returncode, said["v"], said["w"]) == (2, 0.0, 0.0)
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed=-5"], ["--speed", "above 0", "-5"]),
        (["--speed=nan"], ["--speed", "finite"]),
        (["--speed=inf"], ["--speed", "finite"]),
        (["--speed=0"], ["--speed", "above 0"]),
        (["--turn-rate=-9"], ["--turn-rate", "above 0", "-9"]),
        (["--scanner", "0", "nan", "0"], ["mounting", "nan"]),
        (["--spead=1"], ["--spead"]),
    ],
)
def test_a_number_that_is_no_limit_and_no_mounting_is_refused_in_a_line(arguments, words, robot, capsys):
    with pytest.raises(SystemExit) as stopped:
        drive([str(robot), *arguments])
    message = capsys.readouterr().err
    assert (stopped.value.code, message.count("\n")) == (2, 1)
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("period", 0.0),
        ("period", math.nan),
        ("max_range", math.inf),
        ("goal_radius", -1.0),
        ("beams", []),
        ("goal", "x"),
    ],
)
def test_a_policy_with_needs_that_make_no_sense_is_refused(name, value, robot, tmp_path):
    folder = shutil.copytree(robot, tmp_path / "copy")
    about = json.loads((folder / "policy.json").read_text())
    about["needs"][name] = value
    (folder / "policy.json").write_text(json.dumps(about))
    with pytest.raises(ValueError, match=f"is damaged: .*{name}"):
        ExportedPolicy(folder)


@pytest.mark.parametrize("damage", ["weights.npz", "policy.json"])
def test_a_damaged_folder_is_refused_in_a_line(alone, damage, robot, tmp_path):
    folder = shutil.copytree(robot, tmp_path / "copy")
    (folder / damage).write_bytes((folder / damage).read_bytes()[:200])
    done = alone(MAIN.format(f"[{str(folder)!r}]"), folder=folder)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "damaged" in done.stderr


def test_its_program_is_python_3_8_and_has_one_import_of_everything():
    tree = ast.parse(program(), feature_version=(3, 8))
    imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert ast.unparse(tree.body[3].test) == "__name__ == '__main__'", "Ctrl-C ends it before it imports numpy"
    assert imports == [*tree.body[1:3], *tree.body[4 : 2 + len(imports)]], "all at its top"
    assert len({*map(ast.unparse, imports)}) == len(imports)
    assert not any(getattr(node, "level", 0) for node in imports)
