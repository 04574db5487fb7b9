"""The scanners of the page for robots work with the policies of the zoo as its table says."""

import math

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.deploy import Scan
from tb2rl.deploy.description import find_needs
from tb2rl.deploy.portable.scan_reader import ScanReader
from tb2rl.zoo.entry import entries


def scanner(degrees, readings, range_min, range_max):
    """A scan of 2 m everywhere."""
    field = math.radians(degrees)
    return Scan(np.full(readings, 2.0), -field / 2, field / (readings - 1), range_min, range_max)


SCANNERS = {
    "RPLIDAR": scanner(359, 360, 0.15, 12.0),
    "Hokuyo URG-04LX": scanner(240, 683, 0.02, 5.6),
    "Hokuyo UTM-30LX": scanner(270, 1081, 0.1, 30.0),
    "depth camera": scanner(57, 640, 0.45, 10.0),
}


def problems(scan):
    """What prevents the policies of the zoo from reading a scan."""
    found = {}
    for entry in entries():
        try:
            needs = find_needs(entry.config.scene)
        except InputError:  # a policy with a camera
            continue
        found[entry.name] = ScanReader(needs).read(scan).problem
    assert len(found) > 20
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", SCANNERS)
def test_every_policy_of_the_zoo_works_with_a_wide_scanner_and_none_with_a_depth_camera(name):
    found = problems(SCANNERS[name])
    if name == "depth camera":
        assert all("use a scanner with a wider field of view" in problem for problem in found.values())
    else:
        assert {policy: problem for policy, problem in found.items() if problem} == {}
