"""PyBullet does the same again to the bit: after a reset, and from a restored state."""

import copy

import numpy as np
import pytest

from tb2rl.robots.robot import MAX_SPEED
from tb2rl.robots.turtlebot2 import LASER_NOISE, ROBOT
from tb2rl.simulation import InitialState

WALL = {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]}


def random_commands(seed, count=50):
    """Commands that turn either way and go forward more than back, so that they meet a wall."""
    return np.random.default_rng(seed).uniform((-0.3, -3.0), (ROBOT.max_speed, 3.0), (count, 2))


def test_a_reset_gives_the_same_trajectory_to_the_bit_whatever_happened_before(make_track):
    trajectories = []
    for past in (0, 1):
        track = make_track(WALL, beams=20, noise=LASER_NOISE)
        for seed in range(past, 3):  # the second simulation is younger by a drive
            track.place(-0.5, 0.5, seed=seed)
            track.drive(random_commands(seed))
        first = track.place(-0.5, seed=7)
        trajectories.append(track.record([first, *track.drive(random_commands(7))]))
    assert trajectories[0][:, -1].any()  # it met the wall
    assert (trajectories[0] == trajectories[1]).all()


def test_a_reset_to_where_it_stands_gives_the_same_trajectory_to_the_bit(make_track):
    track = make_track(WALL, beams=20)
    track.place(-0.5)
    expected = track.record(track.drive(random_commands(0)))
    for seed in (*range(20), 146, 152, 290, 299, 492, 601):  # the last ones: old contacts once lived on
        rng = np.random.default_rng(seed)
        track.place(*rng.normal((-0.5, 0.0, 0.0), (0.005, 0.005, 0.05)))
        track.drive(random_commands(seed, count=seed % 7), 0.02)
        track.place(-0.5)
        assert (track.record(track.drive(random_commands(0))) == expected).all()


@pytest.mark.parametrize("noise", [0.0, LASER_NOISE])
@pytest.mark.parametrize("steps", [0, 1, 5, 50])
def test_it_continues_from_a_restored_state_to_the_bit(steps, noise, make_track):
    track = make_track(WALL, beams=20, noise=noise)
    track.place(-0.5)
    track.drive(random_commands(0)[:steps])
    state = track.simulation.state()
    expected = track.record(track.drive(random_commands(1)))
    track.drive(random_commands(2))
    restored = track.simulation.restore(state)
    assert restored.command.tolist() == ([random_commands(0)[steps - 1].tolist()] if steps else [[0.0, 0.0]])
    assert (track.record(track.drive(random_commands(1))) == expected).all()


def test_a_restored_state_brings_its_world_its_goal_and_its_robot_back(make_setup, make_bullet):
    spec = make_setup("loop", "maze", beams=9)
    simulation, rng = make_bullet(spec), np.random.default_rng(0)
    start = InitialState.default(spec, 1, world=1)
    start.goal[:], start.parameters[:, MAX_SPEED] = (3.0, 4.0), 0.2
    simulation.reset(start, rng)
    simulation.step(np.array([[0.5, 0.5]]), 1.0)
    state = simulation.state()
    expected = simulation.step(np.array([[0.5, 0.5]]), 1.0)
    simulation.reset(InitialState.default(spec, 1, world=0), rng)
    simulation.step(np.array([[0.5, 0.5]]), 1.0)
    simulation.restore(state)
    again = simulation.step(np.array([[0.5, 0.5]]), 1.0)
    assert simulation.world is spec.worlds[1]
    np.testing.assert_array_equal(again.initial_state.table, expected.initial_state.table)
    np.testing.assert_array_equal(again.pose, expected.pose)
    np.testing.assert_array_equal(again.ranges, expected.ranges)
    assert again.twist[0, 0] == pytest.approx(0.2, rel=0.02)


@pytest.mark.parametrize("way", ["start", "state", "copy"])
def test_worlds_that_were_there_before_change_nothing(way, make_setup, make_bullet):
    """A quarter of these drives differed in their last digits, and then in their ends, once a wall was touched."""
    spec, rng, touched = make_setup("loop", "maze", beams=9), np.random.default_rng(3), 0
    old = make_bullet(spec)
    for number in range(12):
        start = InitialState.default(spec, 1, world=number % 2)
        start.pose[:] = spec.poses_from(number % 2, rng.random((1, 4)), 0.3)
        told = rng.uniform((0.2, -0.5), (0.6, 0.5), (30, 1, 2))
        old.reset(InitialState(start.table.copy()), np.random.default_rng(0))
        if way == "copy":
            old.step(told[0], 0.2)
            other = copy.deepcopy(old)
        else:
            other = make_bullet(spec)
            other.reset(start, np.random.default_rng(0))
        if way == "state":
            old.step(told[0], 0.2)
            other.restore(old.state())
        for each in told:
            expected, robot_state = old.step(each, 0.2), other.step(each, 0.2)
            np.testing.assert_equal(robot_state.state(), expected.state())
            touched += robot_state.bumped[0]
        other.close()
    assert touched > 20
