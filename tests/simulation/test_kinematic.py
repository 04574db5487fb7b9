"""The fast twin does what the robot in PyBullet does, and each of many robots does what it would do alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.robot import MAX_SPEED, RADIUS, WHEEL_ACCELERATION, WHEEL_SEPARATION
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.spec import PHYSICS_RATE
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast
from tb2rl.worlds.registry import world_names

PERIOD = 0.2  # [s]
OPEN = World.from_shapes("open", start=(0.0, 0.0, 0.0), bounds=(-40.0, -40.0, 40.0, 40.0))
ONE_WALL = World.from_shapes("one wall", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def wheel_speeds(twist: np.ndarray, separation: float) -> np.ndarray:
    v, w = twist.T
    return np.stack([v - w * separation / 2, v + w * separation / 2], axis=1)


def drive(spec, start, commands, seed=0):
    """The readings of the twin's robots that are told each of `commands` (steps, robots, 2)."""
    twin = KinematicSimulator(spec, len(start.table))
    first = twin.reset(start, np.random.default_rng(seed))
    return [first, *(twin.step(told, PERIOD) for told in np.asarray(commands, dtype=float))]


# ---- as the robot in PyBullet


@pytest.mark.parametrize("coupling", [ROBOT.wheel_coupling, -0.4])  # its own; of one easier to turn than to push
@pytest.mark.parametrize(
    ("told", "pushes", "together"),
    [
        ((0.6, 0.0), (1, 1), (1, 1)),
        ((0.0, 3.0), (-1, 1), (1, -1)),
        ((0.3, 0.6 / ROBOT.wheel_separation), (0, 1), (0, 0)),
    ],
)
def test_the_rims_speed_up_as_the_robots_numbers_say(told, pushes, together, coupling, make_setup):
    spec = make_setup(OPEN, robot=replace(ROBOT, wheel_coupling=coupling), beams=1)
    twin = KinematicSimulator(spec)
    twin.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    twists = np.concatenate([twin.step(np.array([told]), 1 / PHYSICS_RATE).twist for _ in range(6)])
    speeds = wheel_speeds(twists, ROBOT.wheel_separation)
    expected = ROBOT.wheel_acceleration * np.array(pushes) + coupling * np.array(together)
    np.testing.assert_allclose((speeds[5] - speeds[0]) / 5 * PHYSICS_RATE, expected, atol=1e-9)


@pytest.mark.parametrize(
    "name", [name if name in ("loop", "wall") else pytest.param(name, marks=pytest.mark.slow) for name in world_names()]
)
def test_random_commands_end_where_they_do_in_pybullet(name, robot, make_setup, make_bullet, start_at):
    """Up to 200 sequences of 5 s in each world, a new command over the robot's whole range at each control step."""
    spec, rng = make_setup(name, robot=robot, beams=2), np.random.default_rng(1)
    count = 200 if robot.max_speed < 1.0 else 800  # a fast one has met a wall by then in most of them
    (world,) = spec.worlds
    poses = world.random_poses(rng, count, 0.6)
    commands = rng.uniform((-robot.max_speed, -2.0), (robot.max_speed, 2.0), (25, count, 2))
    readings = drive(spec, start_at(spec, poses), commands)
    clear = np.ones(count, dtype=bool)
    for robot_state in readings[1:]:
        clear &= [world.clearance(x, y) > robot.radius + 0.05 for x, y, _ in robot_state.pose]
    physics, ends, clear = make_bullet(spec), [], np.flatnonzero(clear)[:200]
    for i in clear:
        physics.reset(start_at(spec, poses[i : i + 1]), rng)
        for told in commands[:, i : i + 1]:
            end = physics.step(told, PERIOD)
        ends.append(end.pose[0])
    missed = np.array(ends) - readings[-1].pose[clear]
    distance, turn = np.hypot(*missed.T[:2]), np.abs(np.remainder(missed[:, 2] + math.pi, math.tau) - math.pi)
    assert len(ends) > 150
    assert np.median(distance) < 0.01
    assert np.percentile(distance, 99) < 0.05
    assert math.degrees(np.median(turn)) < 1.0
    assert math.degrees(np.percentile(turn, 99)) < 5.0


