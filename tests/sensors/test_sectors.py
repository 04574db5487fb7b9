"""The shortest ranges of the laser's sectors."""

import numpy as np
import pytest

from tb2rl.errors import InputError
from tb2rl.robots import Laser
from tb2rl.sensors.sectors import Sectors


def test_each_sector_has_the_shortest_of_its_beams(make_reading):
    sensor = Sectors(Laser(beams=8, min_range=0.2, max_range=8.0), count=3, edges=(0.5,))
    ranges = np.array([[1.0, 3.0, 2.0, 0.4, np.inf, 5.0, 7.0, 6.0], [np.inf] * 8])
    assert (sensor.shape, sensor.low, sensor.high, sensor.edges) == ((3,), 0.2, 8.0, (0.5,))
    assert sensor.read(make_reading(ranges=ranges)).tolist() == [[1.0, 0.4, 5.0], [np.inf] * 3], "2, 3 and 3 beams"


def test_more_sectors_than_beams_are_refused():
    with pytest.raises(InputError, match=r"7 sectors need as many beams, and the laser has 6; set task\.beams"):
        Sectors(Laser(beams=6))
