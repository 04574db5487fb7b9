"""MuJoCo: walls where the laser sees them, many environments, models of worlds, states, copies and the camera."""

import copy
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import robot_names
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, SimulationSpec
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.variation import find_variation
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate
from tb2rl.worlds.registry import find_world, world_names

mujoco = pytest.importorskip("mujoco")

PERIOD = 0.2  # [s]
MAX_DEPTH = 4e-3  # [m]
ROOM = World.from_shapes("room", [(2.0, 0.0, 2.0, 6.0, 0.0)], start=(0.0, 0.0, 0.0), bounds=(-9.0, -9.0, 9.0, 9.0))


@pytest.fixture
def make(open_simulator):
    """A function from a spec and the number of environments to a simulator, which is closed after the test."""
    return lambda spec, num_envs=1: open_simulator("mujoco", spec, num_envs)


@pytest.fixture
def mixed_worlds():
    """Built-in and generated worlds."""
    generated = generate(GeneratorSettings("mixed", worlds=5), GENERATORS["mixed"], "training")
    return (find_world("loop"), find_world("round"), *generated)


def random_states(spec, num_envs, seed=0, clearance=0.3) -> InitialState:
    """Random free poses in the worlds in turn."""
    rng, worlds = np.random.default_rng(seed), np.arange(num_envs) % len(spec.worlds)
    initial_state = InitialState(spec.table[worlds].copy())
    initial_state.pose[:] = spec.sample_poses(worlds, rng.random((num_envs, 4)), clearance)
    initial_state.records["obstacle_seed"] = rng.random(num_envs)
    return initial_state


def random_commands(robot, num_envs, steps=25, seed=1) -> np.ndarray:
    """Commands that last 5 steps each, mostly ahead, shape (steps, num_envs, 2)."""
    limits = (-0.2 * robot.max_speed, -2.0), (robot.max_speed, 2.0)
    return np.random.default_rng(seed).uniform(*limits, (steps // 5, num_envs, 2)).repeat(5, axis=0)


def drive(simulation, initial_state, commands) -> list[dict]:
    """The states of a drive."""
    simulation.reset(InitialState(initial_state.table.copy()), np.random.default_rng(0))
    return [simulation.step(command, PERIOD).state() for command in commands]


@pytest.mark.parametrize("name", world_names())
def test_rays_of_mujoco_and_the_exact_laser_hit_the_same_walls(name, make_spec, make):
    spec, rng = make_spec(name, beams=90, max_range=40.0), np.random.default_rng(0)
    simulation, initial_state = make(spec, 50), random_states(spec, 50, clearance=0.05)
    ranges = simulation.reset(initial_state, rng).ranges
    model = simulation._bodies[0].models.coarse
    data, errors = mujoco.MjData(model), []
    mujoco.mj_kinematics(model, data)
    walls = np.array([1, 0, 0, 0, 0, 0], np.uint8)  # the robot is in another group
    for (x, y, yaw), row in zip(initial_state.pose, ranges, strict=True):
        for angle, measured in zip(spec.laser.angles + yaw, row, strict=True):
            direction, hit = np.array([math.cos(angle), math.sin(angle), 0.0]), np.zeros(1, np.int32)
            ray = mujoco.mj_ray(model, data, np.array([x, y, 0.2]), direction, walls, 1, -1, hit)
            expected = max(ray, spec.laser.min_range) if 0.0 <= ray < 40.0 else math.inf
            errors.append(0.0 if expected == measured else abs(expected - measured))
    assert np.mean(np.array(errors) > 1e-6) < 1e-3, "but for beams that graze an edge"


@pytest.mark.parametrize("robot_name", robot_names())
def test_no_robot_enters_a_wall_or_passes_through(robot_name, mixed_worlds, make, monkeypatch):
    """Each physics step is checked, not only the ends of control steps."""
    robot = find_robot(robot_name)
    spec = SimulationSpec(robot, replace(robot.laser, beams=1), mixed_worlds)
    simulation, initial_state = make(spec, 70), random_states(spec, 70, clearance=robot.radius + 0.01)
    gaps, gap_to_walls = [], type(simulation)._gap_to_walls
    monkeypatch.setattr(
        type(simulation), "_gap_to_walls", lambda *arguments: gaps.append(gap_to_walls(*arguments)) or gaps[-1]
    )
    states = drive(simulation, initial_state, 1.1 * random_commands(robot, 70, steps=60))
    assert min(gaps) > -MAX_DEPTH
    assert sum(state["bumped"].sum() for state in states) > 50
    for before, after in pairwise(states):
        travelled = np.hypot(*(after["pose"] - before["pose"]).T[:2])
        assert (travelled < 1.05 * robot.max_speed * PERIOD).all()


def test_each_environment_drives_as_it_would_alone(mixed_worlds, make):
    groups = parse_dynamic_obstacles([{"people": 2, "boxes": 1, "presence": 0.7}], "dynamic_obstacles")
    spec = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9), mixed_worlds, dynamic_obstacles=groups)
    initial_state, commands = random_states(spec, 14), random_commands(ROBOT, 14)
    find_variation("strong").vary(initial_state, np_source(14))
    initial_state.records["laser_noise"] = initial_state.records["dropped"] = 0.0
    together, bumps = drive(make(spec, 14), initial_state, commands), 0
    for i in range(14):
        alone = drive(make(spec), InitialState(initial_state.table[[i]]), commands[:, [i]])
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_equal(one, {name: rows[[i]] for name, rows in all_of_them.items()})
            bumps += one["bumped"][0]
    assert bumps > 20


