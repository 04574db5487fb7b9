"""Where robots have been: seconds around them, of the last minute and of this episode alone."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.pose_history import PoseHistory
from tb2rl.envs.scene import make_scene
from tb2rl.envs.seeded_loop import SeededLoop
from tb2rl.sensors.visited import Visited
from tb2rl.tasks.drive import Drive

PERIOD = 0.2  # [s]
STEPS = 5  # a second
AHEAD, LEFT, BEHIND, HERE = 0, 3, 6, 12  # which of the 25 places
FAR = 13  # from here on, twice as far


def visited(make_reading, poses):
    """What the last of some robots' poses, each a second after the other, reads; shape (num_envs, 25)."""
    pose_history, sensor = PoseHistory(PERIOD), Visited()
    for number, pose in enumerate(np.asarray(poses, dtype=float)):
        robot_state = make_reading(pose=pose)
        (pose_history.go_on if number else pose_history.begin)(robot_state)
        for _ in range(STEPS - 1):
            pose_history.go_on(robot_state)
    return sensor.read(replace(robot_state, pose_history=pose_history))


def test_the_way_back_is_known_and_the_way_on_is_not(make_reading):
    on, turned = np.zeros((2, 11, 3)), np.arange(11) * 0.25
    on[0, :, 0] = on[1, :, 0] = turned  # both drive along x
    on[1, -1, 2] = -np.pi / 2  # and one turns right in the end: what is behind is on its right now
    seen = visited(make_reading, on.transpose(1, 0, 2))
    assert seen[0, BEHIND] == 3.0, "it was within half a metre of that place for three seconds"
    assert seen[0, [AHEAD, LEFT]].tolist() == [0.0, 0.0]
    assert seen[0, HERE] == 2.0
    assert seen[0, FAR + BEHIND] == 3.0
    assert seen[0, [FAR + AHEAD, FAR + LEFT]].tolist() == [0.0, 0.0]
    assert seen[1, 12 - LEFT] == 3.0
    assert seen[1, BEHIND] == 0.0


def test_a_minute_is_remembered_and_no_more(make_reading):
    stood = np.zeros((50, 1, 3))
    assert visited(make_reading, stood)[0, HERE] == 50.0
    assert visited(make_reading, np.concatenate([stood, stood]))[0, HERE] == 64.0
    far = np.full((64, 1, 3), 9.0)
    assert visited(make_reading, np.concatenate([stood, far, stood[:1]]))[0, HERE] == 1.0


@pytest.mark.parametrize("period", [0.1, 0.2, 0.4, 2.0])
def test_it_is_in_seconds_however_long_a_control_step_is(period, make_reading):
    pose_history, robot_state = PoseHistory(period), make_reading(pose=[(0.0, 0.0, 0.0)])
    pose_history.begin(robot_state)
    for duration, stayed in ((20.0, 20.0), (80.0, 64.0)):
        for _ in range(round(duration / period)):
            pose_history.go_on(robot_state)
        assert Visited().read(replace(robot_state, pose_history=pose_history))[0, HERE] == pytest.approx(
            stayed, abs=2.0
        )


def test_before_anything_is_remembered_it_has_been_nowhere(make_reading):
    assert not Visited().read(make_reading()).any()


def test_each_robot_forgets_where_its_own_episode_begins_and_a_batch_goes_on_to_the_bit():
    scene = make_scene(Drive(observe=("visited",), episode_steps=23), "raw")
    one, other = SeededLoop.open(scene, "kinematic", 3), SeededLoop.open(scene, "kinematic", 3)
    one.seed(3), other.seed(4)
    first, _ = one.reset_all(), other.reset_all()
    actions = np.random.default_rng(0).uniform(-1, 1, (60, 3, 2))
    for chosen in actions[:30]:
        step = one.step_and_reset(chosen)
        if step.finished is not None:
            ended = step.finished.indices
            np.testing.assert_array_equal(step.observations[ended], first[ended])
    other.restore(one.state())
    for chosen in actions[30:]:
        np.testing.assert_array_equal(
            one.step_and_reset(chosen).observations, other.step_and_reset(chosen).observations
        )
    assert step.observations.max() > 1.0
