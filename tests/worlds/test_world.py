"""Worlds: the built-in ones, shapes, free space and random poses."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world, world_names
from tb2rl.worlds.world import box_shapes, post_shapes
from tb2rl.worlds.world import box_polygons, post_polygons

START = (0.0, 0.0, 0.0)
BOUNDS = (-5.0, -5.0, 5.0, 5.0)
CLOSE = 1e-3  # [m] shapely's circles are polygons


def areas(world, clearance, cell):
    """The free space of a world cut into square cells: corner x, y [m] and area [m^2] of each that has some."""
    space = world.free_space(clearance)
    x0, y0, x1, y1 = space.bounds
    for x in np.arange(x0, x1, cell):
        for y in np.arange(y0, y1, cell):
            area = space.intersection(shapely.box(x, y, x + cell, y + cell)).area
            if area > 0:
                yield x, y, area


# ---- the built-in worlds


@pytest.mark.parametrize("name", world_names())
def test_every_built_in_world_has_room_at_its_start_and_goal(name):
    world = find_world(name)
    assert world.name == name
    assert world.description
    for x, y, _ in filter(None, (world.start, world.goal)):
        assert world.clearance(x, y) > 0.6
        assert world.free_space(0.6).covers(shapely.Point(x, y))  # and the one can be reached from the other


@pytest.mark.parametrize("name", world_names())
def test_random_poses_keep_their_clearance(name):
    world = find_world(name)
    for clearance in (ROBOT.radius, 0.6):
        poses = world.random_poses(np.random.default_rng(0), 500, clearance)
        assert poses.shape == (500, 3)
        assert min(world.clearance(x, y) for x, y, _ in poses) >= clearance - CLOSE
        assert world.free_space(clearance).buffer(CLOSE).covers(shapely.MultiPoint(poses[:, :2]))


@pytest.mark.parametrize("name", world_names())
def test_random_poses_are_spread_evenly_over_the_free_space_and_all_headings(name):
    world, count = find_world(name), 10_000
    poses = world.random_poses(np.random.default_rng(0), count, 0.3)
    total, cell = world.free_space(0.3).area, 2.5
    for x, y, area in areas(world, 0.3, cell):
        inside = ((poses[:, :2] >= (x, y)) & (poses[:, :2] < (x + cell, y + cell))).all(axis=1)
        assert inside.mean() == pytest.approx(area / total, abs=0.025)
    shares, _ = np.histogram(poses[:, 2], bins=8, range=(-math.pi, math.pi))
    assert shares.sum() == count
    assert shares / count == pytest.approx(1 / 8, abs=0.02)


def test_random_poses_follow_from_the_seed():
    draws = [find_world("loop").random_poses(np.random.default_rng(seed), 10, 0.6) for seed in (1, 1, 2)]
    assert (draws[0] == draws[1]).all()
    assert (draws[0] != draws[2]).all()


def test_every_pose_follows_from_four_numbers_of_its_own():
    world, numbers = find_world("maze"), np.random.default_rng(0).random((50, 4))
    together = world.poses_from(numbers, 0.3)
    alone = np.concatenate([world.poses_from(row[None], 0.3) for row in numbers])
    assert (together == alone).all()


@pytest.mark.parametrize("number", [0.0, math.nextafter(1.0, 0.0)])
def test_the_ends_of_the_random_numbers_are_poses_too(number):
    world = find_world("circuit")
    (x, y, yaw) = world.poses_from(np.full((1, 4), number), 0.3)[0]
    assert world.clearance(x, y) >= 0.3 - CLOSE
    assert -math.pi <= yaw <= math.pi


@pytest.mark.parametrize(
    ("name", "bounds", "corridor", "area"),
    [("loop", (-5, -5, 5, 5), 2.5, 12 * 2.5**2), ("circuit", (0, 0, 9, 9), 1.5, 20 * 1.5**2)],
)
def test_the_courses_are_closed_and_as_wide_and_long_as_they_say(name, bounds, corridor, area):
    world = find_world(name)
    floor = world.free_space(0.0)
    assert floor.bounds == pytest.approx(bounds)
    assert floor.area == pytest.approx(area, abs=0.1)  # loop: less the pillar where its two islands meet
    assert len(world.free_space(corridor / 2 - 0.01).interiors) == 1  # one way round, wide enough all along
    with pytest.raises(InputError, match="no free space"):
        world.free_space(corridor / 2 + 0.01)


# ---- a world from shapes


def test_a_world_of_shapes_has_them_as_its_obstacles():
    boxes, posts = [(2.0, 1.0, 2.0, 0.4, math.radians(30)), (-3.0, 0.0, 1.0, 1.0, 0.0)], [(0.0, 3.0, 0.5)]
    world = World.from_shapes("mine", boxes, posts, start=START, bounds=BOUNDS)
    turned = shapely.affinity.rotate(shapely.box(1.0, 0.8, 3.0, 1.2), 30)
    expected = shapely.union_all([turned, shapely.box(-3.5, -0.5, -2.5, 0.5), shapely.Point(0, 3).buffer(0.5, 32)])
    assert world.obstacles.symmetric_difference(expected).area == pytest.approx(0, abs=1e-6)
    assert sum(box.area for box in box_polygons(world.boxes)) == pytest.approx(1.8)
    assert post_polygons(world.posts)[0].area == pytest.approx(math.pi / 4, rel=1e-3)


def test_boxes_of_one_orientation_stand_together_whichever_way_they_were_said():
    quarter = math.pi / 2
    boxes = [(3, 0, 2, 1, 0.0), (0, 3, 2, 1, 0.3), (-3, 0, 2, 1, quarter), (0, -3, 2, 1, 0.3 - quarter)]
    world = World.from_shapes("mine", boxes, start=START)
    assert len({(cos, sin) for *_, cos, sin in world.boxes.round(9).tolist()}) == 2
    assert (np.diff(world.boxes[:, 4].round(9)) != 0).sum() == 1


def test_bounds_are_around_the_obstacles_unless_they_are_said():
    boxes, posts = [(2.0, 0.0, 2.0, 1.0, 0.0)], [(0.0, 3.0, 0.5)]
    assert World.from_shapes("mine", boxes, posts, start=START).bounds == pytest.approx((-0.5, -0.5, 3.0, 3.5))
    assert World.from_shapes("mine", boxes, posts, start=START, bounds=BOUNDS).bounds == BOUNDS


@pytest.mark.parametrize(
    ("point", "within"), [((0, 0), True), ((5, 5), True), ((-5, 0), True), ((5.01, 0), False), ((0, -5.01), False)]
)
def test_a_point_is_within_the_bounds_or_not(point, within):
    assert World.from_shapes("mine", start=START, bounds=BOUNDS).contains(point) == within


@pytest.mark.parametrize(
    ("bounds", "words"), [((5, 5, -5, -5), "bounds must be x from"), (None, "without obstacles it needs `bounds:")]
)
def test_a_world_without_a_rectangle_is_refused(bounds, words):
    with pytest.raises(InputError, match=f"world mine: {words}"):
        World.from_shapes("mine", start=START, bounds=bounds)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            {"boxes": [(0, 2, 1, 1)]},
            r"box 1 \(the first is 0\) must be 5 numbers, x, y, length, width, yaw; got \(0, 2, 1",
        ),
        ({"boxes": [(0, 2, 1, math.nan, 0)]}, "box 1 .* must be 5 numbers"),
        ({"boxes": [(0, 2, 1, -0.5, 0)]}, "box 1 .* must have a width above 0, got -0.5"),
        ({"boxes": [(0, 2, 0, 1, 0)]}, "box 1 .* must have a length above 0, got 0"),
        ({"boxes": [7]}, "box 1 .* must be 5 numbers, .*; got 7"),
        ({"posts": [(2, 2, 0)]}, "post 1 .* must have a radius above 0, got 0"),
        ({"posts": [(2, 2, "wide")]}, "post 1 .* must be 3 numbers, x, y, radius; got"),
        ({"start": (0, 0)}, r"the start must be 3 numbers, x, y, yaw; got \(0, 0\)"),
        ({"start": (0, math.inf, 0)}, "the start must be 3 numbers"),
        ({"bounds": (0, 0, 1)}, "bounds must be 4 numbers, x from, y from, x to, y to; got"),
        ({"bounds": (-5, -5, math.nan, 5)}, "bounds must be 4 numbers"),
        ({"goal": (3, 3)}, "the goal must be 3 numbers, x, y, yaw; got"),
        ({"goal": (0, -1.9, 0)}, r"the goal \(0, -1\.9\) is inside an obstacle"),
        ({"goal": (-3, 0.4, 0)}, r"the goal \(-3, 0\.4\) is inside an obstacle"),
        ({"goal": (5.1, 0, 0)}, r"the goal \(5\.1, 0\) is outside its bounds"),
    ],
)
def test_a_shape_or_a_pose_that_cannot_be_is_refused_by_its_number(wrong, words):
    shapes = {"boxes": [(0, -2, 1, 1, 0)], "posts": [(-3, 0, 0.5)]}
    for kind in shapes:
        shapes[kind] += wrong.pop(kind, [])
    with pytest.raises(InputError, match=f"world mine: {words}") as error:
        World.from_shapes("mine", **{"start": START, "bounds": BOUNDS, **shapes, **wrong})
    assert "\n" not in str(error.value)


# ---- free space


def test_free_space_is_only_what_can_be_reached_from_the_start():
    world = World.from_shapes("two rooms", [(1.0, 0.0, 0.2, 12.0, 0.0)], start=START, bounds=BOUNDS)
    assert world.free_space(0.0).bounds == pytest.approx((-5, -5, 0.9, 5))
    assert world.random_poses(np.random.default_rng(0), 200, 0.2)[:, 0].max() < 0.7


def test_a_random_start_keeps_its_clearance_to_open_bounds_too():
    poses = find_world("wall").random_poses(np.random.default_rng(0), 500, 0.6)
    assert (poses[:, :2].min(axis=0) >= (-0.4, -2.4)).all()
    assert (poses[:, :2].max(axis=0) <= (5.4, 2.4)).all()


@pytest.mark.parametrize(
    ("shapes", "bounds", "words"),
    [
        ({"boxes": [(0, 0, 1, 1, 0)]}, BOUNDS, ["start (0, 0)", "inside"]),
        ({"posts": [(1, 0, 0.9)]}, BOUNDS, ["start (0, 0)", "nearer than 0.178 m", "no free space"]),
        ({}, (1, 1, 2, 2), ["start (0, 0)", "outside its bounds"]),
    ],
)
def test_a_start_without_room_is_refused_with_one_clear_line(shapes, bounds, words):
    world = World.from_shapes("mine", **shapes, start=START, bounds=bounds)
    with pytest.raises(InputError, match="world mine") as error:
        world.free_space(ROBOT.radius)
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)
