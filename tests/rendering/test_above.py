"""Pictures from above show walls, the robot in its size, its beams, path and goal, and all that it can reach."""

import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.above import (
    GOAL_RADIUS,
    HEADER_HEIGHT,
    SIDE,
    Canvas,
    Mark,
    WorldPicture,
    add_header,
    draw_floor_plan,
    make_grid,
    scale_bar,
)
from tb2rl.rendering.colours import BEAM, BODY, FLOOR, FREE, GOAL, NOSE, PATH, WALL, WHEEL
from tb2rl.robots import Laser
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world

# A box at the upper right and a post at the lower left.
SQUARE = World.from_shapes(
    "square", boxes=[(1.0, 0.5, 1.0, 0.5, 0.0)], posts=[(-1.0, -1.0, 0.3)], start=(0, 0, 0), bounds=(-2, -2, 2, 2)
)
ONE_BEAM = Laser(beams=1)
LEFT = TOP = 2.3  # [m] edges of its pictures, with a margin
SCALE = SIDE / 4.6  # [px/m]


def has(picture: np.ndarray, colour: str) -> np.ndarray:
    """The pixels of a colour, up to the smoothing of edges."""
    return np.abs(picture.astype(int) - ImageColor.getrgb(colour)).max(axis=2) < 12


def is_at(picture: np.ndarray, colour: str, x: float, y: float) -> bool:
    return bool(has(picture, colour)[int((TOP - y) * SCALE), int((x + LEFT) * SCALE)])


def points(picture: np.ndarray, colour: str) -> np.ndarray:
    """x, y of all pixels of a colour [m], shape (pixels, 2)."""
    rows, columns = has(picture, colour).nonzero()
    return np.column_stack([(columns + 0.5) / SCALE - LEFT, TOP - (rows + 0.5) / SCALE])


def draw(robot=ROBOT, laser=ONE_BEAM, goal=None, pose=(0.0, 0.0, 0.0), ranges=(0.1,), path=()) -> np.ndarray:
    return WorldPicture(SQUARE, robot, laser, goal).draw(np.array(pose), np.array(ranges), path)


def test_walls_are_at_their_positions():
    picture = Canvas(SQUARE).array()
    assert (picture.shape, picture.dtype) == ((SIDE, SIDE, 3), np.uint8)
    for x, y in [(0.55, 0.3), (1.45, 0.7), (-1.25, -1.0), (-1.0, -0.75)]:
        assert is_at(picture, WALL, x, y), (x, y)
    for x, y in [(0.45, 0.5), (1.0, 0.8), (1.0, -0.5), (-1.25, -0.75), (-2.2, 2.2)]:
        assert is_at(picture, FLOOR, x, y), (x, y)


@pytest.mark.parametrize(("width", "height"), [(3.3, 2.7), (0.9, 100.0)])
def test_sides_are_even_and_the_longer_side_is_fixed(width, height):
    world = World.from_shapes("any", start=(0, 0, 0), bounds=(0.0, 0.0, width, height))
    rows, columns, _ = Canvas(world).array().shape
    assert (rows % 2, columns % 2, max(rows, columns)) == (0, 0, SIDE)
    assert rows / columns == pytest.approx((height + 0.6) / (width + 0.6), rel=0.1)


def test_a_large_robot_has_its_size():
    robot = replace(ROBOT, radius=3 * ROBOT.radius, wheel_separation=3 * ROBOT.wheel_separation)
    picture = draw(robot, pose=(-0.5, -0.2, 0.0))
    (left, low), (right, high) = points(picture, BODY).min(axis=0), points(picture, BODY).max(axis=0)
    assert ((right - left) / 2, (high - low) / 2) == pytest.approx((robot.radius, robot.radius), abs=0.02)
    assert ((left + right) / 2, (low + high) / 2) == pytest.approx((-0.5, -0.2), abs=0.02)
    assert np.ptp(points(picture, WHEEL)[:, 1]) == pytest.approx(robot.wheel_separation + 0.03, abs=0.02)


def test_the_nose_points_ahead():
    x, y = points(draw(pose=(0.0, 0.0, -2.0)), NOSE).mean(axis=0)
    assert math.atan2(y, x) == pytest.approx(-2.0, abs=0.05)
    assert math.hypot(x, y) == pytest.approx(0.47 * ROBOT.radius, abs=0.02)


