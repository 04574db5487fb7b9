"""The initial states of episodes, and the robot states of every simulator."""

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.spec import FIELDS, PARAMETERS


def test_the_default_is_the_start_the_goal_and_the_bounds_of_each_world(make_spec):
    spec, numbers = make_spec("loop", "maze", "wall"), np.array([2, 0, 1, 2])
    initial_state = InitialState.default(spec, 4, numbers)
    assert initial_state.world.tolist() == numbers.tolist()
    for i, world in enumerate(spec.worlds[number] for number in numbers):
        assert initial_state.pose[i].tolist() == list(world.start)
        assert initial_state.bounds[i].tolist() == list(world.bounds)
        np.testing.assert_array_equal(initial_state.goal[i], world.goal[:2] if world.goal else (np.nan, np.nan))
        assert initial_state.table[i, PARAMETERS].tolist() == [getattr(ROBOT, name) for name in FIELDS[PARAMETERS]]
    assert InitialState.default(spec, 3).world.tolist() == [0, 0, 0]
    assert InitialState.default(spec, 2, 1).pose.tolist() == [list(spec.worlds[1].start)] * 2


def test_a_changed_initial_state_leaves_the_default_as_it_was(make_spec):
    spec = make_spec("wall")
    initial_state = InitialState.default(spec, 2)
    before = initial_state.table.copy()
    initial_state.pose[:], initial_state.goal[:], initial_state.bounds[:] = 1.0, 2.0, 3.0
    initial_state.records["radius"] = 4.0
    assert (initial_state.table != before).sum(axis=1).min() >= 9
    np.testing.assert_array_equal(InitialState.default(spec, 2).table, before)


def test_every_simulator_starts_at_rest_at_the_initial_state(simulator, make_spec, open_simulator, start_at, begin):
    spec = make_spec("loop", "maze", beams=3)
    simulation = open_simulator(simulator, spec)
    robot_state = begin(simulation, start_at(spec, [(9.0, 1.0, 1.5)], world=1, goal_x=4.0, goal_y=2.0))
    assert simulation.num_envs == 1
    assert robot_state.pose == pytest.approx(np.array([[9.0, 1.0, 1.5]]))
    assert robot_state.odometry == pytest.approx(np.array([[9.0, 1.0, 1.5]]))
    assert robot_state.twist.tolist() == [[0.0, 0.0]]
    assert robot_state.bumped.tolist() == [False]
    for state in (robot_state, simulation.step(np.array([[0.1, 0.0]]), 0.2)):
        assert (state.initial_state.world.tolist(), state.goal.tolist()) == ([1], [[4.0, 2.0]])
    simulation.close()
    simulation.close()  # a second time does nothing


def test_a_robot_state_is_restored_from_its_state_although_it_changed_since(make_robot_state):
    robot_state = make_robot_state(nearest_range=[1.0, 2.0], goal=(3.0, 4.0), twist=(0.5, 0.1))
    state = robot_state.state()
    robot_state.initial_state.goal[:] = 0.0
    again = RobotState.from_state(state)
    assert again.goal.tolist() == [[3.0, 4.0]] * 2
    assert again.nearest_range.tolist() == [1.0, 2.0]
    assert again.twist.tolist() == [[0.5, 0.1]] * 2
