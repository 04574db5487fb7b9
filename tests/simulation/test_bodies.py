"""The bodies of the physics: its walls are those that the exact laser sees, and nothing is printed."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.bullet.bodies import connect
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast
from tb2rl.worlds.registry import world_names

BEAM = 1e-3  # [m] half the thickness of a beam: what a ray of single precision may miss at an edge


def ranges_ahead(poses, world):
    """The exact range [m] straight ahead from each of `poses` (num_envs, 3), shape (num_envs,)."""
    ranges = np.empty((len(poses), 1))
    cast(poses, np.ones(1), np.zeros(1), world.boxes, world.posts, ranges)
    return ranges[:, 0]


def assert_rays_fit(simulation, world, poses, angles):
    rays = np.concatenate([simulation.ray_ranges(pose, angles) for pose in poses])
    beams = np.repeat(poses, len(angles), axis=0)
    beams[:, 2] += np.tile(angles, len(poses))
    aside = BEAM * np.column_stack([-np.sin(beams[:, 2]), np.cos(beams[:, 2]), np.zeros(len(beams))])
    exact = np.array([ranges_ahead(beams + side * aside, world) for side in (-1, 0, 1)])
    assert len(rays) == len(poses) * len(angles)
    assert (rays >= exact.min(axis=0) - 1e-3).all()
    assert (rays <= exact.max(axis=0) + 1e-3).all()


@pytest.mark.parametrize("name", world_names())
def test_pybullets_rays_and_the_exact_laser_see_the_same_walls(name, make_setup, make_bullet):
    spec, rng = make_setup(name), np.random.default_rng(0)
    (world,) = spec.worlds
    poses, angles = world.random_poses(rng, 200, 0.05), rng.uniform(-math.pi, math.pi, 50)
    assert_rays_fit(make_bullet(spec), world, poses, angles)


def test_an_episode_in_another_world_has_its_walls_and_no_others(make_setup, make_bullet):
    spec, rng = make_setup("loop", "maze", "round"), np.random.default_rng(0)
    simulation = make_bullet(spec)
    for number in (0, 1, 2, 1, 0):
        world, start = spec.worlds[number], InitialState.default(spec, 1, world=number)
        robot_state = simulation.reset(start, rng)
        assert simulation.world is world
        assert robot_state.pose[0] == pytest.approx(world.start)
        assert_rays_fit(simulation, world, world.random_poses(rng, 20, 0.05), np.linspace(-3, 3, 20))


def field(boxes, posts):
    """So many obstacles on a square grid of 1 m, of random sizes and angles, with room for a robot between them."""
    rng, across = np.random.default_rng(0), math.ceil(math.sqrt(boxes + posts))
    places = [divmod(k, across) for k in rng.permutation(boxes + posts).tolist()]
    return World.from_shapes(
        f"field of {boxes} boxes and {posts} posts",
        [(x, y, *rng.uniform(0.05, 0.3, 2), rng.uniform(-3, 3)) for x, y in places[:boxes]],
        [(x, y, rng.uniform(0.05, 0.2)) for x, y in places[boxes:]],
        start=(0.5, 0.5, 0.0),
    )


@pytest.mark.parametrize("world", [field(16, 0), field(9, 8), field(60, 60)], ids=lambda world: world.name)
def test_no_obstacle_of_many_is_missing_and_all_go_when_the_world_does(world, make_setup, make_bullet):
    spec, rng = make_setup("loop", world, beams=90, max_range=12.0), np.random.default_rng(0)
    simulation = make_bullet(spec)
    bodies = pybullet.getNumBodies(simulation._client)
    for number in (1, 0, 1):
        robot_state = simulation.reset(InitialState.default(spec, 1, world=number), rng)
        poses = spec.worlds[number].random_poses(rng, 60, 0.05)
        assert_rays_fit(simulation, spec.worlds[number], poses, np.linspace(-3, 3, 40))
    twin = KinematicSimulator(spec).reset(InitialState.default(spec, 1, world=1), rng)
    np.testing.assert_allclose(robot_state.ranges, twin.ranges)
    simulation.reset(InitialState.default(spec, 1), rng)
    assert pybullet.getNumBodies(simulation._client) == bodies


def test_the_robot_bumps_into_each_of_many_obstacles_and_not_into_the_floor(make_setup, make_bullet):
    world = field(10, 10)
    spec, rng = make_setup(world, beams=1), np.random.default_rng(0)
    simulation, start = make_bullet(spec), InitialState.default(spec, 1)
    for x, y, *_ in [*world.boxes, *world.posts]:
        start.pose[:] = x - 0.5, y, 0.0
        simulation.reset(start, rng)
        moves = [simulation.step(np.array([[v, 0.0]]), 0.2).bumped[0] for v in (0.0, -0.02, 0.5, 0.5, 0.5, 0.5)]
        assert not any(moves[:2])
        assert any(moves[2:])


def test_every_obstacle_of_many_is_drawn(make_setup, make_bullet, start_at):
    world = field(20, 20)
    spec, rng = make_setup(world, beams=1), np.random.default_rng(0)
    poses = world.random_poses(rng, 30, 0.2)
    simulation, twin = make_bullet(spec), KinematicSimulator(spec, len(poses))
    expected = twin.reset(start_at(spec, poses), rng).look(64, 64)[1]
    seen = [simulation.reset(start_at(spec, [pose]), rng).look(64, 64) for pose in poses]
    drawn = np.concatenate([depth for _, depth in seen])
    with np.errstate(invalid="ignore"):
        assert ((np.abs(drawn - expected) < 0.02) | (np.isinf(drawn) & np.isinf(expected))).mean() > 0.95
    red, green, blue = np.concatenate([colours for colours, _ in seen])[:, 20:34].reshape(-1, 3).T.astype(int)
    assert ((red > green + 20) & (green > blue)).mean() > 0.1  # brick


def test_the_robot_bumps_into_the_walls_of_the_world_it_is_in(make_setup, make_bullet):
    spec, rng = make_setup("wall", "circuit"), np.random.default_rng(0)
    simulation = make_bullet(spec)
    for number in (0, 1):
        start = InitialState.default(spec, 1, world=number)
        start.pose[:] = 0.75, 0.75, math.pi  # the circuit's first bend; open floor in the other
        simulation.reset(start, rng)
        assert simulation.step(np.array([[0.5, 0.0]]), 2.0).bumped[0] == bool(number)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wheel_joints": ("wheel_left", "wheel_rite")}, ["no joint 'wheel_rite'", "it has wheel_right, wheel_left"]),
        ({"urdf": ROBOT.urdf.with_name("missing.urdf")}, ["robot turtlebot2: PyBullet cannot load", "missing.urdf"]),
        ({"wheel_separation": 0.24}, ["wheel_separation is 0.24 m, but 0.23 m in", "turtlebot2.urdf"]),
        ({"wheel_radius": 0.036}, ["wheel_radius is 0.036 m, but 0.035 m in", "turtlebot2.urdf"]),
        (
            {"wheel_joints": ROBOT.wheel_joints[::-1]},
            ["the left wheel (y > 0) and then", "'wheel_right' is at y = -0.115 m, 'wheel_left' at y = 0.115 m"],
        ),
    ],
)
def test_a_robot_that_does_not_fit_its_urdf_is_refused(changed, words, make_setup, make_bullet):
    clients = list(filter(pybullet.isConnected, range(1000)))
    with pytest.raises(InputError) as error:
        make_bullet(make_setup(robot=replace(ROBOT, **changed)))
    for word in words:
        assert word in str(error.value)
    assert list(filter(pybullet.isConnected, range(1000))) == clients


def test_numbers_of_a_robot_may_be_rounded(make_setup, make_bullet):
    make_bullet(make_setup(robot=replace(ROBOT, wheel_separation=0.2305, wheel_radius=0.0351)))


@pytest.mark.parametrize(
    ("shape", "known"), [('cylinder radius="0.05" length="0.02"', True), ('box size="1 1 1"', False)]
)
def test_a_wheel_that_collides_as_a_cylinder_has_a_radius_too_but_a_box_has_none(
    shape, known, make_setup, make_bullet, tmp_path
):
    turned = f'<collision><origin rpy="1.5707963 0 0"/><geometry><{shape}/></geometry></collision>'
    sphere = '<collision><geometry><sphere radius="0.035"/></geometry></collision>'
    (tmp_path / "other.urdf").write_text(ROBOT.urdf.read_text().replace(sphere, turned))
    other = replace(ROBOT, urdf=tmp_path / "other.urdf")
    make_bullet(make_setup(robot=replace(other, wheel_radius=0.05)))
    if known:
        with pytest.raises(InputError, match=r"wheel_radius is 0\.035 m, but 0\.05 m in .*other\.urdf"):
            make_bullet(make_setup(robot=other))
    else:
        make_bullet(make_setup(robot=other))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a display is an environment variable")
def test_a_window_without_a_display_is_refused_with_the_way_out(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="no display; use 'rgb_array'"):
        connect(window=True)


def test_nothing_is_printed_and_nothing_of_the_user_is_lost():
    script = """
import tb2rl
print("before", end=" ")
env = tb2rl.make_env()
env.reset(seed=0)
env.step(0)
env.camera()
env.close()
print("after")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("before after\n", "")
