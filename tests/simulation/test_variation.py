"""Varied robots: the same ones in both simulators, and nothing else changes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.random_streams import GeneratorSource, StreamSource
from tb2rl.simulation.spec import PARAMETERS
from tb2rl.simulation.variation import NONE, PRESETS, Variation, describe_variation, find_variation
from tb2rl.worlds import World

PERIOD = 0.2  # [s]
WALL_AHEAD = World.from_shapes("wall ahead", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def streams(num_envs: int, key: int = 0) -> StreamSource:
    return StreamSource(np.arange(num_envs, dtype=np.uint64) + np.uint64(key), np.zeros(num_envs, dtype=np.uint64))


def varied(spec, num_envs=1, **ranges) -> InitialState:
    """The initial state with a variation; a number stands for a range of this number alone."""
    initial_state = InitialState.default(spec, num_envs)
    find_variation(ranges).vary(initial_state, streams(num_envs))
    return initial_state


@pytest.fixture
def make_varied(simulator, make_spec, open_simulator, begin):
    """A function from a world and a variation to each simulator in an episode, and its first state."""

    def make(world=None, beams=1, has_gyro=False, **ranges):
        spec = make_spec(*([world] if world else []), beams=beams)
        spec = replace(spec, robot=replace(spec.robot, gyro=has_gyro))
        simulation = open_simulator(simulator, spec)
        return simulation, begin(simulation, varied(spec, **ranges))

    return make


# ---- one setting after the other


@pytest.mark.parametrize(
    ("ranges", "command", "twist", "turn_ratio"),
    [
        ({"wheel_radius": 1.1}, (0.4, 0.5), (0.44, 0.55), 1 / 1.1),
        ({"wheel_separation": 1.1}, (0.3, 1.0), (0.3, 1 / 1.1), 1.1),
    ],
)
def test_other_wheels_drive_otherwise_than_commanded_and_odometry_does_not_know(
    ranges, command, twist, turn_ratio, make_varied
):
    simulation, _ = make_varied(**ranges)
    after = simulation.step(np.array([command]), 2.0)
    assert after.twist[0] == pytest.approx(twist, rel=0.01)
    assert after.odometry_twist[0] == pytest.approx(command, rel=0.01)
    assert after.odometry[0, 2] == pytest.approx(turn_ratio * after.pose[0, 2], rel=0.01)


def test_encoder_errors_change_odometry_alone(make_varied, start_at, begin):
    simulation, _ = make_varied()
    true = simulation.step(np.array([[0.4, 0.0]]), 2.0)
    begin(simulation, start_at(simulation.spec, left_encoder=0.99, right_encoder=1.01))
    after = simulation.step(np.array([[0.4, 0.0]]), 2.0)
    np.testing.assert_array_equal(after.pose, true.pose)
    np.testing.assert_array_equal(after.twist, true.twist)
    assert after.odometry[0, 2] == pytest.approx(0.02 * true.pose[0, 0] / ROBOT.wheel_separation, rel=0.01)
    assert after.odometry_twist[0, 1] == pytest.approx(0.02 * 0.4 / ROBOT.wheel_separation, rel=0.01)


@pytest.mark.parametrize("wheels", [{}, {"wheel_radius": 1.1, "wheel_separation": 0.9, "odometry": [0.95, 1.05]}])
def test_a_gyro_gives_the_heading_with_its_own_error_whatever_the_wheels_count(wheels, make_varied):
    simulation, _ = make_varied(has_gyro=True, **wheels, gyro=1.02)
    after = simulation.step(np.array([[0.3, 1.0]]), 2.0)
    assert after.odometry[0, 2] == pytest.approx(1.02 * after.pose[0, 2], rel=1e-3)
    assert after.odometry_twist[0, 1] == pytest.approx(1.02 * after.twist[0, 1], rel=0.01)


@pytest.mark.parametrize(
    ("ranges", "measured"),
    [
        ({"bias": 0.1}, 1.1),
        ({"mount_y": 0.2}, 1.0),
        ({"mount_yaw": 0.5, "mount_x": 0.2}, 0.8 / math.cos(0.5)),
        ({"dropped": 1.0}, math.inf),
    ],
)
def test_the_laser_measures_the_wall_ahead_with_its_errors(ranges, measured, make_varied):
    assert make_varied(WALL_AHEAD, **ranges)[1].ranges[0, 0] == pytest.approx(measured)


def test_a_share_of_the_beams_is_dropped_and_others_each_time(make_varied):
    simulation, first = make_varied(WALL_AHEAD, beams=400, dropped=0.2)
    exact = make_varied(WALL_AHEAD, beams=400)[1].ranges
    dropped = np.isinf(first.ranges) & np.isfinite(exact)
    assert dropped.sum() / np.isfinite(exact).sum() == pytest.approx(0.2, abs=0.06)
    np.testing.assert_array_equal(first.ranges[~dropped], exact[~dropped])
    again = simulation.step(np.zeros((1, 2)), PERIOD)
    assert (np.isinf(again.ranges) != np.isinf(first.ranges)).any()


def test_mass_slows_the_robot_and_wheels_without_friction_spin(make_spec, make_physics, begin):
    def after(**ranges):
        simulation = make_physics(make_spec(beams=1))
        begin(simulation, varied(simulation.spec, **ranges))
        return simulation.step(np.array([[0.6, 0.0]]), 0.15)

    own, heavy, slippery = after(), after(mass=3.0), after(friction=0.2)
    assert heavy.twist[0, 0] < 0.9 * own.twist[0, 0]
    assert slippery.twist[0, 0] < 0.9 * slippery.odometry_twist[0, 0]
    assert own.twist[0, 0] == pytest.approx(own.odometry_twist[0, 0], rel=0.05)


@pytest.mark.parametrize("has_gyro", [True, False])
def test_only_a_gyro_measures_the_turn_of_a_robot_whose_wheels_slip(has_gyro, make_spec, make_physics, begin):
    spec = make_spec(beams=1)
    simulation = make_physics(replace(spec, robot=replace(spec.robot, gyro=has_gyro)))
    begin(simulation, varied(simulation.spec, friction=0.2))
    after = simulation.step(np.array([[0.0, 2.5]]), 0.2)
    assert 0.0 < after.twist[0, 1] < 2.3
    by_odometry, true = after.odometry[0, 2], after.pose[0, 2]
    assert by_odometry == pytest.approx(true) if has_gyro else by_odometry > 1.1 * true
    assert (after.odometry_twist[0, 1] == pytest.approx(after.twist[0, 1])) == has_gyro


def test_the_robot_is_exactly_nominal_in_the_next_episode(make_spec, make_physics, begin):
    spec, command = make_spec(beams=3), np.array([[0.6, 1.0]])
    fresh, used = make_physics(spec), make_physics(spec)
    begin(used, varied(spec, mass=2.0, friction=0.3))
    used.step(command, 1.0)
    for simulation in (fresh, used):
        begin(simulation)
    np.testing.assert_array_equal(fresh.step(command, 1.0).pose, used.step(command, 1.0).pose)


# ---- both simulators


def test_varied_robots_end_where_they_do_in_pybullet(make_spec, make_physics, start_at):
    """Drives of 5 s at random commands, until the first touch, without the variation that only PyBullet has."""
    spec, rng, num_envs = make_spec("maze", beams=1), np.random.default_rng(1), 60
    initial_state = start_at(spec, spec.worlds[0].sample_poses(rng.random((num_envs, 4)), 0.3))
    replace(PRESETS["strong"], mass=(1.0, 1.0), friction=(1.0, 1.0)).vary(initial_state, GeneratorSource(rng, num_envs))
    commands = rng.uniform((-ROBOT.max_speed, -2.0), (ROBOT.max_speed, 2.0), (25, num_envs, 2))
    kinematic, physics = KinematicSimulator(spec, num_envs), make_physics(spec)
    kinematic.reset(InitialState(initial_state.table.copy()), rng)
    states = [kinematic.step(command, PERIOD) for command in commands]
    missed = []
    for i in range(num_envs):
        physics.reset(InitialState(initial_state.table[i : i + 1]), rng)
        for command, state in zip(commands[:, i : i + 1], states, strict=True):
            real = physics.step(command, PERIOD)
            if real.bumped[0] or state.bumped[i]:
                break
            errors = real.pose[0] - state.pose[i], real.odometry[0] - state.odometry[i]
        missed.append(errors)
    for errors in np.moveaxis(missed, 1, 0):
        turned = np.abs(np.remainder(errors[:, 2] + math.pi, math.tau) - math.pi)
        assert np.median(np.hypot(*errors.T[:2])) < 0.03
        assert np.percentile(np.hypot(*errors.T[:2]), 99) < 0.1
        assert math.degrees(np.median(turned)) < 3.0


def test_odometry_starts_anew_with_an_episode(make_spec, begin):
    spec = make_spec("loop", beams=3)
    simulation = KinematicSimulator(spec, 3)
    begin(simulation, varied(spec, 3, wheel_radius=[0.9, 1.1]))
    simulation.step(np.full((3, 2), 0.4), 1.0)
    robot_state, first = simulation.reset_at(np.array([1]), varied(spec, 1, wheel_radius=[0.9, 1.1]))
    np.testing.assert_array_equal(first.odometry, first.pose)
    np.testing.assert_array_equal(robot_state.odometry[1], first.pose[0])
    assert (robot_state.odometry[[0, 2]] != robot_state.pose[[0, 2]]).any(axis=1).all()


# ---- random draws


def test_without_variation_nothing_is_drawn_or_changed(make_spec):
    initial_state, random = InitialState.default(make_spec("loop"), 5), streams(5)
    table = initial_state.table.copy()
    NONE.vary(initial_state, random)
    np.testing.assert_array_equal(initial_state.table, table)
    assert (random.counts == 0).all()


def test_each_parameter_lies_in_its_range_and_robots_differ(make_spec):
    initial_state = InitialState.default(make_spec("loop"), 2000)
    PRESETS["strong"].vary(initial_state, streams(2000))
    make_spec("loop").check_table(initial_state.table)  # what a checkpoint may hold
    nominal = make_spec("loop").table[:, PARAMETERS]
    separation, acceleration, coupling = (initial_state.table[:, PARAMETERS] / nominal).T[[1, 4, 5]]
    assert (np.abs(separation - 1.0) <= 0.05).all()
    assert (np.abs(acceleration - 1.0) <= 0.2).all()
    np.testing.assert_allclose(acceleration, coupling)
    assert len(np.unique(acceleration)) == 2000
    for latency in (initial_state.records["command_latency"], initial_state.records["observation_latency"]):
        assert np.mean(latency) == pytest.approx(0.5, abs=0.05)
        assert set(latency) == {0, 1}


def test_a_changed_range_changes_no_other_number(make_spec):
    tables = []
    for setting in ({"preset": "mild"}, {"preset": "mild", "bias": 0.2}):
        initial_state = InitialState.default(make_spec("loop"), 50)
        find_variation(setting).vary(initial_state, streams(50))
        tables.append(initial_state.table)
    differ = (tables[0] != tables[1]) & ~np.isnan(tables[0])
    assert differ.any(axis=0).sum() == 1
    assert (tables[1][:, differ.any(axis=0)] == 0.2).all()


# ---- settings


def test_settings_change_a_preset():
    assert find_variation("none") == find_variation({}) == Variation()
    assert find_variation("mild") == find_variation({"preset": "mild"}) == PRESETS["mild"]
    changed = find_variation({"preset": "mild", "latency": [0, 2], "bias": 0.05})
    assert changed == replace(PRESETS["mild"], latency=(0, 2), bias=(0.05, 0.05))
    assert find_variation({"observation_latency": 2}) == Variation(observation_latency=(2, 2))


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("none", ""),
        ("strong", "strong variation"),
        ({"bias": 0.1, "dropped": 0.1}, "variation of bias, dropped"),
        ({"preset": "mild", "observation_latency": [0, 1]}, "mild variation, but observation latency 0 to 1"),
        ({"preset": "mild", "bias": 0, "laser_noise": None}, "mild variation, but laser noise of the task, bias 0"),
    ],
)
def test_a_description_says_what_differs_from_a_preset(setting, words):
    assert describe_variation(setting) == words


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("wild", "unknown preset of task.variation: 'wild'; did you mean 'mild'"),
        ({"preset": "mild", "latencyy": 1}, "unknown key of task.variation 'latencyy'; did you mean 'latency'"),
        ({"latency": [2, 1]}, "task.variation.latency: must be a number, or the lowest and the highest"),
        ({"latency": 99}, "task.variation.latency"),
    ],
)
def test_an_invalid_setting_is_refused_in_one_line(setting, words):
    with pytest.raises(InputError) as caught:
        find_variation(setting)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
