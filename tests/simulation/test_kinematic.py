"""The kinematic simulator agrees with PyBullet, and each environment drives as it would alone."""

import math
from itertools import product

import numpy as np
import pytest

from tb2rl.core.plugins import robot_names
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.registry import world_names

PERIOD = 0.2  # [s]
OPEN = World.from_shapes("open", start=(0.0, 0.0, 0.0), bounds=(-40.0, -40.0, 40.0, 40.0))
FAST_PAIRS = {("loop", "turtlebot2"), ("wall", "turtlebot3"), ("loop", "jackal")}
ONE_WALL = World.from_shapes("one wall", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def drive(spec, initial_state, commands):
    """The first state and those after each of `commands` (steps, num_envs, 2)."""
    simulation = KinematicSimulator(spec, len(initial_state.table))
    first = simulation.reset(initial_state, np.random.default_rng(0))
    return [first, *(simulation.step(command, PERIOD) for command in np.asarray(commands, dtype=float))]


def poses_in(spec, worlds, rng):
    """A random free pose in each of the worlds, given by their numbers (num_envs,)."""
    return spec.sample_poses(worlds, rng.random((len(worlds), 4)), 0.3)


def exact_ranges(poses, world, laser):
    ranges = np.empty((len(poses), len(laser.angles)))
    directions = np.cos(laser.angles), np.sin(laser.angles)
    cast_many(poses, np.zeros(len(poses)), directions, world.spatial_index, ranges)
    return ranges


# ---- as the robot in PyBullet


@pytest.mark.parametrize(
    ("name", "robot_name"),
    [
        pytest.param(*pair, marks=() if pair in FAST_PAIRS else pytest.mark.slow)
        for pair in product(world_names(), robot_names())
    ],
)
def test_random_commands_end_where_they_do_in_pybullet(name, robot_name, make_spec, make_physics, start_at, begin):
    """Sequences of 5 s in each world, a new command over the robot's whole range at each control step."""
    robot, rng, most = find_robot(robot_name), np.random.default_rng(1), 70
    spec = make_spec(name, robot=robot, beams=2)
    count = most if robot.max_speed < 1.0 else 4 * most  # a fast one has met a wall by then in most of them
    (world,) = spec.worlds
    poses = world.sample_poses(rng.random((count, 4)), 0.6)
    commands = rng.uniform((-robot.max_speed, -2.0), (robot.max_speed, 2.0), (25, count, 2))
    states = drive(spec, start_at(spec, poses), commands)
    clear = np.ones(count, dtype=bool)
    for state in states[1:]:
        clear &= [world.clearance(x, y) > robot.radius + 0.05 for x, y, _ in state.pose]
    physics, ends, clear = make_physics(spec), [], np.flatnonzero(clear)[:most]
    for i in clear:
        begin(physics, start_at(spec, poses[i : i + 1]))
        ends.append([physics.step(command, PERIOD).pose[0] for command in commands[:, i : i + 1]][-1])
    missed = np.array(ends) - states[-1].pose[clear]
    distance, turn = np.hypot(*missed.T[:2]), np.abs(np.remainder(missed[:, 2] + math.pi, math.tau) - math.pi)
    assert len(ends) > 0.75 * most
    assert np.median(distance) < 0.01
    assert np.percentile(distance, 99) < 0.05
    assert math.degrees(np.median(turn)) < 1.0
    assert math.degrees(np.percentile(turn, 99)) < 5.0


# ---- walls


@pytest.mark.parametrize("name", world_names())
def test_no_robot_enters_a_wall(name, make_spec, start_at):
    spec, rng, num_envs = make_spec(name, beams=2), np.random.default_rng(2), 100
    (world,) = spec.worlds
    limits = np.array([ROBOT.max_speed, ROBOT.max_turn_rate])
    fast_turns = rng.uniform(-limits, limits, (1, num_envs, 2))
    commands = np.concatenate([fast_turns, rng.uniform((-limits[0], -1.0), (limits[0], 1.0), (19, num_envs, 2))])
    poses = world.sample_poses(rng.random((num_envs, 4)), ROBOT.radius + 0.01)
    states = drive(spec, start_at(spec, poses), commands.repeat(5, axis=0))
    for state in states:
        assert min(world.clearance(x, y) for x, y, _ in state.pose) > ROBOT.radius - 1e-3
    assert any(state.bumped.any() for state in states)


@pytest.mark.parametrize("yaw", [0.0, -0.9])
def test_a_robot_stops_at_a_wall_and_gets_away_backwards(yaw, make_spec, start_at):
    spec = make_spec(ONE_WALL, beams=3)
    commands = [[(ROBOT.max_speed, 0.0)]] * 20 + [[(-ROBOT.max_speed, 0.0)]] * 5
    states = drive(spec, start_at(spec, [(0.0, 0.0, yaw)]), commands)
    assert states[20].bumped[0]
    assert ONE_WALL.clearance(*states[20].pose[0, :2]) == pytest.approx(ROBOT.radius, abs=1e-3)
    assert not states[-1].bumped[0]
    assert ONE_WALL.clearance(*states[-1].pose[0, :2]) > ROBOT.radius + 0.1


# ---- each environment has a world of its own


@pytest.mark.parametrize("num_envs", [30, 3000], ids=["one thread", "several threads"])
def test_the_laser_measures_the_walls_of_each_environments_world(num_envs, make_spec, start_at):
    spec, rng = make_spec("maze", "round", "wall", beams=9), np.random.default_rng(0)
    worlds = rng.integers(3, size=num_envs)
    states = drive(spec, start_at(spec, poses_in(spec, worlds, rng), worlds), [np.full((num_envs, 2), 0.3)] * 2)
    for number, world in enumerate(spec.worlds):
        here = worlds == number
        assert here.any()
        for state in states:
            exact = exact_ranges(state.pose[here], world, spec.laser)
            np.testing.assert_allclose(state.ranges[here], np.where(exact > 30, np.inf, exact.clip(min=0.1)))


# ---- each robot has parameters of its own


def test_each_robot_has_its_own_parameters(make_spec):
    spec = make_spec(ONE_WALL, beams=1)
    initial_state = InitialState.default(spec, 5)
    factors = {"max_speed": 0.5, "wheel_acceleration": 0.5, "wheel_separation": 2.0, "radius": 2.0}
    for i, (name, factor) in enumerate(factors.items(), 1):
        initial_state.records[name][i] *= factor
    ahead = drive(spec, initial_state, [np.full((5, 2), (5.0, 0.0))] * 25)
    simulation = KinematicSimulator(spec, 5)
    simulation.reset(initial_state, np.random.default_rng(0))
    turning = [simulation.step(np.full((5, 2), (0.0, 9.0)), 0.1).twist[:, 1] for _ in range(20)]
    assert ahead[1].twist[2, 0] < 0.55 * ahead[1].twist[0, 0]
    assert ahead[5].twist[:, 0] == pytest.approx(ROBOT.max_speed * np.array([1.0, 0.5, 1.0, 1.0, 1.0]))
    assert 1.0 - ahead[-1].pose[:, 0] == pytest.approx(ROBOT.radius * np.array([1.0, 1.0, 1.0, 1.0, 2.0]), abs=1e-3)
    assert turning[0][3] == pytest.approx(turning[0][0] / 2)
    assert turning[-1] == pytest.approx(ROBOT.max_turn_rate)


def test_the_travelled_distance_is_that_between_the_poses(make_spec, start_at, begin):
    spec, rng = make_spec("loop"), np.random.default_rng(0)
    simulation = KinematicSimulator(spec, 100)
    before = begin(simulation, start_at(spec, spec.worlds[0].sample_poses(rng.random((100, 4)), 0.2))).pose
    for _ in range(5):
        after = simulation.step(rng.uniform(-1, 1, (100, 2)), 0.2).pose
        assert (simulation.travelled == np.hypot(*(after - before)[:, :2].T)).all()
        before = after
