"""Worlds: the built-in ones, shapes, free space and random poses."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world, world_names

START = (0.0, 0.0, 0.0)
BOUNDS = (-5.0, -5.0, 5.0, 5.0)


@pytest.mark.parametrize("name", world_names())
def test_every_built_in_world_has_room_at_its_start_and_goal_and_for_random_poses(name):
    world = find_world(name)
    assert world.name == name
    assert world.description
    for x, y, _ in filter(None, (world.start, world.goal)):
        assert world.clearance(x, y) > 0.6
        assert world.free_space(0.6).covers(shapely.Point(x, y))  # and the one can be reached from the other
    poses = world.sample_poses(np.random.default_rng(0).random((300, 4)), 0.6)
    assert min(world.clearance(x, y) for x, y, _ in poses) >= 0.6 - 1e-3  # shapely's circles are polygons


@pytest.mark.parametrize(
    ("name", "bounds", "corridor", "area"),
    [("loop", (-5, -5, 5, 5), 2.5, 12 * 2.5**2), ("circuit", (0, 0, 9, 9), 1.5, 20 * 1.5**2)],
)
def test_the_courses_are_closed_and_as_wide_and_long_as_documented(name, bounds, corridor, area):
    world = find_world(name)
    floor = world.free_space(0.0)
    assert floor.bounds == pytest.approx(bounds)
    assert floor.area == pytest.approx(area, abs=0.1)  # loop: less the pillar where its two islands meet
    assert len(world.free_space(corridor / 2 - 0.01).interiors) == 1  # one ring, wide enough all along
    with pytest.raises(InputError, match="no free space"):
        world.free_space(corridor / 2 + 0.01)


def test_random_poses_are_spread_evenly_over_the_free_space_and_all_headings():
    world, count = find_world("maze"), 5_000
    poses, free = world.sample_poses(np.random.default_rng(0).random((count, 4)), 0.3), world.free_space(0.3)
    for x, y in np.ndindex(2, 2):
        square = shapely.box(5.0 * x, 5.0 * y, 5.0 * x + 5.0, 5.0 * y + 5.0)
        inside = shapely.contains_xy(square, poses[:, 0], poses[:, 1])
        assert inside.mean() == pytest.approx(free.intersection(square).area / free.area, abs=0.025)
    shares, _ = np.histogram(poses[:, 2], bins=8, range=(-math.pi, math.pi))
    assert shares / count == pytest.approx(1 / 8, abs=0.02)
    numbers = np.array([[0.0] * 4, [math.nextafter(1.0, 0.0)] * 4, [0.5] * 4])
    together = world.sample_poses(numbers, 0.3)
    assert (together == np.concatenate([world.sample_poses(row[None], 0.3) for row in numbers])).all()
    assert min(world.clearance(x, y) for x, y, _ in together) >= 0.3 - 1e-3


def test_the_free_space_can_be_reached_from_the_start_and_keeps_off_the_bounds():
    world = World.from_shapes("two rooms", [(1.0, 0.0, 0.2, 12.0, 0.0)], start=START, bounds=BOUNDS)
    assert world.free_space(0.0).bounds == pytest.approx((-5, -5, 0.9, 5))
    assert world.free_space(0.6).bounds == pytest.approx((-4.4, -4.4, 0.3, 4.4))


def test_shapes_become_obstacles_within_bounds():
    boxes, posts = [(2.0, 1.0, 2.0, 0.4, math.radians(30)), (-3.0, 0.0, 1.0, 1.0, 0.0)], [(0.0, 3.0, 0.5)]
    world = World.from_shapes("mine", boxes, posts, start=START)
    turned = shapely.affinity.rotate(shapely.box(1.0, 0.8, 3.0, 1.2), 30)
    expected = shapely.union_all([turned, shapely.box(-3.5, -0.5, -2.5, 0.5), shapely.Point(0, 3).buffer(0.5, 32)])
    assert world.obstacles.symmetric_difference(expected).area == pytest.approx(0, abs=1e-6)
    assert world.bounds == pytest.approx(expected.bounds)
    bounded = world.with_changes(None, None, BOUNDS)
    assert (bounded.bounds, bounded.contains((5, 5)), bounded.contains((0, -5.01))) == (BOUNDS, True, False)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"boxes": [(0, 2, 1, 1)]}, r"box 0 \(the first is 0\) must be 5 numbers, x, .*, yaw; got \(0, 2, 1"),
        ({"boxes": [(0, 2, 1, -0.5, 0)]}, "box 0 .* must have a width above 0, got -0.5"),
        ({"posts": [(-3, 0, 0.5), (2, 2, "wide")]}, "post 1 .* must be 3 numbers, x, y, radius; got"),
        ({"start": (0, 0)}, r"the start must be 3 numbers, x, y, yaw; got \(0, 0\)"),
        ({"bounds": (5, 5, -5, -5)}, "bounds must be x from < x to"),
        ({"posts": [], "bounds": None}, "without obstacles it needs `bounds:"),
        ({"goal": (-3, 0.4, 0)}, r"the goal \(-3, 0\.4\) is inside an obstacle"),
        ({"goal": (5.1, 0, 0)}, r"the goal \(5\.1, 0\) is outside the bounds"),
    ],
)
def test_an_invalid_shape_or_pose_is_named_in_one_line(wrong, words):
    with pytest.raises(InputError, match=f"world mine: {words}") as error:
        World.from_shapes("mine", **{"posts": [(-3, 0, 0.5)], "start": START, "bounds": BOUNDS, **wrong})
    assert "\n" not in str(error.value)


def test_a_start_without_room_is_one_line():
    narrow = World.from_shapes("mine", posts=[(1, 0, 0.9)], start=START, bounds=BOUNDS)
    outside = World.from_shapes("mine", start=START, bounds=(1, 1, 2, 2))
    for world, words in ((narrow, "inside .* nearer than 0.178 m .* no free space"), (outside, "outside the bounds")):
        for check in (world.free_space, world.check_start):
            with pytest.raises(InputError, match=rf"world mine: the start \(0, 0\) is {words}") as error:
                check(ROBOT.radius)
            assert "\n" not in str(error.value)
