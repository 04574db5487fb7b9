"""What an agent observes of a robot state: the classes of its numbers, the numbers themselves, or images."""

import math
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.core.files import read_yaml, top_folder
from tb2rl.core.values import build
from tb2rl.envs.encodings import BEAMS, SensorBox, encode, ranges_to_bins
from tb2rl.envs.scene import make_scene
from tb2rl.robots import Laser
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges
from tb2rl.tasks.registry import find_task

INF, NAN = math.inf, math.nan


class Odometry(Sensor):
    """The robot's x."""

    name, unit = "x", "m"
    low, high, bins = -1.0, 1.0, (0.0, 0.5)

    def read(self, robot_state):
        return robot_state.odometry[:, :1]


class Twist(Sensor):
    """Two numbers at once, without classes."""

    name, unit = "twist", "m/s"
    low, high, shape = -4.0, 4.0, (2,)

    def read(self, robot_state):
        return robot_state.twist


class Image(Sensor):
    """The same image for all, which must not be changed."""

    name, low, high = "image", 0, 255
    picture = np.arange(27, dtype=np.uint8).reshape(3, 3, 3)
    shape = picture.shape

    def read(self, robot_state):
        return np.broadcast_to(self.picture, (len(robot_state.pose), *self.shape))


def beams(count, bins=(1.0,)):
    return LaserRanges(Laser(beams=count), bins)


# ---- classes


def test_ranges_fall_into_classes_whose_lower_border_belongs_to_them():
    ranges = np.array([[0.0, 0.999, 1.0, 1.001, 1.999], [2.0, 29.0, INF, NAN, -INF]])
    assert ranges_to_bins(ranges, [1.0, 2.0]).tolist() == [[0, 0, 1, 1, 1], [2, 2, 2, 0, 0]]


def test_the_tutorial_observes_five_of_720_beams_in_seven_classes():
    settings = read_yaml(top_folder("configs") / "tutorial.yaml")["task"]
    scene = make_scene(build(find_task(settings.pop("name")), settings, "task"), "discrete")
    assert scene.laser.beams == 720
    assert scene.observation_space.nvec.tolist() == [7] * 5


def test_distance_classes_of_several_environments_are_rows(make_robot_state):
    observe = encode("discrete", [beams(3, (1.0, 2.0))])
    seen = observe(make_robot_state(ranges=[[0.5, 1.5, INF], [INF, INF, 0.1]]))
    assert seen.tolist() == [[0, 1, 2], [2, 2, 0]]
    assert np.issubdtype(seen.dtype, np.integer)


def test_other_sensors_come_after_the_beams_in_their_own_classes(make_robot_state):
    observe = encode("discrete", [beams(2), Odometry()])
    assert observe.space.nvec.tolist() == [2, 2, 3]
    seen = [observe(make_robot_state(ranges=[0.5, 2.0], odometry=(x, 0, 0)))[0].tolist() for x in (-1, 0, 0.7)]
    assert seen == [[0, 1, 0], [0, 1, 1], [0, 1, 2]]


# ---- numbers


def test_raw_ranges_are_metres_in_float32_and_nothing_hit_is_the_longest(make_robot_state):
    observe = encode("raw", [beams(3)])
    seen = observe(make_robot_state(ranges=[[0.5, 1.25, INF], [29.0, 31.0, 0.1]]))
    assert seen.dtype == np.float32
    assert seen == pytest.approx(np.array([[0.5, 1.25, 30.0], [29, 30.0, 0.1]]))


def test_other_raw_numbers_come_after_the_beams_clipped_to_their_limits(make_robot_state):
    observe = encode("raw", [beams(2), Odometry()])
    assert (observe.space.low[-1], observe.space.high[-1]) == (-1, 1)
    odometry = [(x, 0, 0) for x in (-0.5, 0.25, 9.0, -9.0)]
    seen = observe(make_robot_state(ranges=[[0.5, 2.0]] * 4, odometry=odometry))
    assert seen.tolist() == [[0.5, 2.0, x] for x in (-0.5, 0.25, 1.0, -1.0)]


