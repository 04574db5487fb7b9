"""Robots that are not what they should be: the same ones in both simulations, and nothing else changes."""

from __future__ import annotations

import math
from contextlib import closing
from copy import deepcopy
from dataclasses import fields, replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, simulate
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.random_streams import GeneratorDraws, StreamDraws
from tb2rl.simulation.spec import LEFT_ENCODER, RIGHT_ENCODER
from tb2rl.simulation.variation import NONE, PRESETS, Variation, find_variation
from tb2rl.worlds import World

PERIOD = 0.2  # [s]
WALL_AHEAD = World.from_shapes("wall ahead", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))
BOTH = pytest.mark.parametrize("simulation", ["bullet", "kinematic"])


def streams(num_envs: int, key: int = 0) -> StreamDraws:
    return StreamDraws(np.arange(num_envs, dtype=np.uint64) + np.uint64(key), np.zeros(num_envs, dtype=np.uint64))


def varied(spec, num_envs=1, **ranges) -> InitialState:
    start = InitialState.default(spec, num_envs)
    Variation(**ranges).vary(start, streams(num_envs))
    return start


@pytest.fixture
def begin(make_setup):
    """A function from a simulation's name and ranges to it, with an episode begun, and its first reading."""
    begun = []

    def begin(simulation, world="loop", beams=1, has_gyro=False, **ranges):
        spec = make_setup(*([world] if world else []), beams=beams)
        spec = replace(spec, robot=replace(spec.robot, gyro=has_gyro))
        made = simulate(simulation, spec)
        begun.append(made)
        return made, made.reset(varied(spec, **ranges), np.random.default_rng(0))

    yield begin
    for made in begun:
        made.close()


# ---- one setting after the other


@BOTH
def test_larger_wheels_drive_faster_than_they_are_told_and_odometry_does_not_know(simulation, begin):
    made, before = begin(simulation, None, wheel_radius=(1.1, 1.1))
    after = made.step(np.array([[0.4, 0.5]]), 2.0)
    assert after.twist[0] == pytest.approx([0.44, 0.55], rel=0.01)
    assert after.odometry_twist[0] == pytest.approx([0.4, 0.5], rel=0.01)
    way = np.hypot(*(after.odometry - before.odometry)[0, :2]) / np.hypot(*(after.pose - before.pose)[0, :2])
    assert way == pytest.approx(1 / 1.1, rel=0.02)
    assert after.odometry[0, 2] == pytest.approx(after.pose[0, 2] / 1.1, rel=0.01)


@BOTH
def test_wheels_farther_apart_turn_slower_than_they_are_told_and_odometry_does_not_know(simulation, begin):
    made, _ = begin(simulation, None, wheel_separation=(1.1, 1.1))
    after = made.step(np.array([[0.3, 1.0]]), 2.0)
    assert after.twist[0] == pytest.approx([0.3, 1 / 1.1], rel=0.01)
    assert after.odometry_twist[0] == pytest.approx([0.3, 1.0], rel=0.01)
    assert after.odometry[0, 2] == pytest.approx(1.1 * after.pose[0, 2], rel=0.01)


@BOTH
def test_encoders_that_count_otherwise_change_odometry_alone(simulation, begin, make_setup):
    made, _ = begin(simulation, None)
    true = made.step(np.array([[0.4, 0.0]]), 2.0)
    start = InitialState.default(made.spec, 1)
    start.table[:, [LEFT_ENCODER, RIGHT_ENCODER]] = 0.99, 1.01
    made.reset(start, np.random.default_rng(0))
    after = made.step(np.array([[0.4, 0.0]]), 2.0)
    np.testing.assert_array_equal(after.pose, true.pose)
    np.testing.assert_array_equal(after.twist, true.twist)
    assert after.odometry[0, 2] == pytest.approx(0.02 * true.pose[0, 0] / ROBOT.wheel_separation, rel=0.01)
    assert after.odometry_twist[0, 1] == pytest.approx(0.02 * 0.4 / ROBOT.wheel_separation, rel=0.01)