def np_source(num_envs):
    """Source of random numbers of variations."""
    from tb2rl.simulation.random_streams import GeneratorSource

    return GeneratorSource(np.random.default_rng(2), num_envs)


def test_a_reset_of_some_leaves_the_others_alone_and_brings_other_worlds_and_robots(mixed_worlds, make):
    spec = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9), mixed_worlds)
    initial_state, commands = random_states(spec, 4), random_commands(ROBOT, 4, steps=30)
    expected, simulation = drive(make(spec, 4), initial_state, commands), make(spec, 4)
    simulation.reset(InitialState(initial_state.table.copy()), np.random.default_rng(0))
    for step, command in enumerate(commands):
        robot_state = simulation.step(command, PERIOD)
        for name in ("pose", "ranges", "odometry"):
            np.testing.assert_array_equal(getattr(robot_state, name)[[0, 2]], expected[step][name][[0, 2]])
        if step % 5 == 4:
            fresh = random_states(spec, 7, seed=step)
            fresh = InitialState(fresh.table[[step % 7, (step + 3) % 7]])
            fresh.records["mass"][0] = 1.5
            robot_state, first = simulation.reset_at(np.array([1, 3]), fresh)
            np.testing.assert_array_equal(first.pose, fresh.pose)
            np.testing.assert_array_equal(robot_state.ranges[[1, 3]], first.ranges)
            alone = KinematicSimulator(spec, 2).reset(fresh, np.random.default_rng(0))
            np.testing.assert_allclose(first.ranges, alone.ranges)


def test_inactive_environments_stay_where_they_are(make_spec, make):
    simulation, inactive = make(make_spec("loop", beams=9), 4), np.array([True, False, True, False])
    before = simulation.reset(random_states(simulation.spec, 4), np.random.default_rng(0)).pose
    after = simulation.step(np.full((4, 2), 0.5), PERIOD, inactive).pose
    np.testing.assert_array_equal((after == before).all(axis=1), inactive)


_CONTINUE = """
import pickle, sys
simulation, state, commands = pickle.load(sys.stdin.buffer)
from tb2rl.simulation import find_simulator
if state is not None:
    simulation = find_simulator("mujoco").open(simulation, len(state["pose"]))
    simulation.restore(state)
pickle.dump([simulation.step(command, 0.2).state() for command in commands], sys.stdout.buffer)
"""


@pytest.mark.parametrize("elsewhere", [False, True], ids=["here", "in another process"])
def test_a_restored_state_and_copies_go_on_to_the_bit(elsewhere, mixed_worlds, make):
    groups = parse_dynamic_obstacles([{"people": 3}], "dynamic_obstacles")
    spec = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9, noise=0.01), mixed_worlds, dynamic_obstacles=groups)
    simulation, initial_state = make(spec, 100), random_states(spec, 100)
    find_variation("strong").vary(initial_state, np_source(100))
    drive(simulation, initial_state, random_commands(ROBOT, 100))
    state, commands = simulation.state(), random_commands(ROBOT, 100, seed=3)
    copied = copy.deepcopy(simulation)
    if elsewhere:
        from_state, unpickled = (
            pickle.loads(
                subprocess.run(
                    [sys.executable, "-c", _CONTINUE], input=pickle.dumps(work), capture_output=True, check=True
                ).stdout
            )
            for work in ((spec, state, commands), (simulation, None, commands))
        )
        drives = [from_state, unpickled]
    else:
        restored = make(spec, 100)
        restored.restore(copy.deepcopy(state))
        drives = [[each.step(command, PERIOD).state() for command in commands] for each in (restored, copied)]
    expected = [simulation.step(command, PERIOD).state() for command in commands]
    for states in drives:
        np.testing.assert_equal(states, expected)
    assert sum(state["bumped"].sum() for state in expected) > 50


@pytest.mark.parametrize("name", ["joints", "rates", "warm_start"])
def test_an_impossible_motion_is_refused(name, make_spec, make):
    simulation = make(make_spec("loop", beams=9))
    state = simulation.state()
    for value in (np.nan, np.inf, 1e9):
        state[name][0, 1] = value
        with pytest.raises(ValueError, match="the motion of a robot must be below"):
            simulation.restore(state)


