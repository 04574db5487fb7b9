"""The bumper as a sensor."""

import numpy as np
import pytest

from tb2rl.sensors.motion import Bumper
from tb2rl.worlds import World

ONE_WALL = World.from_shapes("one wall", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def test_it_fires_in_the_step_in_which_the_robot_meets_a_wall(drive):
    robot_states = drive(ONE_WALL, (0, 0, 0), [(0.5, 0.0)] * 10)
    touched = np.concatenate([Bumper().read(robot_state) for robot_state in robot_states])
    gaps = np.array([1.0 - 0.178 - robot_state.pose[0, 0] for robot_state in robot_states])  # to the wall at 1 m
    first = int(touched[:, 0].argmax())
    assert touched[first:, 0].all()
    assert gaps[first - 1] > 0.005
    assert gaps[first] == pytest.approx(0.0, abs=0.005)