@BOTH
def test_a_gyro_knows_how_far_the_robot_turns_whatever_the_wheels_count(simulation, begin):
    wheels = {"wheel_radius": (1.1, 1.1), "wheel_separation": (0.9, 0.9), "odometry": (0.95, 1.05)}
    made, _ = begin(simulation, None, has_gyro=True, **wheels, gyro=(1.02, 1.02))
    after = made.step(np.array([[0.3, 1.0]]), 2.0)
    assert after.odometry[0, 2] == pytest.approx(1.02 * after.pose[0, 2], rel=1e-3)
    assert after.odometry_twist[0, 1] == pytest.approx(1.02 * after.twist[0, 1], rel=0.01)


@BOTH
def test_a_gyro_alone_that_counts_otherwise_makes_odometry_drift(simulation, begin):
    made, _ = begin(simulation, None, has_gyro=True, gyro=(0.98, 0.98))
    after = made.step(np.array([[0.3, 1.0]]), 2.0)
    assert after.odometry[0, 2] == pytest.approx(0.98 * after.pose[0, 2], rel=0.002)


@BOTH
def test_weaker_motors_need_longer(simulation, begin):
    speeds = [begin(simulation, None, acceleration=(a, a))[0].step(np.array([[0.6, 0.0]]), 0.1) for a in (0.5, 1.0)]
    assert speeds[0].twist[0, 0] == pytest.approx(speeds[1].twist[0, 0] / 2, rel=0.05)


@BOTH
@pytest.mark.parametrize(
    ("ranges", "seen"),
    [
        ({}, 1.0),
        ({"bias": (0.1, 0.1)}, 1.1),
        ({"mount_x": (0.2, 0.2)}, 0.8),
        ({"mount_y": (0.2, 0.2)}, 1.0),
        ({"mount_yaw": (0.5, 0.5)}, 1.0 / math.cos(0.5)),
        ({"mount_yaw": (0.5, 0.5), "mount_x": (0.2, 0.2)}, 0.8 / math.cos(0.5)),
        ({"dropped": (1.0, 1.0)}, math.inf),
    ],
)
def test_the_laser_reads_the_wall_ahead_with_its_flaws(simulation, ranges, seen, begin):
    assert begin(simulation, WALL_AHEAD, **ranges)[1].ranges[0, 0] == pytest.approx(seen)


@BOTH
def test_a_laser_out_of_place_reads_what_a_right_one_would_read_there(simulation, begin):
    made, _ = begin(simulation, "maze", beams=36)
    start = varied(made.spec, mount_x=(0.1, 0.1), mount_y=(0.05, 0.05), mount_yaw=(0.3, 0.3))
    x, y, yaw = start.pose[0]
    there = InitialState.default(made.spec, 1)
    ahead, aside = 0.1 * np.array([math.cos(yaw), math.sin(yaw)]), 0.05 * np.array([-math.sin(yaw), math.cos(yaw)])
    there.pose[:] = *((x, y) + ahead + aside), yaw + 0.3
    seen = made.reset(start, np.random.default_rng(0)).ranges
    np.testing.assert_allclose(seen, made.reset(there, np.random.default_rng(0)).ranges, atol=1e-6)


@BOTH
def test_some_beams_are_dropped_others_each_time(simulation, begin):
    made, first = begin(simulation, WALL_AHEAD, beams=400, dropped=(0.2, 0.2))
    full = begin(simulation, WALL_AHEAD, beams=400)[1]
    lost = np.isinf(first.ranges) & np.isfinite(full.ranges)
    assert lost.sum() / np.isfinite(full.ranges).sum() == pytest.approx(0.2, abs=0.06)
    kept = np.isfinite(first.ranges)
    np.testing.assert_array_equal(first.ranges[kept], full.ranges[kept])
    again = made.step(np.zeros((1, 2)), PERIOD)
    assert (np.isinf(again.ranges) != np.isinf(first.ranges)).any()


@BOTH
def test_noise_takes_the_place_of_the_lasers_own(simulation, begin):
    exact = begin(simulation, WALL_AHEAD, beams=400)[1].ranges
    noisy = begin(simulation, WALL_AHEAD, beams=400, laser_noise=(0.05, 0.05))[1].ranges
    seen = np.isfinite(exact) & (exact < 29.0)
    assert (noisy[seen] - exact[seen]).std() == pytest.approx(0.05, rel=0.15)


