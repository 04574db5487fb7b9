"""What an agent observes of a robot state: the classes of its numbers, the numbers themselves, or images."""

import math

import numpy as np
import pytest
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import SensorBox, make_encoding, ranges_to_bins
from tb2rl.robots import Laser
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges

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


def test_ranges_fall_into_classes_whose_lower_border_belongs_to_them():
    ranges = np.array([[0.0, 0.999, 1.0, 1.001, 1.999], [2.0, 29.0, INF, NAN, -INF]])
    assert ranges_to_bins(ranges, [1.0, 2.0]).tolist() == [[0, 0, 1, 1, 1], [2, 2, 2, 0, 0]]


def test_other_sensors_come_after_the_beams_in_their_own_classes(make_robot_state):
    observe = make_encoding("discrete", [beams(2), Odometry()])
    assert observe.space.nvec.tolist() == [2, 2, 3]
    seen = [observe(make_robot_state(ranges=[0.5, 2.0], odometry=(x, 0, 0)))[0].tolist() for x in (-1, 0, 0.7)]
    assert seen == [[0, 1, 0], [0, 1, 1], [0, 1, 2]]


def test_raw_numbers_are_clipped_to_their_limits_in_float32_and_nothing_hit_is_the_longest_range(make_robot_state):
    observe = make_encoding("raw", [beams(3), Odometry()])
    odometry = [(x, 0, 0) for x in (0.25, 9.0, -9.0)]
    seen = observe(make_robot_state(ranges=[[0.5, 1.25, INF], [29.0, 31.0, 0.1], [1.0, 1.0, 1.0]], odometry=odometry))
    assert seen.dtype == np.float32
    assert seen == pytest.approx(np.array([[0.5, 1.25, 30.0, 0.25], [29, 30.0, 0.1, 1.0], [1.0, 1.0, 1.0, -1.0]]))


def test_raw_numbers_say_their_units_and_what_they_are():
    space = make_encoding("raw", [beams(2), Odometry(), Twist()]).space
    assert isinstance(space, SensorBox)
    assert space.units == ("m", "m", "m", "m/s", "m/s")
    assert space.names == ("laser", "laser", "x", "twist", "twist")
    assert space.low == pytest.approx([0.1, 0.1, -1, -4, -4])
    assert space.high.tolist() == [30, 30, 1, 4, 4]
    assert space == spaces.Box(space.low, space.high)


def test_an_image_beside_numbers_makes_a_mapping_of_both(make_robot_state):
    observe = make_encoding("raw", [beams(2), Image(), Odometry()])
    assert set(observe.space) == {"image", "numbers"}
    assert observe.space["numbers"].names == ("laser", "laser", "x")
    seen = observe(make_robot_state(ranges=[[0.5, INF]] * 2, odometry=[(0, 0, 0), (0.5, 0, 0)]))
    assert seen["numbers"].tolist() == [[0.5, 30, 0], [0.5, 30, 0.5]]
    assert (seen["image"] == Image.picture).all()


@pytest.mark.parametrize("sensors", [[Image()], [beams(3), Image()]], ids=["alone", "beside numbers"])
def test_an_observed_image_may_be_overwritten_and_the_sensors_own_stays(sensors, make_robot_state):
    before = Image.picture.copy()
    seen = make_encoding("raw", sensors)(make_robot_state([1.0, 2.0]))
    (seen["image"] if isinstance(seen, dict) else seen)[0] = 0
    np.testing.assert_array_equal(Image.picture, before)


class Strange(Sensor):
    name, low, high, shape = "strange", 0, 1, (2, 2)

    def read(self, robot_state):
        raise NotImplementedError


@pytest.mark.parametrize(
    ("mode", "sensors", "words"),
    [
        ("discrete", [beams(2), Twist()], "sensor twist: bins .*observation=raw needs none"),
        ("discrete", [beams(2), Image()], "sensor image is an image, which has no bins; use observation=raw"),
        ("discrete", [beams(2, (1.0, 1.0))], r"sensor laser: bins .* must strictly increase, got \(1.0, 1.0\)"),
        ("raw", [Strange()], r"needs sensors; the shape of each must be \(n,\)"),
        ("raw", [], "needs sensors"),
    ],
)
def test_sensors_that_cannot_be_observed_are_refused_with_one_line(mode, sensors, words):
    with pytest.raises(InputError, match=words) as error:
        make_encoding(mode, sensors)
    assert "\n" not in str(error.value)
