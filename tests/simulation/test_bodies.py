"""PyBullet has the walls that the exact laser sees, and refuses robots that do not fit their URDF files."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many
from tb2rl.worlds.registry import world_names

pybullet = pytest.importorskip("tb2rl.simulation.bullet.client", reason="PyBullet is not installed").pybullet

BEAM = 1e-3  # [m] half the thickness of a beam: what a ray of single precision may miss at an edge


def ranges_ahead(poses, world):
    """The exact range [m] straight ahead from each of `poses` (num_envs, 3), shape (num_envs,)."""
    ranges = np.empty((len(poses), 1))
    cast_many(poses, np.zeros(len(poses)), (np.ones(1), np.zeros(1)), world.spatial_index, ranges)
    return ranges[:, 0]


@pytest.fixture
def assert_rays_fit(ray_ranges):
    """A function that compares PyBullet's rays with exact ranges."""

    def check(simulation, world, poses, angles):
        rays = np.concatenate([ray_ranges(simulation, pose, angles) for pose in poses])
        beams = np.repeat(poses, len(angles), axis=0)
        beams[:, 2] += np.tile(angles, len(poses))
        aside = BEAM * np.column_stack([-np.sin(beams[:, 2]), np.cos(beams[:, 2]), np.zeros(len(beams))])
        exact = np.array([ranges_ahead(beams + side * aside, world) for side in (-1, 0, 1)])
        assert len(rays) == len(poses) * len(angles)
        assert (rays >= exact.min(axis=0) - 1e-3).all()
        assert (rays <= exact.max(axis=0) + 1e-3).all()

    return check


@pytest.mark.parametrize("name", world_names())
def test_the_rays_of_pybullet_and_the_exact_laser_hit_the_same_walls(name, make_spec, make_bullet, assert_rays_fit):
    spec, rng = make_spec(name), np.random.default_rng(0)
    (world,) = spec.worlds
    poses, angles = world.sample_poses(rng.random((50, 4)), 0.05), rng.uniform(-math.pi, math.pi, 30)
    assert_rays_fit(make_bullet(spec), world, poses, angles)


def field(boxes, posts):
    """A world of obstacles on a square grid of 1 m, of random sizes and angles, with room for a robot between them."""
    rng, columns = np.random.default_rng(0), math.ceil(math.sqrt(boxes + posts))
    places = [divmod(k, columns) for k in rng.permutation(boxes + posts).tolist()]
    return World.from_shapes(
        f"field of {boxes} boxes and {posts} posts",
        [(x, y, *rng.uniform(0.05, 0.3, 2), rng.uniform(-3, 3)) for x, y in places[:boxes]],
        [(x, y, rng.uniform(0.05, 0.2)) for x, y in places[boxes:]],
        start=(0.5, 0.5, 0.0),
    )


@pytest.mark.parametrize("world", [field(16, 0), field(60, 60)], ids=lambda world: world.name)
def test_an_episode_in_another_world_has_all_obstacles_of_it_and_no_others(
    world, make_spec, make_bullet, open_simulator, start_at, begin, assert_rays_fit
):
    spec, rng = make_spec("loop", world, beams=90, max_range=12.0), np.random.default_rng(0)
    simulation = make_bullet(spec)
    bodies = pybullet.getNumBodies(simulation._client)
    for number in (1, 0, 1):
        robot_state = begin(simulation, start_at(spec, world=number))
        assert simulation.world is spec.worlds[number]
        assert robot_state.pose[0] == pytest.approx(spec.worlds[number].start)
        poses = spec.worlds[number].sample_poses(rng.random((30, 4)), 0.05)
        assert_rays_fit(simulation, spec.worlds[number], poses, np.linspace(-3, 3, 40))
    kinematic = begin(open_simulator("kinematic", spec), start_at(spec, world=1))
    np.testing.assert_allclose(robot_state.ranges, kinematic.ranges)
    begin(simulation)
    assert pybullet.getNumBodies(simulation._client) == bodies


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wheel_joints": ("wheel_left", "wheel_rite")}, ["no joint 'wheel_rite'", "it has wheel_right, wheel_left"]),
        ({"urdf": ROBOT.urdf.with_name("missing.urdf")}, ["robot turtlebot2: PyBullet cannot load", "missing.urdf"]),
        ({"wheel_separation": 0.24}, ["wheel_separation is 0.24 m, but 0.23 m in", "turtlebot2.urdf"]),
        ({"wheel_radius": 0.036}, ["wheel_radius is 0.036 m, but 0.035 m in", "turtlebot2.urdf"]),
        (
            {"wheel_joints": ROBOT.wheel_joints[::-1]},
            [
                "the left wheel (y > 0) and the right wheel",
                "'wheel_right' is at y = -0.115 m, 'wheel_left' at y = 0.115 m",
            ],
        ),
    ],
)
def test_a_robot_that_does_not_fit_its_urdf_is_refused(changed, words, make_spec, make_bullet):
    clients = list(filter(pybullet.isConnected, range(1000)))
    with pytest.raises(InputError) as error:
        make_bullet(make_spec(robot=replace(ROBOT, **changed)))
    for word in words:
        assert word in str(error.value)
    assert list(filter(pybullet.isConnected, range(1000))) == clients


def test_numbers_of_a_robot_may_be_rounded(make_spec, make_bullet):
    make_bullet(make_spec(robot=replace(ROBOT, wheel_separation=0.2305, wheel_radius=0.0351)))
