"""The exact laser, by cases worked out by hand; PyBullet's rays see the same in `tests/simulation/test_bodies.py`."""

import math

import numpy as np
import pytest

from tb2rl.worlds.geometry import cast_many, clearance_at, limit_ranges, shortest_ranges
from tb2rl.worlds.spatial_index import build_index

AHEAD, LEFT, BEHIND, RIGHT = 0.0, math.pi / 2, math.pi, -math.pi / 2
ORIGIN = (0.0, 0.0, 0.0)


def table(rows, columns):
    return np.array(rows, dtype=float).reshape(-1, columns)


def box(x, y, length, width, yaw=0.0):
    return (x, y, length / 2, width / 2, math.cos(yaw), math.sin(yaw))


def look(poses, angles, boxes=(), posts=()):
    """Ranges [m] from poses (num_envs, 3) along angles (beams,), shape (num_envs, beams)."""
    poses, angles = table(poses, 3), np.array(angles, dtype=float)
    ranges = np.empty((len(poses), len(angles)))
    index = build_index(table(boxes, 6), table(posts, 3))
    cast_many(poses, np.zeros(len(poses)), (np.cos(angles), np.sin(angles)), index, ranges)
    return ranges


def test_a_box_is_seen_by_a_turned_robot_where_it_is():
    assert look(ORIGIN, [AHEAD, LEFT, BEHIND, RIGHT], [box(2, 0, 1, 1)])[0].tolist() == [1.5, np.inf, np.inf, np.inf]
    assert look((1.0, 1.0, LEFT), [RIGHT, AHEAD], [box(3, 1, 2, 2)])[0] == pytest.approx([1.0, np.inf])
    assert (look(ORIGIN, [AHEAD, LEFT]) == np.inf).all(), "without obstacles"


@pytest.mark.parametrize(("aside", "expected"), [(0.0, 1.5), (0.3, 1.6), (-0.3, 1.6), (0.499, 1.9684), (0.501, np.inf)])
def test_a_post_is_round(aside, expected):
    assert look(ORIGIN, [AHEAD], posts=[(2, aside, 0.5)])[0] == pytest.approx([expected], abs=1e-4)


@pytest.mark.parametrize(("y", "expected"), [(0.4999, np.inf), (0.5001, 1.0), (1.4999, 1.0), (1.5001, np.inf)])
def test_a_beam_parallel_to_a_side_hits_or_misses(y, expected):
    for obstacle in (box(2, 1, 2, 1), box(2, 1, 1, 2, math.pi / 2)):
        assert look((0.0, y, 0.0), [AHEAD, BEHIND], [obstacle])[0] == pytest.approx([expected, np.inf])


def test_each_environment_sees_the_nearest_of_all_obstacles():
    boxes, posts = [box(2, 0, 2, 0.2, 0.6), box(2, 1, 2, 0.2, -0.6), box(0, -3, 1, 5)], [(0, 2, 0.5), (3, 3, 1)]
    poses, angles = [(0, 0, 0), (0, 1, 0.5), (4, 0, 3)], np.linspace(-math.pi, math.pi, 500)
    alone = [*(look(poses, angles, boxes=[row]) for row in boxes), *(look(poses, angles, posts=[row]) for row in posts)]
    assert (look(poses, angles, boxes, posts) == np.min(alone, axis=0)).all()


def test_ranges_are_limited_and_their_minimum_is_found():
    ranges = np.array([[-0.1, 0.05, 0.1, 1.0, 30.0, 30.1, np.inf]])
    assert limit_ranges(ranges, 0, 0.1, 30.0) == 0.1
    assert ranges.tolist() == [[0.1, 0.1, 0.1, 1.0, 30.0, np.inf, np.inf]]
    assert limit_ranges(np.array([[30.1, np.inf]]), 0, 0.1, 30.0) == np.inf
    assert shortest_ranges(np.array([[2.0, 1.0, np.inf], [np.inf] * 3])).tolist() == [1.0, np.inf]


@pytest.mark.parametrize(
    ("point", "boxes", "posts", "expected"),
    [
        ((0, 0), [box(2, 0, 1, 1)], [], 1.5),  # a side
        ((0, 0), [box(3.5, 4.5, 1, 1)], [], 5.0),  # a corner at (3, 4)
        ((0, 0), [box(2, 0, 1, 1, math.pi / 4)], [], 2 - math.sqrt(0.5)),  # a corner of a turned box
        ((0, 0), [box(0.1, 0.2, 1, 1)], [], 0.0),  # inside
        ((0, 0), [], [(3, 4, 1.5)], 3.5),
        ((0, 0), [box(2, 0, 1, 1)], [(0, -2, 1)], 1.0),  # the nearer of two
        ((0, 0), [], [], np.inf),
    ],
)
def test_the_clearance_is_the_distance_to_the_nearest_obstacle(point, boxes, posts, expected):
    for grid_above in (0, 9):  # with a grid, and without one
        index = build_index(table(boxes, 6), table(posts, 3), grid_above)
        assert clearance_at(*map(float, point), index, 0) == pytest.approx(expected)
