"""What `observe` lists is what is observed, wherever the setting comes from, or it is refused in one line."""

import sys

import gymnasium as gym
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.runs.config import config_from, parse_settings, resolve
from tb2rl.simulation import find_simulator

MINE = """
from tb2rl.sensors import Sensor
from tb2rl.sensors.camera import Camera

class Compass(Sensor):
    name, unit, low, high = "compass", "rad", -4.0, 4.0

    def __init__(self, bins: tuple[float, ...] = (0.0,), offset: float = 0.0) -> None:
        self.bins, self.offset = bins, offset

    def read(self, robot_state):
        return robot_state.odometry[:, 2:] + self.offset

class Needy(Compass):
    def __init__(self, north: float) -> None:
        super().__init__()

class Broken(Compass):
    def __init__(self) -> None:
        raise KeyError("north")

class Black(Camera):
    def read(self, robot_state):
        return 0 * super().read(robot_state)
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The module `my_sensors` with sensors of a user's own."""
    (tmp_path / "my_sensors.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("my_sensors", None)


def sensors(observe, task="maze", observation="raw", **settings):
    """The sensors of a task that observes a list."""
    return make_scene(make_task(task, {"observe": observe, **settings}), observation).sensors


def names(observe, task="maze", **settings):
    return [sensor.name for sensor in sensors(observe, task, **settings)]


def test_sensors_are_observed_in_the_order_of_the_list_or_else_of_the_task():
    assert names(None, "wall") == ["laser", "goal distance", "goal bearing"]
    assert names(["bumper", "twist", "laser"]) == ["bumper", "forward speed", "turn rate", "laser"]
    assert names(["imu", "last_action"]) == ["yaw rate", "forward acceleration", "last action"]


def test_a_sensor_that_the_task_has_or_offers_keeps_the_tasks_settings():
    (laser,) = sensors(["laser"], range_bins=(0.5, 0.6))
    assert laser.bins == (0.5, 0.6)
    observe = ["waypoint", {"waypoint_bearing": {"lookahead": 1.1}}]
    waypoint, bearing = sensors(observe, "navigate", world="wall", guide="goal", lookahead=0.8)
    assert (waypoint.lookahead, bearing.lookahead) == (0.8, 1.1)


def test_it_survives_the_command_line_and_a_run_folder():
    said = "task.observe=[twist, {camera: {width: 36, height: 40}}]"
    config = resolve("stable_baselines3:PPO", "maze", settings=parse_settings([said]))
    assert config_from(config.to_dict()).scene.observation_space["camera"].shape == (1, 40, 36)


def test_a_name_takes_the_arguments_of_its_class():
    (camera,) = sensors([{"camera": {"colour": True, "depth": True, "width": 48, "height": 40}}])
    assert camera.shape == (4, 40, 48)
    (laser,) = sensors([{"laser": {"bins": [1.0, 2.0]}}])
    assert laser.bins == (1.0, 2.0)
    assert names([{"twist": {}}, {"camera": None}]) == ["forward speed", "turn rate", "camera"]


def test_a_sensor_of_ones_own_is_named_by_its_module(mine):
    compass, black = sensors([{"my_sensors:Compass": {"offset": 1.0}}, {"my_sensors:Black": {"width": 36}}])
    assert (compass.offset, black.shape) == (1.0, (1, 64, 36))
    env = make_env("maze", "raw", simulation="kinematic", observe=["my_sensors:Compass", "my_sensors:Black"])
    seen, info = env.reset(seed=0)
    assert seen["numbers"] == pytest.approx(info["pose"][2:])
    assert not seen["camera"].any()


@pytest.mark.parametrize(
    ("observe", "words"),
    [
        (["lazer"], "did you mean 'laser'?"),
        ("laser", "must be a list of names, .* such as .* got 'laser'"),
        (["camera", {"camera": {"width": 36}}], "sensor 'camera' is listed twice"),
        ([{"camera": {"widht": 36}}], "did you mean 'width'? known: colour, depth, height, width"),
        ([{"camera": {"width": 0}}], r"task.observe.camera.width: .* greater than or equal to 4, got 0"),
        ([{"imu": {"bins": [1]}}], "imu is several sensors; .*motion:YawRate and .*motion:ForwardAcceleration"),
        (["goal"], "episodes of this task have no goal"),
        (["os:system"], "'os:system' is not a class derived from tb2rl.sensors.sensor.Sensor"),
        (["my_sensors:Needy"], "task.observe.my_sensors:Needy.north: Field required"),
        (["my_sensors:Broken"], "task.observe.my_sensors:Broken: KeyError: 'north'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(observe, words, mine):
    with pytest.raises(InputError, match=words.replace("?", r"\?")) as refused:
        sensors(observe)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("vector", [False, True])
def test_colours_are_refused_of_the_kinematic_simulator_before_anything_drives(vector):
    make = gym.make_vec if vector else gym.make
    with pytest.raises(InputError, match="the cameras of simulation 'kinematic' see depth but no colours"):
        make("tb2rl:TurtleBot2MazeRaw-v0", simulation="kinematic", observe=[{"camera": {"colour": True}}])


def test_a_camera_above_the_walls_is_refused_in_the_kinematic_simulator(tmp_path, monkeypatch):
    text = "from dataclasses import replace\nfrom tb2rl.robots.turtlebot2 import ROBOT\n"
    text += "ROBOT = replace(ROBOT, camera=replace(ROBOT.camera, position=(0.0, 0.0, 0.6)))\n"
    (tmp_path / "tall.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    scene = make_scene(make_task("maze", {"robot": "tall:ROBOT", "observe": ["camera"]}), "raw")
    scene.check(find_simulator("bullet"))
    with pytest.raises(InputError, match=r"the camera is 0\.6 m high; it must be below the walls .* 0\.5 m high"):
        scene.check(find_simulator("kinematic"))