def test_a_heavy_robot_gains_speed_slower_and_a_floor_without_grip_lets_the_wheels_spin(begin):
    def after(**ranges):
        return begin("bullet", None, **ranges)[0].step(np.array([[0.6, 0.0]]), 0.15)

    own, heavy, slippery = after(), after(mass=(3.0, 3.0)), after(friction=(0.05, 0.05))
    assert heavy.twist[0, 0] < 0.9 * own.twist[0, 0]
    assert slippery.twist[0, 0] < 0.9 * slippery.odometry_twist[0, 0]
    assert own.twist[0, 0] == pytest.approx(own.odometry_twist[0, 0], rel=0.05)


def test_after_a_heavy_episode_the_robot_is_its_own_again_to_the_bit(make_setup, make_bullet):
    spec, told = make_setup(beams=3), np.array([[0.6, 1.0]])
    fresh, used = make_bullet(spec), make_bullet(spec)
    used.reset(varied(spec, mass=(2.0, 2.0), friction=(0.3, 0.3)), np.random.default_rng(0))
    used.step(told, 1.0)
    ends = []
    for each in (fresh, used):
        each.reset(InitialState.default(spec, 1), np.random.default_rng(0))
        ends.append(each.step(told, 1.0).pose)
    np.testing.assert_array_equal(*ends)


def test_a_copy_of_a_heavy_robot_is_as_heavy(make_setup, make_bullet):
    spec, told = make_setup(beams=3), np.array([[0.6, 1.0]])
    made = make_bullet(spec)
    made.reset(varied(spec, mass=(2.0, 2.0), friction=(0.3, 0.3)), np.random.default_rng(0))
    made.step(told, PERIOD)
    with closing(deepcopy(made)) as copied:
        np.testing.assert_array_equal(copied.step(told, PERIOD).pose, made.step(told, PERIOD).pose)


# ---- both simulations alike


def test_varied_robots_end_where_they_do_in_pybullet(make_setup, make_bullet):
    """Drives of 5 s at random commands, until the first touch, by what only PyBullet has apart."""
    spec, rng, count = make_setup("maze", beams=1), np.random.default_rng(1), 60
    strong = replace(PRESETS["strong"], mass=(1.0, 1.0), friction=(1.0, 1.0))
    start = InitialState.default(spec, count)
    start.pose[:] = spec.worlds[0].random_poses(rng, count, 0.3)
    strong.vary(start, GeneratorDraws(rng, count))
    commands = rng.uniform((-ROBOT.max_speed, -2.0), (ROBOT.max_speed, 2.0), (25, count, 2))
    twin, physics = KinematicSimulator(spec, count), make_bullet(spec)
    twin.reset(InitialState(start.table.copy()), rng)
    readings = [twin.step(told, PERIOD) for told in commands]
    missed, counted = [], []
    for i in range(count):
        physics.reset(InitialState(start.table[i : i + 1]), rng)
        for told, robot_state in zip(commands[:, i : i + 1], readings, strict=True):
            real = physics.step(told, PERIOD)
            if real.bumped[0] or robot_state.bumped[i]:
                break
            apart = real.pose[0] - robot_state.pose[i], real.odometry[0] - robot_state.odometry[i]
        missed.append(apart[0])
        counted.append(apart[1])
    for each in (np.array(missed), np.array(counted)):
        turned = np.abs(np.remainder(each[:, 2] + math.pi, math.tau) - math.pi)
        assert np.median(np.hypot(*each.T[:2])) < 0.03
        assert np.percentile(np.hypot(*each.T[:2]), 99) < 0.1
        assert math.degrees(np.median(turned)) < 3.0


@pytest.mark.parametrize("preset", ["mild", "strong"])
def test_states_of_varied_robots_go_on_to_the_bit(preset, make_setup, make_bullet):
    for simulation in ("bullet", "kinematic"):
        spec = make_setup("loop", beams=20)
        num_envs = 1 if simulation == "bullet" else 30
        made = make_bullet(spec) if simulation == "bullet" else KinematicSimulator(spec, num_envs)
        start = InitialState.default(spec, num_envs)
        PRESETS[preset].vary(start, streams(num_envs, key=5))
        made.reset(start, np.random.default_rng(0))
        made.step(np.full((num_envs, 2), 0.4), PERIOD)
        state = made.state()
        expected = [made.step(np.full((num_envs, 2), 0.5), PERIOD).state() for _ in range(3)]
        made.reset(InitialState.default(spec, num_envs), np.random.default_rng(1))
        made.restore(state)
        for one in expected:
            np.testing.assert_equal(made.step(np.full((num_envs, 2), 0.5), PERIOD).state(), one)