def test_both_simulations_read_the_same_at_the_same_pose(make_setup, make_bullet, start_at):
    spec, rng = make_setup("round", beams=36), np.random.default_rng(3)
    (world,) = spec.worlds
    poses = world.random_poses(rng, 20, 0.3)
    physics, twin = make_bullet(spec), KinematicSimulator(spec, 20)
    read = twin.reset(start_at(spec, poses), rng).ranges
    for pose, ranges in zip(poses, read, strict=True):
        np.testing.assert_allclose(physics.reset(start_at(spec, [pose]), rng).ranges[0], ranges, atol=1e-3)
    exact = np.empty_like(read)
    cast(poses, np.cos(spec.laser.angles), np.sin(spec.laser.angles), world.boxes, world.posts, exact)
    np.testing.assert_array_equal(read, exact)


# ---- walls


@pytest.mark.parametrize("name", world_names())
def test_nobody_gets_into_a_wall(name, make_setup, start_at):
    spec, rng, count = make_setup(name, beams=2), np.random.default_rng(2), 300
    (world,) = spec.worlds
    limits = np.array([ROBOT.max_speed, ROBOT.max_turn_rate])
    commands = rng.uniform(-limits, limits, (1, count, 2))
    for _ in range(19):
        commands = np.concatenate([commands, rng.uniform((-limits[0], -1.0), (limits[0], 1.0), (1, count, 2))])
    poses = world.random_poses(rng, count, ROBOT.radius + 0.01)
    readings = drive(spec, start_at(spec, poses), commands.repeat(5, axis=0))
    for robot_state in readings:
        assert min(world.clearance(x, y) for x, y, _ in robot_state.pose) > ROBOT.radius - 1e-3
    assert any(robot_state.bumped.any() for robot_state in readings)


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.9])
def test_a_robot_stops_at_a_wall_and_gets_away_backwards(yaw, make_setup, start_at):
    spec = make_setup(ONE_WALL, beams=3)
    commands = [[(ROBOT.max_speed, 0.0)]] * 20 + [[(-ROBOT.max_speed, 0.0)]] * 5
    readings = drive(spec, start_at(spec, [(0.0, 0.0, yaw)]), commands)
    assert readings[20].bumped[0]
    assert ONE_WALL.clearance(*readings[20].pose[0, :2]) == pytest.approx(ROBOT.radius, abs=1e-3)
    assert not readings[-1].bumped[0]
    assert ONE_WALL.clearance(*readings[-1].pose[0, :2]) > ROBOT.radius + 0.1


# ---- each robot in a world of its own


@pytest.mark.parametrize("robots", [30, 3000], ids=["one thread", "several threads"])
def test_a_robot_reads_the_walls_of_the_world_that_it_is_in(num_envs, make_setup, start_at):
    spec, rng = make_setup("maze", "round", "wall", beams=9), np.random.default_rng(0)
    worlds = rng.integers(3, size=num_envs)
    poses = np.stack([spec.worlds[k].random_poses(rng, 1, 0.3)[0] for k in worlds])
    readings = drive(spec, start_at(spec, poses, worlds), [np.full((num_envs, 2), 0.3)] * 2)
    for number, world in enumerate(spec.worlds):
        here = worlds == number
        assert here.any()
        for robot_state in readings:
            exact = np.empty((here.sum(), 9))
            angles = spec.laser.angles
            cast(robot_state.pose[here], np.cos(angles), np.sin(angles), world.boxes, world.posts, exact)
            np.testing.assert_allclose(robot_state.ranges[here], np.where(exact > 30, np.inf, exact.clip(min=0.1)))


