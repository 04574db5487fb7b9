"""The exact laser, by cases worked out by hand; PyBullet's rays see the same in `tests/simulation/test_bodies.py`."""

import math

import numpy as np
import pytest

from tb2rl.worlds.geometry import cast, clearance_one, limit_ranges, shortest
from tb2rl.worlds.index import index_of
from tb2rl.worlds.registry import find_world

AHEAD, LEFT, BEHIND, RIGHT = 0.0, math.pi / 2, math.pi, -math.pi / 2


def table(rows, columns):
    return np.array(rows, dtype=float).reshape(-1, columns)


def box(x, y, length, width, yaw=0.0):
    return (x, y, length / 2, width / 2, math.cos(yaw), math.sin(yaw))


def look(poses, angles, boxes=(), posts=()):
    """Ranges [m] from poses (num_envs, 3) along angles (beams,), shape (num_envs, beams)."""
    poses, angles = table(poses, 3), np.array(angles, dtype=float)
    ranges = np.empty((len(poses), len(angles)))
    cast(poses, np.cos(angles), np.sin(angles), table(boxes, 6), table(posts, 3), ranges)
    return ranges


def look_from_origin(angles, boxes=(), posts=()):
    return look((0.0, 0.0, 0.0), angles, boxes, posts)[0]


def test_the_shortest_of_many_beams_is_the_clearance():
    world = find_world("circuit")
    poses = world.random_poses(np.random.default_rng(1), 100, 0.2)
    nearest = look(poses, np.linspace(-math.pi, math.pi, 3600), world.boxes, world.posts).min(axis=1)
    clearances = np.array([world.clearance(x, y) for x, y, _ in poses])
    assert (nearest >= clearances - 1e-9).all()
    assert (nearest <= clearances * (1 + math.radians(0.1)) + 1e-9).all()  # the nearest corner is between two beams


def test_a_box_is_seen_from_the_turned_robot_where_it_is_and_only_there():
    assert look_from_origin([AHEAD, LEFT, BEHIND, RIGHT], [box(2, 0, 1, 1)]).tolist() == [1.5, np.inf, np.inf, np.inf]
    assert look((1.0, 1.0, LEFT), [RIGHT, AHEAD], [box(3, 1, 2, 2)])[0] == pytest.approx([1.0, np.inf])
    assert (look_from_origin([AHEAD, LEFT]) == np.inf).all(), "without obstacles"


@pytest.mark.parametrize("degrees", [-15, 0, 10])
def test_the_faces_of_a_box_turned_by_45_degrees_are_where_they_should_be(degrees):
    corner, angle = 2 - math.sqrt(0.5), math.radians(degrees)  # the faces rise from the corner at 45 degrees
    expected = corner / (math.cos(angle) - math.sin(abs(angle)))
    assert look_from_origin([angle], [box(2, 0, 1, 1, math.pi / 4)]) == pytest.approx([expected])


@pytest.mark.parametrize(("aside", "expected"), [(0.0, 1.5), (0.3, 1.6), (-0.3, 1.6), (0.499, 1.9684), (0.501, np.inf)])
def test_a_post_is_round(aside, expected):
    assert look_from_origin([AHEAD], posts=[(2, aside, 0.5)]) == pytest.approx([expected], abs=1e-4)


@pytest.mark.parametrize(("y", "expected"), [(0.4999, np.inf), (0.5001, 1.0), (1.4999, 1.0), (1.5001, np.inf)])
def test_a_beam_parallel_to_a_side_hits_or_misses(y, expected):
    boxes, turned = [box(2, 1, 2, 1)], [box(2, 1, 1, 2, math.pi / 2)]
    for obstacles in (boxes, turned):
        assert look((0.0, y, 0.0), [AHEAD, BEHIND], obstacles)[0] == pytest.approx([expected, np.inf])
        assert look((4.0, y, math.pi), [AHEAD, BEHIND], obstacles)[0] == pytest.approx([expected, np.inf])


def test_each_robot_sees_the_nearest_of_all_obstacles():
    boxes = [box(2, 0, 2, 0.2, 0.6), box(2, 1, 2, 0.2, -0.6), box(-1, 0, 1, 1, -0.6), box(0, -3, 1, 5)]
    posts, angles = [(0, 2, 0.5), (3, 3, 1)], np.linspace(-math.pi, math.pi, 500)
    poses = [(0, 0, 0), (0, 1, 0.5), (4, 0, 3)]
    alone = [*(look(poses, angles, boxes=[row]) for row in boxes), *(look(poses, angles, posts=[row]) for row in posts)]
    together = look(poses, angles, boxes, posts)
    assert (together == np.min(alone, axis=0)).all()
    assert (together == np.concatenate([look(pose, angles, boxes, posts) for pose in poses])).all()


def test_ranges_are_limited_and_their_minimum_is_found():
    ranges = np.array([[-0.1, 0.05, 0.1, 1.0, 30.0, 30.1, np.inf]])
    limit_ranges(ranges, 0, 0.1, 30.0)
    assert ranges.tolist() == [[0.1, 0.1, 0.1, 1.0, 30.0, np.inf, np.inf]]
    assert shortest(np.array([[2.0, 1.0, np.inf], [np.inf] * 3, [0.3, 4.0, 0.2]])).tolist() == [1, np.inf, 0.2]


@pytest.mark.parametrize(
    ("point", "boxes", "posts", "expected"),
    [
        ((0, 0), [box(2, 0, 1, 1)], [], 1.5),  # a side
        ((0, 0), [box(3.5, 4.5, 1, 1)], [], 5.0),  # a corner at (3, 4)
        ((0, 0), [box(2, 0, 1, 1, math.pi / 4)], [], 2 - math.sqrt(0.5)),  # a corner of a turned box
        ((0, 0), [box(0.1, 0.2, 1, 1)], [], 0.0),  # inside
        ((0, 0), [], [(3, 4, 1.5)], 3.5),
        ((3, 3), [], [(3, 4, 1.5)], 0.0),
        ((0, 0), [box(2, 0, 1, 1)], [(0, -2, 1)], 1.0),  # the nearer of two
        ((0, 0), [], [], np.inf),
    ],
)
def test_the_clearance_is_the_distance_to_the_nearest_obstacle(point, boxes, posts, expected):
    for grid_above in (0, 9):  # with a grid, and without one
        index = index_of(table(boxes, 6), table(posts, 3), grid_above)
        assert clearance_one(*map(float, point), *index, 0) == pytest.approx(expected)
