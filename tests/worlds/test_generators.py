"""Generators: solvable worlds, the same ones every time, and harder ones at higher difficulty."""

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.core.values import build
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds.floor import Floor
from tb2rl.worlds.generators import FAMILIES, GENERATORS, GeneratorSettings, generate, solvable

NAMES = [name for name in GENERATORS if name != "mixed"]


def made(generator, purpose="training", **settings):
    settings = build(GeneratorSettings, {"generator": generator, "worlds": 10, **settings}, "test")
    return generate(settings, GENERATORS[generator], purpose)


def bits(worlds):
    """All values of worlds, to compare to the bit."""
    return [(w.boxes.tobytes(), w.posts.tobytes(), w.start, w.goal, w.bounds, w.name) for w in worlds]


@pytest.mark.parametrize(("difficulty", "size"), [(1.0, [10, 6]), (0.0, [4, 4])])
@pytest.mark.parametrize("name", NAMES)
def test_a_robot_gets_from_the_start_to_a_third_of_the_enclosed_floor_and_to_the_goal(name, difficulty, size):
    (world,) = made(name, difficulty=difficulty, size=size, seed=7, worlds=1)
    free = world.free_space(ROBOT.radius)  # exact, and reachable from the start
    assert free.area > size[0] * size[1] / 3
    assert free.covers(shapely.Point(world.goal[:2]))
    x0, y0, x1, y1 = world.free_space(0.0).bounds
    assert min(x0, y0, size[0] - x1, size[1] - y1) >= 0.0, "the wall around is closed"
    floor = Floor.of(world, 1.5)
    assert min(world.clearance(*world.start[:2]), 1.5) == pytest.approx(floor.clearance.max())


@pytest.mark.parametrize("name", NAMES)
def test_there_is_less_room_at_a_higher_difficulty(name):
    easy, hard = (made(name, difficulty=difficulty, worlds=5) for difficulty in (0.0, 1.0))
    room = [np.mean([(Floor.of(world, 1.5).clearance >= 0.3).mean() for world in worlds]) for worlds in (easy, hard)]
    assert room[1] < 0.9 * room[0]


def test_passages_are_as_narrow_as_documented_at_the_highest_difficulty():
    worlds = (made(name, difficulty=1.0, worlds=3) for name in ("rooms", "maze"))
    for rooms, maze in zip(*worlds, strict=True):
        assert rooms.free_space(0.24).area > 20.0
        assert rooms.free_space(0.26).area < 10.0  # one room
        assert maze.free_space(0.59).area > 0.0
        with pytest.raises(InputError, match="no free space"):
            maze.free_space(0.85)  # half of 1.2 m, or at a junction of four the distance to its corners


def test_a_circuit_is_one_ring_with_bends_to_both_sides():
    for world in made("circuit", worlds=10):
        ring = world.free_space(0.35).simplify(0.2)
        assert len(ring.interiors) == 1
        corners = np.array(ring.interiors[0].coords)
        before, after = np.diff(corners, axis=0), np.diff(np.concatenate([corners[1:], corners[1:2]]), axis=0)
        turns = np.sign(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        assert {-1.0, 1.0} <= set(turns.tolist())


def test_cells_are_posts_on_a_grid():
    for difficulty, fewest, most in ((0.0, 10, 150), (1.0, 300, 600)):
        (world,) = made("cells", difficulty=difficulty, worlds=1)
        assert fewest < len(world.posts) < most
        assert (world.posts[:, 2] == 0.075).all()
        steps = (world.posts[:, :2] - world.posts[0, :2]) / 0.15
        np.testing.assert_allclose(steps, steps.round(), atol=1e-6)


def test_a_world_follows_from_its_purpose_seed_and_number_alone():
    """Not from the process either: `test_suites` compares the first worlds of a suite to the bit."""
    worlds = bits(made("mixed", seed=3))
    assert [world[-1].split()[0] for world in worlds] == [maker.__name__ for maker in FAMILIES] * 2, (
        "mixed are five in turns"
    )
    assert worlds[:5] == bits(made("mixed", worlds=5, seed=3))
    kinds = [("training", 0), ("training", 1), ("validation", 0), ("test", 0), ("search", 0), ("suite", 0)]
    worlds = [entry[:2] for purpose, seed in kinds for entry in bits(made("mixed", purpose, seed=seed))]
    assert len(set(worlds)) == len(worlds) == 60, "none for another purpose or seed"


def test_difficulties_are_drawn_from_a_range_and_without_a_path_there_is_an_error():
    asked = []

    def noted(rng, difficulty, size):
        asked.append(difficulty)
        return GENERATORS["clutter"][0](rng, 0.0, size)

    def blocked(rng, difficulty, size):
        return [(size[0] / 2, size[1] / 2, size[0], size[1] - 1.0, 0.0)], []

    generate(GeneratorSettings("noted", worlds=50, difficulty=(0.2, 0.4)), (noted,), "training")
    assert (min(asked), max(asked)) == (pytest.approx(0.225, abs=0.025), pytest.approx(0.375, abs=0.025))
    with pytest.raises(InputError, match=r"8 x 8 m with difficulty 0.50 a robot reaches less than a third"):
        solvable(blocked, np.random.default_rng(0), 0.5, (8.0, 8.0))