def test_raw_numbers_say_their_units_and_what_they_are():
    space = encode("raw", [beams(2), Odometry(), Twist()]).space
    assert isinstance(space, SensorBox)
    assert space.units == ("m", "m", "m", "m/s", "m/s")
    assert space.names == ("laser", "laser", "x", "twist", "twist")
    assert space.low == pytest.approx([0.1, 0.1, -1, -4, -4])
    assert space.high.tolist() == [30, 30, 1, 4, 4]
    assert space == spaces.Box(space.low, space.high)


# ---- images


def test_an_image_alone_is_the_observation(make_robot_state):
    observe = encode("raw", [Image()])
    assert observe.space == spaces.Box(0, 255, (3, 3, 3), np.uint8)
    seen = observe(make_robot_state([1.0, 2.0]))
    assert seen.dtype == np.uint8
    assert (seen == Image.picture).all()
    assert seen.shape == (2, 3, 3, 3)


def test_an_image_beside_numbers_makes_a_mapping_of_both(make_robot_state):
    observe = encode("raw", [beams(2), Image(), Odometry()])
    assert set(observe.space) == {"image", "numbers"}
    assert observe.space["numbers"].names == ("laser", "laser", "x")
    seen = observe(make_robot_state(ranges=[[0.5, INF]] * 2, odometry=[(0, 0, 0), (0.5, 0, 0)]))
    assert seen["numbers"].tolist() == [[0.5, 30, 0], [0.5, 30, 0.5]]
    assert (seen["image"] == Image.picture).all()


@pytest.mark.parametrize("sensors", [[Image()], [beams(3), Image()]], ids=["alone", "beside numbers"])
def test_an_observed_image_may_be_overwritten_and_the_sensors_own_stays(sensors, make_robot_state):
    before = Image.picture.copy()
    seen = encode("raw", sensors)(make_robot_state([1.0, 2.0]))
    (seen["image"] if isinstance(seen, dict) else seen)[0] = 0
    np.testing.assert_array_equal(Image.picture, before)


# ---- what cannot be


class Strange(Sensor):
    name, low, high, shape = "strange", 0, 1, (2, 2)

    def read(self, robot_state):
        raise NotImplementedError


@pytest.mark.parametrize(
    ("mode", "sensors", "words"),
    [
        ("discrete", [beams(2), Twist()], "sensor twist has no bins of classes; set them, or take observation=raw"),
        ("discrete", [beams(2), Image()], "sensor image is an image, which has no classes; take observation=raw"),
        ("discrete", [beams(2, (1.0, 1.0))], r"bins of sensor laser must strictly increase, got \[1.0, 1.0\]"),
        ("raw", [Strange()], r"needs sensors, each with a shape of \(n,\)"),
        ("raw", [], "needs sensors"),
    ],
)
def test_sensors_that_cannot_be_observed_are_refused_with_one_line(mode, sensors, words):
    with pytest.raises(InputError, match=words) as error:
        encode(mode, sensors)
    assert "\n" not in str(error.value)


class Flat(Odometry):
    """Forgets the axis of the numbers."""

    def read(self, robot_state):
        return robot_state.odometry[:, 0]


@pytest.mark.parametrize("mode", BEAMS)
def test_a_sensor_that_reads_another_shape_than_it_says_is_named(mode, make_robot_state):
    with pytest.raises(InputError, match=r"sensor x must read an array of shape .*num_envs.*, 1.* it has shape \(2,\)"):
        encode(mode, [beams(3), Flat()])(make_robot_state([1.0, 2.0]))


def test_raw_ranges_are_written_in_one_pass(make_spec):
    encoding = encode("raw", [LaserRanges(make_spec("loop", beams=36).laser, ())])
    robot_state = SimpleNamespace(ranges=np.full((1000, 36), 2.0))
    encoding(robot_state)  # compiles
    tracemalloc.start()
    observations = encoding(robot_state)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.2 * observations.nbytes
