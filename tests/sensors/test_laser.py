"""The laser as a sensor."""

import numpy as np

from tb2rl.robots import Laser
from tb2rl.sensors.laser import LaserRanges


def test_it_reads_the_ranges_within_the_limits_of_the_laser(make_robot_state):
    sensor = LaserRanges(Laser(beams=12, indices=(0, 5), min_range=0.2, max_range=8.0), (1.0, 2.0))
    assert (sensor.name, sensor.unit, sensor.shape) == ("laser", "m", (2,))
    assert (sensor.low, sensor.high, sensor.bins) == (0.2, 8.0, (1.0, 2.0))
    ranges = np.array([[1.0, np.inf], [0.1, 3.0]])
    np.testing.assert_array_equal(sensor.read(make_robot_state(ranges=ranges)), ranges)
