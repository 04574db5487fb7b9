"""The twin's noise, its states, and what it refuses to go on from."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.robot import MAX_SPEED
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.spec import WHEEL, WORLD

PERIOD = 0.2  # [s]


def test_noise_has_its_width_and_robots_have_their_own(make_setup):
    spec = make_setup("loop", beams=200, noise=0.05)
    twin, quiet = KinematicSimulator(spec, 50), KinematicSimulator(make_setup("loop", beams=200))
    noisy = twin.reset(InitialState.default(spec, 50), np.random.default_rng(0)).ranges
    exact = quiet.reset(InitialState.default(spec, 1), np.random.default_rng(0)).ranges
    errors = noisy - exact
    assert errors.std() == pytest.approx(0.05, rel=0.03)
    assert abs(errors.mean()) < 0.002
    assert len(np.unique(errors[:, 0])) == 50
    again = twin.step(np.zeros((50, 2)), PERIOD).ranges
    assert abs(np.corrcoef(errors.ravel(), (again - exact).ravel())[0, 1]) < 0.05


def driven(make_setup, start_at, num_envs=30):
    """A twin in the midst of episodes in two worlds, its robots a little different, and what to tell it next."""
    spec, rng = make_setup("maze", "loop", beams=9, noise=0.01), np.random.default_rng(4)
    worlds = rng.integers(2, size=num_envs)
    start = start_at(spec, np.stack([spec.worlds[k].random_poses(rng, 1, 0.3)[0] for k in worlds]), worlds)
    start.parameters[:, MAX_SPEED] *= rng.uniform(0.5, 1.0, num_envs)
    start.goal[:] = rng.uniform(0, 9, (num_envs, 2))
    twin, told = KinematicSimulator(spec, num_envs), rng.uniform(-1, 1, (20, num_envs, 2))
    twin.reset(start, rng)
    for command in told:
        twin.step(command, PERIOD)
    return twin, told


def test_a_restored_state_goes_on_to_the_bit(make_setup, start_at):
    twin, told = driven(make_setup, start_at)
    state = twin.state()
    first = [twin.step(command, PERIOD) for command in told]
    other = KinematicSimulator(twin.spec, 30)
    for goes_on in (twin, other):
        goes_on.restore(state)
        for command, robot_state in zip(told, first, strict=True):
            again = goes_on.step(command, PERIOD)
            np.testing.assert_array_equal(again.pose, robot_state.pose)
            np.testing.assert_array_equal(again.ranges, robot_state.ranges)
            np.testing.assert_array_equal(again.initial_state.table, robot_state.initial_state.table)
            np.testing.assert_array_equal(again.acceleration, robot_state.acceleration)


def test_a_state_is_a_copy(make_setup, start_at):
    twin, told = driven(make_setup, start_at)
    state = twin.state()
    before = {name: values.copy() for name, values in state.items()}
    twin.restart(np.array([0, 3]), InitialState.default(twin.spec, 2), twin.step(told[0], PERIOD))
    twin.restore(state)
    twin.step(told[0], PERIOD)
    for name, values in before.items():
        np.testing.assert_array_equal(state[name], values)


def test_robots_that_begin_anew_leave_the_others_alone(make_setup, start_at):
    twin, told = driven(make_setup, start_at)
    state, anew = twin.state(), np.array([0, 3])
    expected = twin.step(told[0], PERIOD)
    twin.restore(state)
    start = InitialState.default(twin.spec, 2, world=1)
    robot_state, first = twin.restart(anew, start, twin.step(told[0], PERIOD))
    loop = twin.spec.worlds[1]
    assert robot_state.pose[anew] == pytest.approx(np.array([loop.start] * 2))
    for name, values in first.state().items():
        np.testing.assert_array_equal(values, robot_state.state()[name][anew])
    for values in (
        robot_state.twist,
        robot_state.odometry_twist,
        robot_state.command,
        robot_state.acceleration,
        robot_state.bumped,
    ):
        assert (values[anew] == 0).all()
    ahead = twin.spec.laser.angles.size // 2
    assert robot_state.ranges[anew, ahead] == pytest.approx(2.5 * 2 + 1.25, abs=0.05)  # up to the corner tile
    others = np.delete(np.arange(30), anew)
    np.testing.assert_array_equal(robot_state.pose[others], expected.pose[others])
    np.testing.assert_array_equal(robot_state.ranges[others], expected.ranges[others])
    np.testing.assert_array_equal(robot_state.command[others], told[0][others])
    np.testing.assert_array_equal(robot_state.acceleration[others], expected.acceleration[others])
    assert (told[0][anew] != 0).all(), "what the caller told stays the caller's"
    after = twin.step(told[1], PERIOD)
    assert after.acceleration[anew] == pytest.approx(after.twist[anew, 0] / PERIOD)


def test_a_restored_reading_says_what_was_told_and_felt(make_setup, start_at):
    twin, told = driven(make_setup, start_at)
    last = twin.step(told[0], PERIOD)
    again = KinematicSimulator(twin.spec, 30).restore(twin.state())
    np.testing.assert_array_equal(again.command, told[0])
    np.testing.assert_array_equal(again.acceleration, last.acceleration)
    np.testing.assert_array_equal(again.twist, last.twist)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda state: state["initial_state"].__setitem__((0, WORLD), 2), "world that is not there"),
        (lambda state: state["initial_state"].__setitem__((0, WORLD), -1), "world that is not there"),
        (lambda state: state["initial_state"].__setitem__((0, WORLD), np.nan), "world that is not there"),
        (lambda state: state["initial_state"].__setitem__((0, 12), 1e9), "parameters are far"),
        (lambda state: state["initial_state"].__setitem__((0, 12), np.nan), "parameters are far"),
        (lambda state: state["initial_state"].__setitem__((0, WHEEL), 1e9), "parameters are far"),
        (lambda state: state["initial_state"].__setitem__((0, WHEEL), np.nan), "parameters are far"),
        (lambda state: state["rims"].__setitem__((0, 0), 1e9), "faster than they can"),
        (lambda state: state["rims"].__setitem__((0, 0), np.nan), "faster than they can"),
    ],
)
def test_a_state_from_which_a_step_would_not_end_is_refused(change, words, make_setup, start_at):
    twin, _ = driven(make_setup, start_at)
    state = twin.state()
    change(state)
    with pytest.raises(ValueError, match=words):
        twin.restore(state)


def test_a_robot_of_negative_coupling_has_states_too(make_setup):
    spec = make_setup(robot=replace(ROBOT, wheel_coupling=-0.4), beams=1)
    twin = KinematicSimulator(spec)
    expected = twin.step(np.array([[0.5, 0.5]]), PERIOD).pose
    twin.restore(twin.state())
    assert twin.state()["poses"] == pytest.approx(expected)