def test_beams_are_as_long_as_their_ranges_up_to_the_lasers_maximum():
    beams = points(draw(laser=Laser(beams=3, max_range=1.5), pose=(0.0, -0.3, 0.0), ranges=(0.8, math.inf, 1.2)), BEAM)
    ends = beams[:, 1].min(), beams[:, 0].max(), beams[:, 1].max()  # right, ahead, left
    assert ends == pytest.approx((-0.3 - 0.8, 1.5, -0.3 + 1.2), abs=0.03)


def test_the_path_is_drawn_through_its_points():
    path = [(-1.5, 1.5, 0.0), (-0.5, 1.5, 0.0), (-0.5, 1.0, 0.0)]
    for x, y in [(-1.4, 1.5), (-1.0, 1.5), (-0.5, 1.3)]:
        assert is_at(draw(path=path), PATH, x, y)
    assert not len(points(draw(path=path[:1]), PATH)), "a point is not a path yet"


def test_a_goal_has_a_ring_around_it():
    for none in (None, np.full(2, math.nan)):
        assert (draw(goal=none) == draw()).all()
    ring = points(draw(goal=(-1.0, 1.0)), GOAL)
    distances = np.hypot(*(ring[ring[:, 1] > 0.5] - (-1.0, 1.0)).T)  # the nose has the same colour
    assert distances.max() == pytest.approx(GOAL_RADIUS, abs=0.02)
    assert distances.min() > GOAL_RADIUS - 0.03, "the ring is empty"


def test_a_picture_leaves_no_trace_on_the_next_one():
    picture = WorldPicture(SQUARE, ROBOT, ONE_BEAM)
    first = picture.draw(np.zeros(3), np.ones(1), [])
    picture.draw(np.array([-1.0, 1.0, 0.0]), np.ones(1), [np.zeros(3), np.ones(3)])
    assert (picture.draw(np.zeros(3), np.ones(1), []) == first).all()


# ---- plans


def test_a_plan_shows_walls_reachable_space_start_and_goal():
    picture = draw_floor_plan(find_world("maze"), ROBOT)
    for colour, least in ((WALL, 0.02), (FREE, 0.5), (BODY, 5e-4), (GOAL, 1e-4)):
        assert has(picture, colour).mean() > least


@pytest.mark.parametrize(("door", "least", "most"), [(1.0, 0.5, 0.9), (0.2, 0.2, 0.45)])
def test_a_room_behind_a_narrow_door_is_not_reachable(door, least, most):
    side = (4 - door) / 2
    walls = [(4, side / 2, 0.2, side, 0), (4, 4 - side / 2, 0.2, side, 0)]
    world = World.from_shapes("door", walls, start=(2, 2, 0), bounds=(0, 0, 8, 4))
    assert least < has(draw_floor_plan(world, ROBOT), FREE).mean() < most


def test_a_grid_holds_all_plans_and_a_single_one_is_unchanged():
    plan = draw_floor_plan(find_world("loop"), ROBOT)
    assert make_grid([plan], ["loop"]) is plan
    grid = make_grid([plan] * 5, list("abcde"), columns=5)
    assert grid.shape[1] == pytest.approx(5 * grid.shape[0], rel=0.1)
    assert all(has(tile, BODY).any() for tile in np.split(grid, 5, axis=1))


def test_the_scale_bar_is_as_long_as_in_the_picture_and_a_narrow_picture_is_centred_below_its_header():
    assert (scale_bar(SQUARE).label, scale_bar(SQUARE).width) == ("1 m", round(SCALE))
    hall = World.from_shapes("hall", [], start=(0, 0, 0), bounds=(0, 0, 99.4, 99.4))
    assert (scale_bar(hall).label, scale_bar(hall).width) == ("5 m", 32)
    headed = add_header(np.zeros((10, 100, 3), np.uint8), "a title", [Mark("goal", GOAL, "ring")])
    assert headed.shape == (HEADER_HEIGHT + 10, 560, 3)
    assert has(headed[:HEADER_HEIGHT], GOAL).any()
    assert not headed[HEADER_HEIGHT:, 230:330].any()
    assert headed[HEADER_HEIGHT:, :230].min() > 200