def test_a_robot_bumps_into_the_walls_of_the_world_that_it_is_in(make_setup, start_at):
    spec = make_setup(ONE_WALL, OPEN, beams=1)
    start = start_at(spec, [(0.0, 0.0, 0.0)] * 4, np.array([0, 1, 0, 1]))
    last = drive(spec, start, [np.tile((ROBOT.max_speed, 0.0), (4, 1))] * 20)[-1]
    assert last.bumped.tolist() == [True, False, True, False]
    assert last.pose[:, 0] == pytest.approx(
        [1 - ROBOT.radius, last.pose[1, 0], 1 - ROBOT.radius, last.pose[1, 0]], abs=1e-3
    )
    assert last.pose[1, 0] > 2.0


def test_a_robot_does_what_it_would_do_without_the_others(make_setup, start_at):
    spec, rng = make_setup("loop", "maze", beams=9), np.random.default_rng(0)
    worlds = rng.integers(2, size=200)
    start = start_at(spec, np.stack([spec.worlds[k].random_poses(rng, 1, 0.3)[0] for k in worlds]), worlds)
    start.parameters[:] *= rng.uniform(0.8, 1.2, start.parameters.shape)
    commands = rng.uniform(-1, 1, (20, 200, 2))
    together = drive(spec, start, commands)[-1]
    for i in range(0, 200, 20):
        alone = drive(spec, InitialState(start.table[i : i + 1]), commands[:, i : i + 1])[-1]
        np.testing.assert_array_equal(alone.pose[0], together.pose[i])
        np.testing.assert_array_equal(alone.ranges[0], together.ranges[i])


# ---- each robot with parameters of its own


def varied(spec, column, factors):
    """A start in the first world with a parameter times `factors`, one for each robot."""
    start = InitialState.default(spec, len(factors))
    start.parameters[:, column] *= factors
    return start


def test_a_robot_of_half_the_top_speed_drives_half_as_far(make_setup):
    spec = make_setup(OPEN, beams=1)
    readings = drive(spec, varied(spec, MAX_SPEED, [1.0, 0.5]), [np.full((2, 2), (5.0, 0.0))] * 100)
    assert readings[-1].twist[:, 0] == pytest.approx([ROBOT.max_speed, ROBOT.max_speed / 2])
    whole, half = readings[-1].pose[:, 0] - readings[5].pose[:, 0]
    assert half == pytest.approx(whole / 2)


def test_a_robot_of_half_the_acceleration_is_half_as_fast_at_first(make_setup):
    spec = make_setup(OPEN, beams=1)
    weak, own = drive(spec, varied(spec, WHEEL_ACCELERATION, [0.5, 1.0]), [[(0.65, 0.65)] * 2])[-1].twist
    assert weak[0] < 0.55 * own[0]


def test_a_larger_robot_stops_farther_from_the_wall(make_setup):
    spec, factors = make_setup(ONE_WALL, beams=1), np.array([1.0, 2.0])
    last = drive(spec, varied(spec, RADIUS, factors), [[(0.6, 0.0)] * 2] * 20)[-1]
    assert 1.0 - last.pose[:, 0] == pytest.approx(ROBOT.radius * factors, abs=1e-3)


def test_a_robot_with_its_wheels_twice_as_far_apart_turns_half_as_fast_at_first(make_setup):
    spec = make_setup(OPEN, beams=1)
    twin = KinematicSimulator(spec, 2)
    twin.reset(varied(spec, WHEEL_SEPARATION, [1.0, 2.0]), np.random.default_rng(0))
    own, wide = twin.step(np.full((2, 2), (0.0, 9.0)), 0.1).twist[:, 1]
    assert wide == pytest.approx(own / 2)
    assert twin.step(np.full((2, 2), (0.0, 1.0)), 2.0).twist[:, 1] == pytest.approx([1.0, 1.0])


def test_it_says_how_far_each_robot_moved(make_setup):
    spec, rng = make_setup("loop"), np.random.default_rng(0)
    simulation, start = KinematicSimulator(spec, 100), InitialState.default(spec, 100)
    start.pose[:] = spec.worlds[0].random_poses(rng, 100, 0.2)
    before = simulation.reset(start, rng).pose
    for _ in range(5):
        after = simulation.step(rng.uniform(-1, 1, (100, 2)), 0.2).pose
        assert (simulation.travelled == np.hypot(*(after - before)[:, :2].T)).all()
        before = after
