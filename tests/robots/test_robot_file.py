"""Robot files: a robot and a variation of one's own for the settings of tasks."""

import json

import pytest

import tb2rl
from tb2rl.core import InputError
from tb2rl.robots.robot import find_robot
from tb2rl.runs import resolve

TEXT = """
robot: {base: turtlebot2, max_speed: 0.5, laser: {beams: 360, field_of_view: 6.283185307179586}}
variation: {bias: [0.01, 0.02], wheel_radius: 0.98}
latency: [0.11, 0.19]
observation_latency: 0.1
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "my_robot.yaml"
    path.write_text(TEXT)
    return path


def test_a_robot_file_changes_a_built_in_robot(file):
    robot, nominal = find_robot(str(file)), find_robot("turtlebot2")
    assert (robot.max_speed, robot.laser.beams, robot.radius) == (0.5, 360, nominal.radius)


def test_a_config_keeps_the_values_of_the_file_with_latencies_in_control_steps(file):
    settings = {"task.robot": str(file), "task.variation": str(file), "task.control_period": 0.1}
    config = resolve("random", "maze", settings=settings)
    file.unlink()
    tree = json.loads(json.dumps(config.to_dict()))
    assert str(file) not in json.dumps(tree)
    assert tb2rl.runs.config.config_from(tree) == config
    variation = config.task.resolved_variation
    assert (variation.latency, variation.observation_latency) == ((1, 2), (1, 1))
    assert (variation.bias, variation.wheel_radius) == ((0.01, 0.02), (0.98, 0.98))
    assert config.scene.robot.max_speed == 0.5


def test_an_environment_takes_the_file(file):
    env = tb2rl.make_env(
        "maze", "raw", simulation="kinematic", robot=str(file), variation=str(file), control_period=0.2
    )
    env.reset(seed=0)
    records = env.robot_state.initial_state.records
    assert 0.01 <= records["bias"][0] <= 0.02
    assert records["command_latency"][0] in (0, 1)
    assert records["max_speed"][0] == 0.5


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max_speed: 0.5", "max_sped: 0.5", "max_sped.*did you mean 'max_speed'"),
        ("max_speed: 0.5", "max_speed: -1.0", "max_speed.*greater than 0"),
        ("bias:", "biass:", "biass.*did you mean 'bias'"),
        ("bias: [0.01, 0.02]", "bias: [0.9, 1.0]", "variation.bias"),
        ("latency: [0.11, 0.19]", "latency: [3.0, 4.0]", "latency"),
        ("beams: 360", "beams: 0", "beams"),
        ("robot:", "[", "as YAML"),
        ("turtlebot2", "turtlebot9", "unknown robot 'turtlebot9'"),
    ],
)
def test_a_wrong_file_is_one_line(file, old, new, message):
    file.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as stopped:
        resolve("random", "maze", settings={"task.robot": str(file), "task.variation": str(file)})
    assert "\n" not in str(stopped.value)


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"none\.yaml"):
        find_robot("none.yaml")