def test_a_robot_whose_episode_begins_anew_counts_from_there(make_setup):
    spec = make_setup("loop", beams=3)
    twin = KinematicSimulator(spec, 3)
    twin.reset(varied(spec, 3, wheel_radius=(0.9, 1.1)), np.random.default_rng(0))
    last = twin.step(np.full((3, 2), 0.4), 1.0)
    robot_state, first = twin.restart(np.array([1]), varied(spec, 1, wheel_radius=(0.9, 1.1)), last)
    np.testing.assert_array_equal(first.odometry, first.pose)
    np.testing.assert_array_equal(robot_state.odometry[1], first.pose[0])
    assert (robot_state.odometry[[0, 2]] != robot_state.pose[[0, 2]]).any(axis=1).all()


# ---- what is drawn


def test_without_variation_nothing_is_drawn_and_nothing_changes(make_setup):
    start, draws = InitialState.default(make_setup("loop"), 5), streams(5)
    table = start.table.copy()
    NONE.vary(start, draws)
    np.testing.assert_array_equal(start.table, table)
    assert (draws.counts == 0).all()


def test_each_number_lies_in_its_range_and_robots_differ(make_setup):
    start = InitialState.default(make_setup("loop"), 2000)
    PRESETS["strong"].vary(start, streams(2000))
    make_setup("loop").check_table(start.table)  # what a checkpoint may hold
    shares = start.parameters / ROBOT.parameters
    assert (np.abs(shares[:, 1] - 1.0) <= 0.05).all()
    assert (np.abs(shares[:, 4] - 1.0) <= 0.2).all()
    np.testing.assert_allclose(shares[:, 4], shares[:, 5])
    assert len(np.unique(shares[:, 4])) == 2000
    for latency in (start.command_latency, start.observation_latency):
        assert np.mean(latency) == pytest.approx(0.5, abs=0.05)
        assert set(latency) == {0, 1}


def test_a_changed_range_changes_no_other_number(make_setup):
    tables = []
    for setting in ({"preset": "mild"}, {"preset": "mild", "bias": 0.2}):
        start = InitialState.default(make_setup("loop"), 50)
        find_variation(setting).vary(start, streams(50))
        tables.append(start.table)
    differ = (tables[0] != tables[1]) & ~np.isnan(tables[0])
    assert differ.any(axis=0).sum() == 1
    assert (tables[1][:, differ.any(axis=0)] == 0.2).all()


# ---- what users write


def test_a_preset_is_a_start_for_changes():
    assert find_variation("none") == find_variation({}) == Variation()
    assert find_variation("mild") == find_variation({"preset": "mild"}) == PRESETS["mild"]
    changed = find_variation({"preset": "mild", "latency": [0, 2], "bias": 0.05})
    assert changed == replace(PRESETS["mild"], latency=(0, 2), bias=(0.05, 0.05))
    assert find_variation({"observation_latency": 2}) == Variation(observation_latency=(2, 2))


def test_strong_is_wider_than_mild_in_everything():
    for field in fields(Variation):
        mild, strong = (getattr(PRESETS[name], field.name) for name in ("mild", "strong"))
        assert strong[0] <= mild[0] <= mild[1] <= strong[1], field.name


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("wild", "unknown preset of task.variation: 'wild'; did you mean 'mild'"),
        ({"preset": 3}, "unknown preset of task.variation: 3"),
        ({"preset": "mild", "latencyy": 1}, "unknown key of task.variation 'latencyy'; did you mean 'latency'"),
        ({"latency": [2, 1]}, "task.variation.latency: must be a number, or the lowest and the highest"),
        ({"latency": 0.5}, "task.variation.latency"),
        ({"latency": 99}, "task.variation.latency"),
        ({"wheel_radius": 0}, "task.variation.wheel_radius"),
        ({"wheel_radius": math.nan}, "task.variation.wheel_radius"),
        ({"laser_noise": -1}, "task.variation.laser_noise"),
        ({"mass": [1]}, "task.variation.mass"),
        ({"dropped": "many"}, "task.variation.dropped"),
        ({3: 4}, "a key must be the name"),
    ],
)
def test_what_does_not_fit_is_said_in_one_line(setting, words):
    with pytest.raises(InputError) as caught:
        find_variation(setting)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
