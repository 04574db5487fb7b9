"""Generators: worlds that a robot can get around in, the same ones every time, harder ones where that is asked."""

from __future__ import annotations

import hashlib
import itertools
import subprocess
import sys

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.core.values import build
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds.floor import SIDE, Floor
from tb2rl.worlds.generators import FAMILIES, GENERATORS, GeneratorSettings, generate, solvable
from tb2rl.worlds.generators.lattice import neighbours, spanning_tree
from tb2rl.worlds.generators.maze import WALL

NAMES = [maker.__name__ for maker in FAMILIES]


def made(generator, purpose="training", **settings):
    settings = {"worlds": 10, **settings}
    return generate(
        build(GeneratorSettings, {"generator": generator, **settings}, "test"), GENERATORS[generator], purpose
    )


def bits(worlds):
    """Everything that a world is, to compare to the bit."""
    return [(w.boxes.tobytes(), w.posts.tobytes(), w.start, w.goal, w.bounds, w.name) for w in worlds]


# ---- every family


@pytest.mark.parametrize("difficulty", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_a_robot_gets_from_the_start_to_a_third_of_the_floor_and_to_the_goal(name, difficulty):
    for world in made(name, difficulty=difficulty, seed=7):
        free = world.free_space(ROBOT.radius)  # exact, and where a robot from the start gets to
        assert free.area > 8.0 * 8.0 / 3
        assert free.covers(shapely.Point(world.goal[:2]))


@pytest.mark.parametrize("name", NAMES)
def test_the_wall_around_is_closed(name):
    for world in made(name, worlds=3):
        outside = world.free_space(0.0).bounds
        assert np.allclose(outside, (0.0, 0.0, 8.0, 8.0), atol=0.6)
        assert outside[0] >= 0.0
        assert outside[2] <= 8.0


@pytest.mark.parametrize("name", NAMES)
def test_a_start_has_all_the_room_there_is(name):
    for world in made(name, worlds=3, difficulty=1.0):
        floor = Floor.of(world, 1.5)
        assert min(world.clearance(*world.start[:2]), 1.5) == pytest.approx(floor.clearance.max())
        assert world.clearance(*world.start[:2]) > 0.55


@pytest.mark.parametrize("name", NAMES)
def test_the_harder_the_less_room(name):
    room = [
        np.mean([(Floor.of(world, 1.5).clearance >= 0.3).mean() for world in made(name, difficulty=difficulty)])
        for difficulty in (0.0, 1.0)
    ]
    assert room[1] < 0.9 * room[0]


@pytest.mark.parametrize("name", NAMES)
def test_a_floor_can_have_another_size(name):
    (world,) = made(name, worlds=1, size=[12.0, 6.0])
    x0, y0, x1, y1 = world.bounds
    assert (x1 - x0, y1 - y0) == pytest.approx((12.2, 6.2))
    assert world.free_space(ROBOT.radius).area > 12.0 * 6.0 / 3
    assert world.free_space(0.0).bounds[2] > 11.0


@pytest.mark.parametrize("difficulty", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("size", [[4.0, 4.0], [4.0, 20.0], [5.7, 4.9]])
@pytest.mark.parametrize("name", NAMES)
def test_the_smallest_floors_have_ways_too(name, size, difficulty):
    assert len(made(name, worlds=3, difficulty=difficulty, size=size)) == 3


# ---- what each promises


def test_doors_of_rooms_are_half_a_metre_wide_at_the_highest_difficulty():
    for world in made("rooms", difficulty=1.0, worlds=5):
        assert world.free_space(0.24).area > 20.0
        assert world.free_space(0.26).area < 10.0  # one room


def test_corridors_of_a_maze_are_as_wide_as_it_says():
    for world in made("maze", difficulty=1.0, worlds=5):
        assert world.free_space(0.59).area > 0.0
        with pytest.raises(InputError, match="no free space"):
            world.free_space(0.85)  # half of 1.2 m, or at a junction of four the way to its corners
    joined = spanning_tree(np.random.default_rng(0), 6, 5)
    assert len(joined) == 6 * 5 - 1
    assert joined <= set(neighbours(6, 5))
    assert pytest.approx(0.16) == WALL


def test_a_circuit_is_one_ring_with_bends_to_both_sides():
    for world in made("circuit", worlds=20):
        ring = world.free_space(0.35).simplify(0.2)
        assert len(ring.interiors) == 1
        corners = np.array(ring.interiors[0].coords)
        before, after = np.diff(corners, axis=0), np.diff(np.concatenate([corners[1:], corners[1:2]]), axis=0)
        turns = np.sign(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        assert {-1.0, 1.0} <= set(turns.tolist())


def test_cells_are_posts_on_a_grid():
    for difficulty, fewest, most in ((0.0, 10, 150), (1.0, 300, 600)):
        for world in made("cells", difficulty=difficulty, worlds=5):
            assert fewest < len(world.posts) < most
            assert (world.posts[:, 2] == 0.075).all()
            steps = (world.posts[:, :2] - world.posts[0, :2]) / 0.15
            np.testing.assert_allclose(steps, steps.round(), atol=1e-6)


def test_clutter_has_posts_and_boxes():
    for world in made("clutter", difficulty=1.0, worlds=5):
        assert len(world.posts) > 10
        assert len(np.unique(world.boxes[:, 4])) > 10  # turned anyhow


def test_mixed_are_all_families_in_equal_shares():
    worlds = made("mixed", worlds=20)
    assert sorted(world.name.split()[0] for world in worlds) == sorted(NAMES * 4)
    assert bits(worlds[:1])[0][:4] == bits(made("clutter", worlds=1))[0][:4]


# ---- seeds


def test_a_world_follows_from_its_purpose_seed_and_number_alone():
    worlds = bits(made("mixed", worlds=10, seed=3))
    assert worlds == bits(made("mixed", worlds=10, seed=3))
    assert worlds[:5] == bits(made("mixed", worlds=5, seed=3))


def test_another_process_makes_the_same_worlds():
    code = (
        "import hashlib, numpy as np; np.random.seed(5); np.random.random(9)\n"
        "from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate\n"
        "worlds = generate(GeneratorSettings('mixed', worlds=10, seed=3), GENERATORS['mixed'], 'test')\n"
        "print(hashlib.sha256(b''.join(w.boxes.tobytes() + w.posts.tobytes() for w in worlds)).hexdigest())\n"
    )
    here = b"".join(w.boxes.tobytes() + w.posts.tobytes() for w in made("mixed", "test", seed=3))
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert there.stdout.strip() == hashlib.sha256(here).hexdigest()


@pytest.mark.parametrize("name", NAMES)
def test_worlds_for_different_purposes_share_nothing(name):
    kinds = [(purpose, seed) for purpose in ("training", "validation", "test") for seed in (0, 1, 2)]
    worlds = {kind: {entry[:2] for entry in bits(made(name, kind[0], seed=kind[1]))} for kind in kinds}
    for one, other in itertools.combinations(kinds, 2):
        assert not worlds[one] & worlds[other], (one, other)


# ---- difficulty


def test_a_range_of_difficulties_is_drawn_from():
    asked = []

    def noted(rng, difficulty, size):
        asked.append(difficulty)
        return GENERATORS["clutter"][0](rng, difficulty, size)

    generate(GeneratorSettings("noted", worlds=50, difficulty=(0.2, 0.4)), (noted,), "training")
    assert 0.2 <= min(asked) < 0.25
    assert 0.35 < max(asked) <= 0.4


def test_a_generator_that_finds_no_way_says_so():
    def blocked(rng, difficulty, size):
        return [(size[0] / 2, size[1] / 2, size[0], size[1] - 1.0, 0.0)], []

    with pytest.raises(InputError, match=r"8 x 8 m with difficulty 0.50 a robot gets to less than a third"):
        solvable(blocked, np.random.default_rng(0), 0.5, (8.0, 8.0))


def test_worlds_without_a_way_are_drawn_again():
    """Walls that leave a quarter of the floor; then with doors too narrow; then with doors that are ways."""
    left = [0.0, 0.3, 0.8]

    def quarters(rng, difficulty, size):
        long = 4.0 - left.pop(0) / 2
        return [(x, y, 0.2, long, 0.0) for x in (2.0, 4.0, 6.0) for y in (long / 2, 8.0 - long / 2)], []

    world = solvable(quarters, np.random.default_rng(0), 1.0, (8.0, 8.0))
    assert left == []
    assert world.free_space(0.3).area > 8.0 * 8.0 / 3


# ---- the floor


def test_the_floor_knows_the_clearance_of_each_square():
    world = made("mixed", worlds=4)[3]
    floor = Floor.of(world, 0.5)
    rows, columns = floor.clearance.shape
    for row, column in itertools.product(range(0, rows, 7), range(0, columns, 7)):
        x, y = floor.middle(row, column)
        x0, y0, x1, y1 = world.bounds
        exact = min(world.clearance(x, y), x - x0, x1 - x, y - y0, y1 - y, 0.5)
        assert floor.clearance[row, column] == pytest.approx(exact)


def test_steps_on_the_floor_lead_around_walls():
    (world,) = made("circuit", worlds=1)
    floor = Floor.of(world, 1.0)
    steps = floor.steps_from(*world.start[:2], 0.3)
    assert (steps == 0).sum() == 1
    row, column = divmod(int(steps.argmax()), steps.shape[1])
    straight = np.hypot(*(np.subtract(floor.middle(row, column), world.start[:2]))) / SIDE
    assert steps.max() > straight
    assert ((steps > 0) <= (floor.clearance >= 0.3)).all()
