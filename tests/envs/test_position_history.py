"""The pose history: seconds near places, of the last minute and of this episode alone."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.episode_state import PositionHistory
from tb2rl.sensors.motion import Visited

PERIOD = 0.2  # [s]
STEPS = 5  # a second
AHEAD, LEFT, BEHIND, HERE = 0, 3, 6, 12  # which of the 25 places
FAR = 13  # from here on, twice as far


def visited(make_robot_state, poses):
    """What the sensor reads at the last of some poses (seconds, num_envs, 3); shape (num_envs, 25)."""
    position_history = PositionHistory(PERIOD)
    for number, pose in enumerate(np.asarray(poses, dtype=float)):
        robot_state = make_robot_state(pose=pose)
        for step in range(STEPS):
            if not number and not step:
                position_history.reset(robot_state)
            else:
                position_history.update(robot_state, robot_state.command)
    return Visited().read(replace(robot_state, position_history=position_history))


def test_places_on_the_way_back_were_visited_and_places_ahead_were_not(make_robot_state):
    poses, x = np.zeros((2, 11, 3)), np.arange(11) * 0.25
    poses[0, :, 0] = poses[1, :, 0] = x  # both drive along x
    poses[1, -1, 2] = -np.pi / 2  # and one turns right in the end: what is behind is on its right now
    seen = visited(make_robot_state, poses.transpose(1, 0, 2))
    assert seen[0, BEHIND] == 3.0, "it was within half a metre of that place for three seconds"
    assert seen[0, [AHEAD, LEFT]].tolist() == [0.0, 0.0]
    assert seen[0, HERE] == 2.0
    assert seen[0, FAR + BEHIND] == 3.0
    assert seen[0, [FAR + AHEAD, FAR + LEFT]].tolist() == [0.0, 0.0]
    assert seen[1, 12 - LEFT] == 3.0
    assert seen[1, BEHIND] == 0.0


def test_a_minute_is_remembered_and_no_more(make_robot_state):
    here, far = np.zeros((50, 1, 3)), np.full((64, 1, 3), 9.0)
    assert visited(make_robot_state, np.concatenate([here, here]))[0, HERE] == 64.0
    assert visited(make_robot_state, np.concatenate([here, far, here[:1]]))[0, HERE] == 1.0


@pytest.mark.parametrize("period", [0.1, 0.4, 2.0])
def test_it_is_in_seconds_however_long_a_control_step_is(period, make_robot_state):
    position_history, robot_state = PositionHistory(period), make_robot_state(pose=[(0.0, 0.0, 0.0)])
    position_history.reset(robot_state)
    for _ in range(round(20.0 / period)):
        position_history.update(robot_state, robot_state.command)
    seconds = Visited().read(replace(robot_state, position_history=position_history))[0, HERE]
    assert seconds == pytest.approx(20.0, abs=2.0)
