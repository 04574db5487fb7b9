"""A grid gives the same ranges and clearances as testing every obstacle."""

import math

import numpy as np
import pytest

from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many, clearance_at
from tb2rl.worlds.registry import find_world
from tb2rl.worlds.spatial_index import build_index, join_indices

BEAMS = np.cos(np.linspace(-3, 3, 60)), np.sin(np.linspace(-3, 3, 60))


def scattered(rng, boxes=150, posts=150, side=20.0):
    """Boxes at all angles, long walls among them, and posts, that touch and overlap."""
    return World.from_shapes(
        "scattered",
        [(*rng.uniform(0, side, 2), *rng.exponential((1.0, 0.2)) + 0.01, rng.uniform(-4, 4)) for _ in range(boxes)],
        [(*rng.uniform(0, side, 2), rng.exponential(0.2) + 0.01) for _ in range(posts)],
        start=(0.0, 0.0, 0.0),
    )


def cells_of_a_map(rng, size=40, cell=0.25):
    """The full cells of a map: upright boxes that share sides and corners."""
    full = np.argwhere(rng.random((size, size)) < 0.2)
    return World.from_shapes("map", [(x * cell, y * cell, cell, cell, 0.0) for x, y in full], start=(0.0, 0.0, 0.0))


def around(rng):
    """A thick ring of posts, a hundred metres away and of all sizes; and one large enough to be everywhere."""
    angles = rng.uniform(-math.pi, math.pi, 200)
    posts = [(100 * math.cos(a), 100 * math.sin(a), rng.exponential(3.0) + 0.01) for a in angles]
    return World.from_shapes("around", [], [*posts, (0.0, 150.0, 90.0)], start=(0.0, 0.0, 0.0))


def in_a_row(rng):
    """A grid of a single row."""
    return World.from_shapes("row", [(x, 0.0, 0.3, 0.1, 0.0) for x in range(200)], start=(0.0, 1.0, 0.0))


def all_in_one_place(rng):
    """Obstacles of which each covers every cell."""
    return World.from_shapes("heap", [], [(0.0, 0.0, 1.0 + r) for r in rng.random(200)], start=(9.0, 0.0, 0.0))


WORLDS = [scattered, cells_of_a_map, around, in_a_row, all_in_one_place]


def poses_in(world, rng, count):
    """Poses all over a world, in its obstacles, and far outside of it, (count, 3)."""
    low, high = np.array(world.bounds).reshape(2, 2)
    places = rng.uniform(low - 0.1, high + 0.1, (count, 2))
    places[::5] = rng.uniform(low - 300.0, high + 300.0, (len(places[::5]), 2))
    return np.column_stack([places, rng.uniform(-math.pi, math.pi, count)])


def ranges_from(poses, index, beams=BEAMS, world_of=None):
    ranges = np.empty((len(poses), len(beams[0])))
    cast_many(poses, np.zeros(len(poses)) if world_of is None else world_of, beams, index, ranges)
    return ranges


def clearances(poses, index, world=0):
    return np.array([clearance_at(x, y, index, world) for x, y, _ in poses])


@pytest.mark.parametrize("make", WORLDS)
def test_a_grid_finds_what_testing_every_obstacle_finds(make):
    rng = np.random.default_rng(0)
    world = make(rng)
    grid, plain = (build_index(world.boxes, world.posts, grid_above) for grid_above in (0, 10**9))
    assert len(grid.cell_lists) <= 40 * (len(world.boxes) + len(world.posts)), "it stays small where obstacles overlap"
    x0, y0, side, columns, rows = grid.worlds[0, :5]
    lines = np.array([(x0 + side * i, y0 + side * j, 0.0) for i in range(int(columns)) for j in range(int(rows))])
    quarters = np.array([1.0, 0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0, -1.0])  # beams along the lines of the grid
    for poses, beams in ((poses_in(world, rng, 500), BEAMS), (rng.permutation(lines)[:500], quarters)):
        gaps = clearances(poses, plain)
        np.testing.assert_allclose(ranges_from(poses, grid, beams), ranges_from(poses, plain, beams), rtol=0, atol=1e-9)
        np.testing.assert_allclose(clearances(poses, grid), gaps, rtol=0, atol=1e-9)
        assert (ranges_from(poses[gaps == 0.0], grid, beams) == 0.0).all()


def test_each_environment_sees_its_own_world():
    rng = np.random.default_rng(0)
    worlds = [find_world("round"), scattered(rng), find_world("loop"), cells_of_a_map(rng), scattered(rng, 0, 200)]
    index, poses = join_indices([world.spatial_index for world in worlds]), poses_in(worlds[1], rng, 300)
    world_of = rng.integers(len(worlds), size=len(poses)).astype(float)
    ranges = ranges_from(poses, index, world_of=world_of)
    for number, world in enumerate(worlds):
        own = poses[world_of == number]
        assert (ranges[world_of == number] == ranges_from(own, world.spatial_index)).all()
        assert (clearances(own, index, number) == clearances(own, world.spatial_index)).all()