def test_another_control_period_has_time_steps_that_fit(make_spec, make):
    simulation = make(make_spec(ROOM, beams=9))
    poses = []
    for period, steps in ((0.03, 10), (0.3, 1), (0.1, 3)):
        simulation.reset(InitialState.default(simulation.spec, 1), np.random.default_rng(0))
        for _ in range(steps):
            robot_state = simulation.step(np.array([[0.4, 0.5]]), period)
        poses.append(robot_state.pose[0])
    np.testing.assert_allclose(poses, [poses[0]] * 3, atol=2e-3)


def test_few_models_are_kept(mixed_worlds, make, monkeypatch):
    monkeypatch.setattr("tb2rl.simulation.mujoco.simulator._MAX_MODELS", 3)
    spec = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9), mixed_worlds)
    initial_state, commands = random_states(spec, 14), random_commands(ROBOT, 14)
    simulation = make(spec, 14)
    states = drive(simulation, initial_state, commands)
    assert len(simulation._models) == 3
    monkeypatch.undo()
    np.testing.assert_equal(states, drive(make(spec, 14), initial_state, commands))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wheel_joints": ("wheel_left", "wheel_rite")}, ["no joint 'wheel_rite'", "it has wheel_left, wheel_right"]),
        ({"urdf": ROBOT.urdf.with_name("missing.urdf")}, ["robot turtlebot2: MuJoCo cannot load", "missing.urdf"]),
        ({"wheel_separation": 0.24}, ["wheel_separation is 0.24 m, but 0.23 m in", "turtlebot2.urdf"]),
        ({"wheel_radius": 0.036}, ["wheel_radius is 0.036 m, but 0.035 m in", "turtlebot2.urdf"]),
        ({"wheel_joints": ROBOT.wheel_joints[::-1]}, ["the left wheel (y > 0) and the right wheel"]),
    ],
)
def test_a_robot_that_does_not_fit_its_urdf_is_refused(changed, words, make_spec, make):
    with pytest.raises(InputError) as error:
        make(make_spec(robot=replace(ROBOT, **changed)))
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_another_radius_is_refused(make_spec, make, start_at):
    spec = make_spec("loop")
    with pytest.raises(InputError, match="MuJoCo cannot change the robot's radius"):
        make(spec).reset(start_at(spec, radius=0.3), np.random.default_rng(0))


# ---- camera


def test_the_camera_sees_walls_and_obstacles_where_the_kinematic_one_does(make_spec, make, begin):
    groups = parse_dynamic_obstacles([{"posts": 6}, {"boxes": 4}], "dynamic_obstacles")
    spec = replace(make_spec("loop", "round", beams=9), dynamic_obstacles=groups)
    initial_state, simulation = random_states(spec, 20), make(spec, 20)
    colours, depth = begin(simulation, initial_state).render_camera(64, 48)
    assert (colours.shape, colours.dtype, depth.shape, depth.dtype) == ((20, 48, 64, 3), "u1", (20, 48, 64), "f4")
    expected = begin(KinematicSimulator(spec, 20), initial_state).render_camera(64, 48)[1]
    with np.errstate(invalid="ignore"):  # the pixels of the kinematic camera are half a pixel aside
        fits = (np.abs(depth / expected - 1.0) < 0.1) | (np.isinf(depth) & np.isinf(expected))
    assert fits.mean() > 0.95
    some = simulation.reset_at(np.array([3, 7]), InitialState(initial_state.table[[0, 1]]))[1].render_camera(64, 48)
    np.testing.assert_array_equal(some[0], colours[:2])


def test_without_opengl_the_message_is_one_line(make_spec, make, begin, monkeypatch):
    def fail(*_):
        raise ImportError("no library\nEGL")

    monkeypatch.setattr("tb2rl.simulation.mujoco.camera._make_context", fail)
    robot_state = begin(make(make_spec("loop", beams=9)))
    with pytest.raises(InputError, match=r"camera needs OpenGL, which fails here \(ImportError: no library EGL\)") as e:
        robot_state.render_camera(8, 6)
    assert "\n" not in str(e.value)


def test_an_optimiser_can_be_made_after_an_image():
    """PyTorch then imports triton, if it is installed, whose LLVM clashes with that of OpenGL."""
    code = """
import tb2rl, torch
env = tb2rl.make_env(simulation="mujoco")
env.reset()
try:
    env.robot_state.render_camera(16, 12)
except tb2rl.InputError:  # no OpenGL
    pass
torch.optim.Adam([torch.zeros(1, requires_grad=True)])
"""
    subprocess.run([sys.executable, "-c", code], check=True)
