"""The kinematic simulator's noise, its states, resets of some environments, and the states that it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.spec import FIELDS
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles

PERIOD = 0.2  # [s]


def test_noise_has_its_deviation_and_differs_between_environments(make_spec, begin):
    simulation = KinematicSimulator(make_spec("loop", beams=200, noise=0.05), 50)
    exact = begin(KinematicSimulator(make_spec("loop", beams=200))).ranges
    errors = begin(simulation).ranges - exact
    assert errors.std() == pytest.approx(0.05, rel=0.03)
    assert abs(errors.mean()) < 0.002
    assert len(np.unique(errors[:, 0])) == 50
    again = simulation.step(np.zeros((50, 2)), PERIOD).ranges
    assert abs(np.corrcoef(errors.ravel(), (again - exact).ravel())[0, 1]) < 0.05


@pytest.fixture(params=[None, [{"people": 2, "boxes": 1}, {"posts": 1, "path": [[-4, -4], [-4, 4]]}]])
def driven(request, make_spec, start_at):
    """A simulator amid 30 episodes in two worlds with slightly different robots, and commands to follow."""
    spec, rng, num_envs = make_spec("maze", "loop", beams=9, noise=0.01), np.random.default_rng(4), 30
    spec = replace(spec, dynamic_obstacles=parse_dynamic_obstacles(request.param, ""))
    worlds = rng.integers(2, size=num_envs)
    start = start_at(spec, spec.sample_poses(worlds, rng.random((num_envs, 4)), 0.3), worlds)
    start.records["max_speed"] *= rng.uniform(0.5, 1.0, num_envs)
    start.goal[:] = rng.uniform(0, 9, (num_envs, 2))
    simulation, commands = KinematicSimulator(spec, num_envs), rng.uniform(-1, 1, (20, num_envs, 2))
    simulation.reset(start, rng)
    for command in commands:
        simulation.step(command, PERIOD)
    return simulation, commands


def test_a_reset_of_some_environments_leaves_the_others_alone(driven):
    simulation, commands = driven
    state, indices = simulation.state(), np.array([0, 3])
    expected = simulation.step(commands[0], PERIOD)
    simulation.restore(state)
    initial_state = InitialState.default(simulation.spec, 2, world=1)
    simulation.step(commands[0], PERIOD)
    robot_state, first = simulation.reset_at(indices, initial_state)
    assert robot_state.pose[indices] == pytest.approx(np.array([simulation.spec.worlds[1].start] * 2))
    np.testing.assert_equal(first.state(), {name: rows[indices] for name, rows in robot_state.state().items()})
    for name in ("twist", "odometry_twist", "command", "acceleration", "bumped"):
        assert (getattr(first, name) == 0).all()
    ahead = simulation.spec.laser.angles.size // 2
    assert first.ranges[:, ahead] == pytest.approx(2.5 * 2 + 1.25, abs=0.05)  # up to the corner tile
    others = np.delete(np.arange(30), indices)
    for name, rows in expected.state().items():
        np.testing.assert_array_equal(robot_state.state()[name][others], rows[others], name)
    np.testing.assert_array_equal(robot_state.command[others], commands[0][others])
    assert (commands[0][indices] != 0).all(), "the caller's commands stay as they were"
    after = simulation.step(commands[1], PERIOD)
    assert after.acceleration[indices] == pytest.approx(after.twist[indices, 0] / PERIOD)


@pytest.mark.parametrize(
    ("key", "column", "value", "words"),
    [
        ("initial_state", "world", 2, "unknown world or goal"),
        ("initial_state", "max_speed", np.nan, "impossible parameters"),
        ("wheel_speeds", 0, np.nan, "wheel speeds must be below"),
    ],
)
def test_a_state_from_which_a_step_would_not_end_is_refused(key, column, value, words, driven):
    simulation, _ = driven
    state = simulation.state()
    state[key][0, FIELDS.index(column) if key == "initial_state" else column] = value
    with pytest.raises(ValueError, match=words):
        simulation.restore(state)
