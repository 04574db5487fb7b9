"""Each physics repeats itself exactly: after a reset, and from a restored state."""

import copy

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT

WALL = {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]}


def random_commands(seed, count=50):
    """Commands that turn either way and go forward more than back, so that they meet a wall."""
    return np.random.default_rng(seed).uniform((-0.3, -3.0), (ROBOT.max_speed, 3.0), (count, 2))


def test_a_reset_to_nearly_the_same_pose_gives_the_same_trajectory(make_track):
    track = make_track(WALL, beams=20, noise=0.01)
    track.place(-0.5)
    expected = track.record(states := track.drive(random_commands(0)))
    assert any(state.bumped[0] for state in states)
    for seed in (*range(4), 146, 152, 290, 299, 492, 601):  # the last ones: old contacts once lived on
        rng = np.random.default_rng(seed)
        track.place(*rng.normal((-0.5, 0.0, 0.0), (0.005, 0.005, 0.05)))
        track.drive(random_commands(seed, count=seed % 7), 0.02)
        track.place(-0.5)
        np.testing.assert_array_equal(track.record(track.drive(random_commands(0))), expected)


@pytest.mark.parametrize("used", ["reset", "restored", "copied"])
def test_a_reset_a_restored_state_and_a_copy_drive_exactly_as_the_original(
    used, make_spec, make_physics, start_at, begin
):
    """A quarter of these drives differed in their last digits, and then in their ends, once a wall was touched."""
    spec, rng, bumps = make_spec("loop", "maze", beams=9), np.random.default_rng(3), 0
    old = make_physics(spec)
    for number in range(12):
        initial_state = start_at(spec, spec.sample_poses(number % 2, rng.random((1, 4)), 0.3), number % 2)
        initial_state.goal[:], initial_state.records["max_speed"] = (3.0, 4.0), 0.5
        commands = rng.uniform((0.2, -0.5), (0.6, 0.5), (30, 1, 2))
        begin(old, initial_state)
        if used == "copied":
            old.step(commands[0], 0.2)
            other = copy.deepcopy(old)
        else:
            other = make_physics(spec)
            begin(other, None if used == "restored" else initial_state)
        if used == "restored":
            old.step(commands[0], 0.2)
            other.restore(old.state())
        for command in commands:
            expected, robot_state = old.step(command, 0.2), other.step(command, 0.2)
            np.testing.assert_equal(robot_state.state(), expected.state())
            bumps += robot_state.bumped[0]
        other.close()
    assert bumps > 20
