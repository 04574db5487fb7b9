"""The start of an episode, and what a reading says of it."""

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, simulate


def test_a_start_is_what_the_world_proposes(make_setup):
    spec = make_setup("loop", "maze", "wall")
    start = InitialState.default(spec, 4, np.array([2, 0, 1, 2]))
    for robot, number in enumerate([2, 0, 1, 2]):
        world = spec.worlds[number]
        assert start.pose[robot].tolist() == list(world.start)
        assert start.world[robot] == number
        assert start.bounds[robot].tolist() == list(world.bounds)
        expected = world.goal[:2] if world.goal else (np.nan, np.nan)
        np.testing.assert_array_equal(start.goal[robot], expected)
        np.testing.assert_array_equal(start.parameters[robot], ROBOT.parameters)


def test_all_robots_begin_in_the_first_world_unless_it_is_said(make_setup):
    spec = make_setup("loop", "maze")
    assert InitialState.default(spec, 3).world.tolist() == [0, 0, 0]
    assert InitialState.default(spec, 2, 1).pose.tolist() == [list(spec.worlds[1].start)] * 2


def test_a_start_that_is_changed_leaves_the_next_one_as_it_was(make_setup):
    spec = make_setup("wall")
    start = InitialState.default(spec, 2)
    before = start.table.copy()
    start.pose[:], start.goal[:], start.bounds[:], start.parameters[:] = 1.0, 2.0, 3.0, 4.0
    assert (start.table != before).sum(axis=1).min() >= 14
    np.testing.assert_array_equal(InitialState.default(spec, 2).table, before)


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_every_simulation_begins_where_it_is_told_at_rest_and_says_so(name, make_setup, start_at):
    spec = make_setup("loop", "maze", beams=3)
    simulation = simulate(name, spec)
    start = start_at(spec, [(9.0, 1.0, 1.5)], world=1)
    start.goal[:] = 4.0, 2.0
    robot_state = simulation.reset(start, np.random.default_rng(0))
    assert simulation.num_envs == 1
    assert robot_state.pose == pytest.approx(np.array([[9.0, 1.0, 1.5]]))
    assert robot_state.odometry == pytest.approx(np.array([[9.0, 1.0, 1.5]]))
    assert robot_state.twist.tolist() == [[0.0, 0.0]]
    assert robot_state.bumped.tolist() == [False]
    after = simulation.step(np.array([[0.1, 0.0]]), 0.2)
    for seen in (robot_state, after):
        assert (seen.start.world.tolist(), seen.goal.tolist()) == ([1], [[4.0, 2.0]])
    simulation.close()
    simulation.close()  # once more does no harm


def test_an_unknown_simulation_is_refused_with_the_known_ones(make_setup):
    with pytest.raises(
        InputError, match="unknown simulation 'bulet'; did you mean 'bullet'\\? known: bullet, kinematic"
    ):
        simulate("bulet", make_setup())


def test_the_twin_has_no_window(make_setup):
    with pytest.raises(InputError, match="'kinematic' has none"):
        simulate("kinematic", make_setup(), window=True)


# ---- readings


def test_the_nearest_range_is_that_of_each_robot(make_reading):
    assert make_reading(ranges=[[2.0, 1.0], [np.inf, 3.0], [np.inf, np.inf]]).nearest.tolist() == [1.0, 3.0, np.inf]


def test_a_reading_comes_back_from_its_state_whatever_became_of_it(make_reading):
    robot_state = make_reading(nearest=[1.0, 2.0], goal=(3.0, 4.0), twist=(0.5, 0.1))
    state = robot_state.state()
    robot_state.initial_state.goal[:] = 0.0
    again = RobotState.from_state(state)
    assert again.goal.tolist() == [[3.0, 4.0]] * 2
    assert again.nearest.tolist() == [1.0, 2.0]
    assert again.twist.tolist() == [[0.5, 0.1]] * 2
