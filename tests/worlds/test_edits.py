"""Walls and posts that a user adds to a world or removes by clicks."""

import numpy as np
import pytest

from tb2rl import InputError
from tb2rl.worlds import World
from tb2rl.worlds.edits import add_post, add_wall, hit_floor, remove_obstacle

START, BOUNDS = (0.0, 0.0, 0.0), (-5.0, -5.0, 5.0, 5.0)


@pytest.fixture
def world() -> World:
    shapes = {"boxes": [(2.0, 0.0, 1.0, 0.2, 0.7)], "posts": [(-2.0, 0.0, 0.3)]}
    people = [{"people": 1}]
    return World.from_shapes(
        "own", **shapes, start=START, goal=(0.0, 3.0, 0.0), bounds=BOUNDS, dynamic_obstacles=people
    )


def test_a_wall_lies_between_its_two_ends(world):
    changed = add_wall(world, (0.0, -2.0), (1.0, -3.0))
    assert len(changed.boxes) == 2
    for point in ((0.0, -2.0), (0.5, -2.5), (1.0, -3.0)):
        assert changed.clearance(*point) == 0.0
        assert world.clearance(*point) > 0.5
    assert changed.clearance(1.0, -2.0) == pytest.approx(np.sqrt(0.5) - 0.05, abs=1e-6)


def test_everything_else_stays(world):
    changed = add_post(world, (0.0, -2.0))
    for name in ("name", "start", "goal", "bounds", "description", "dynamic_obstacles"):
        assert getattr(changed, name) == getattr(world, name)
    assert changed.boxes == pytest.approx(world.boxes)
    assert changed.posts[:1] == pytest.approx(world.posts)


@pytest.mark.parametrize(("x", "left"), [(2.0, (0, 1)), (-2.0, (1, 0))])
def test_a_ray_removes_what_it_hits_first(world, x, left):
    origin = np.array([x, -4.0, 4.0])
    changed = remove_obstacle(world, origin, np.array([x, 0.0, 0.4]) - origin)
    assert (len(changed.boxes), len(changed.posts)) == left


def test_a_ray_to_the_free_floor_removes_nothing(world):
    with pytest.raises(InputError, match="no wall or post"):
        remove_obstacle(world, np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, -1.0]))


def test_a_ray_that_does_not_come_down_hits_no_floor():
    assert hit_floor((0.0, 0.0, 2.0), (1.0, 0.0, -1.0)) == (2.0, 0.0)
    assert hit_floor((0.0, 0.0, 2.0), (1.0, 0.0, 0.1)) is None
    assert hit_floor((0.0, 0.0, -2.0), (1.0, 0.0, -1.0)) is None
