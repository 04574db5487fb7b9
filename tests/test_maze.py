"""Mazes: the built-in ones, free space and random poses, drawings, and what a file can get wrong."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tb2rl.errors import InputError
from tb2rl.maze import load_maze, maze_from, maze_names
from tb2rl.robot import BASE_RADIUS

EMPTY = {"start": [0, 0, 0], "bounds": [-5, -5, 5, 5]}
CLOSE = 1e-3  # [m] shapely's circles are polygons


def areas(maze, clearance, cell):
    """The free space of a maze cut into square cells: corner x, y [m] and area [m^2] of each that has some."""
    space = maze.free_space(clearance)
    x0, y0, x1, y1 = space.bounds
    for x in np.arange(x0, x1, cell):
        for y in np.arange(y0, y1, cell):
            area = space.intersection(shapely.box(x, y, x + cell, y + cell)).area
            if area > 0:
                yield x, y, area


# ---- the built-in mazes


@pytest.mark.parametrize("name", maze_names())
def test_every_built_in_maze_has_room_at_its_start_and_goal(name):
    maze = load_maze(name)
    assert maze.description
    for x, y, _ in filter(None, (maze.start, maze.goal)):
        assert maze.clearance(x, y) > 0.6
        assert maze.free_space(0.6).covers(shapely.Point(x, y))  # and the one can be reached from the other


@pytest.mark.parametrize("name", maze_names())
def test_random_poses_keep_their_clearance(name):
    maze = load_maze(name)
    for clearance in (BASE_RADIUS, 0.6):
        poses = maze.random_poses(np.random.default_rng(0), 500, clearance)
        assert poses.shape == (500, 3)
        assert min(maze.clearance(x, y) for x, y, _ in poses) >= clearance - CLOSE
        assert maze.free_space(clearance).buffer(CLOSE).covers(shapely.MultiPoint(poses[:, :2]))


@pytest.mark.parametrize("name", maze_names())
def test_random_poses_are_spread_evenly_over_the_free_space_and_all_headings(name):
    maze, count = load_maze(name), 10_000
    poses = maze.random_poses(np.random.default_rng(0), count, 0.3)
    total, cell = maze.free_space(0.3).area, 2.5
    for x, y, area in areas(maze, 0.3, cell):
        inside = ((poses[:, :2] >= (x, y)) & (poses[:, :2] < (x + cell, y + cell))).all(axis=1)
        assert inside.mean() == pytest.approx(area / total, abs=0.025)
    shares, _ = np.histogram(poses[:, 2], bins=8, range=(-math.pi, math.pi))
    assert shares.sum() == count
    assert shares / count == pytest.approx(1 / 8, abs=0.02)


def test_random_poses_follow_from_the_seed():
    draws = [load_maze("loop").random_poses(np.random.default_rng(seed), 10, 0.6) for seed in (1, 1, 2)]
    assert (draws[0] == draws[1]).all()
    assert (draws[0] != draws[2]).all()


@pytest.mark.parametrize(
    ("name", "bounds", "corridor", "area"),
    [("loop", (-5, -5, 5, 5), 2.5, 12 * 2.5**2), ("circuit", (0, 0, 9, 9), 1.5, 20 * 1.5**2)],
)
def test_the_courses_are_closed_and_as_wide_and_long_as_they_say(name, bounds, corridor, area):
    maze = load_maze(name)
    floor = maze.free_space(0.0)
    assert floor.bounds == pytest.approx(bounds)
    assert floor.area == pytest.approx(area, abs=0.1)  # loop: less the pillar where its two islands meet
    assert len(maze.free_space(corridor / 2 - 0.01).interiors) == 1  # one way round, wide enough all along
    with pytest.raises(InputError, match="no free space"):
        maze.free_space(corridor / 2 + 0.01)


# ---- obstacles


def test_walls_follow_their_path_with_their_thickness_and_filled_corners():
    path = [[-2, -2], [2, -2], [2, 2], [-2, 2]]
    maze = maze_from({**EMPTY, "walls": [{"path": path, "closed": True, "thickness": 0.4}]}, "square")
    ring = shapely.box(-2.2, -2.2, 2.2, 2.2).difference(shapely.box(-1.8, -1.8, 1.8, 1.8))
    assert maze.obstacles.symmetric_difference(ring).area == pytest.approx(0, abs=1e-9)
    opened = maze_from({**EMPTY, "walls": [{"path": path, "thickness": 0.4}]}, "open")
    assert maze.clearance(-2, 0) == 0
    assert opened.clearance(-2, 0) == pytest.approx(1.8)


@pytest.mark.parametrize("degrees", [0, 30, 45, 80, 90, 135, 180, -60, 400])
def test_a_box_is_turned_by_its_yaw(degrees):
    yaw = math.radians(degrees)
    maze = maze_from({**EMPTY, "boxes": [{"centre": [2, 1], "size": [2, 0.4], "yaw": yaw}]}, "box")
    along, across = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    assert maze.clearance(*((2, 1) + 0.99 * along)) == 0
    assert maze.clearance(*((2, 1) + 1.5 * along)) == pytest.approx(0.5)
    assert maze.clearance(*((2, 1) - 0.5 * across)) == pytest.approx(0.3)


def test_free_space_is_only_what_can_be_reached_from_the_start():
    maze = maze_from({**EMPTY, "walls": [{"path": [[1, -6], [1, 6]]}]}, "two rooms")
    assert maze.free_space(0.0).bounds == pytest.approx((-5, -5, 0.9, 5))
    assert maze.random_poses(np.random.default_rng(0), 200, 0.2)[:, 0].max() < 0.7


def test_a_random_start_keeps_its_clearance_to_open_bounds_too():
    poses = load_maze("wall").random_poses(np.random.default_rng(0), 500, 0.6)
    assert (poses[:, :2].min(axis=0) >= (-0.4, -2.4)).all()
    assert (poses[:, :2].max(axis=0) <= (5.4, 2.4)).all()


# ---- drawings

DRAWING = """
#####
#S.G#
#...#
#####
"""


def test_a_drawing_has_its_origin_at_the_lower_left_and_its_marks_in_the_middle_of_their_cells():
    maze = maze_from({"drawing": DRAWING, "cell": 0.5}, "drawing")
    assert (maze.start, maze.goal) == ((0.75, 1.25, 0), (1.75, 1.25, 0))
    assert maze.bounds == (0, 0, 2.5, 2)
    assert maze.free_space(0.0).bounds == pytest.approx((0.5, 0.5, 2, 1.5))


def test_equal_runs_of_a_drawing_become_one_box():
    assert len(maze_from({"drawing": DRAWING}, "drawing").boxes) == 4  # a row each below and above, a column each side
    assert len(maze_from({"drawing": "#S..#\n#.###\n#.###\n#####"}, "blocks").boxes) == 4


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.lists(st.text("#.", min_size=1, max_size=8), min_size=1, max_size=6), st.sampled_from([0.5, 1.0]))
def test_every_mark_of_a_drawing_is_a_wall_and_nothing_else_is(lines, cell):
    maze = maze_from({"drawing": "\n".join(["S", *lines]), "cell": cell, "bounds": [0, 0, 9, 9]}, "random")
    for row, line in enumerate(reversed(lines)):
        for column, mark in enumerate(line):
            clearance = maze.clearance((column + 0.5) * cell, (row + 0.5) * cell)
            assert clearance == 0 if mark == "#" else clearance >= cell / 2 - 1e-9
    assert maze.obstacles.area == pytest.approx("".join(lines).count("#") * cell**2)


def test_a_file_of_ones_own_is_loaded_by_its_path(tmp_path):
    text, yaml = tmp_path / "mine.txt", tmp_path / "mine.yaml"
    text.write_text(DRAWING)
    yaml.write_text("start: [1.5, 2.5, 0.0]\nwalls: [{path: [[0, 0], [4, 0], [4, 4], [0, 4]], closed: true}]\n")
    assert load_maze(str(text)).start == (3.0, 5.0, 0)
    assert load_maze(str(yaml)).clearance(1.5, 3.0) == pytest.approx(0.9)


def test_a_file_that_changed_is_read_again(tmp_path):
    file = tmp_path / "mine.txt"
    file.write_text("#S..#")
    before = load_maze(str(file))
    file.write_text("#.S.#")
    assert load_maze(str(file)).start != before.start


# ---- what can go wrong


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"boxes": [{"centre": [1, 1], "size": [1, 1]}]}, ["no start", "start:"]),
        ({"drawing": "#..#"}, ["no start", "an S"]),
        ({**EMPTY, "boxes": [{"centre": [0, 0], "size": [1, 1]}]}, ["start (0, 0)", "inside"]),
        ({**EMPTY, "posts": [{"centre": [1, 0], "radius": 0.9}]}, ["start (0, 0)", "0.178"]),
        ({"drawing": "###\n#S#\n###", "cell": 0.3}, ["no free space"]),
        ({"start": [0, 0, 0], "bounds": [1, 1, 2, 2]}, ["start (0, 0)", "bounds"]),
        ({"start": [0, 0, 0], "bounds": [5, 5, -5, -5]}, ["bounds"]),
        ({"start": [0, 0, 0]}, ["without obstacles", "bounds"]),
        ({**EMPTY, "boxs": []}, ["unknown key", "'boxs'", "did you mean 'boxes'", "walls"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, 1], "sise": 2}]}, ["boxes.0", "sise"]),
        ({**EMPTY, "walls": [{"path": [[3, 3], [4, 4]], "thicknes": 2}]}, ["walls.0", "thicknes"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3]}]}, ["boxes.0.size", "required"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, -1]}]}, ["boxes.0.size.1", "greater than 0", "-1"]),
        ({**EMPTY, "posts": [{"centre": [3, 3], "radius": "wide"}]}, ["posts.0.radius", "number", "'wide'"]),
        ({**EMPTY, "walls": [{"path": [[1, 1]]}]}, ["walls.0.path", "at least 2"]),
        ({**EMPTY, "cell": 0}, ["cell", "greater than 0"]),
        ({**EMPTY, "start": [0, 0]}, ["start.2"]),
        ({**EMPTY, "start": [0, math.nan, 0]}, ["start.1", "finite", "nan"]),
        ({**EMPTY, "bounds": [-5, -5, math.inf, 5]}, ["bounds.2", "finite", "inf"]),
        ({**EMPTY, "boxes": [{"centre": [math.nan, 3], "size": [1, 1]}]}, ["boxes.0.centre.0", "finite", "nan"]),
        (["walls"], ["mapping", "['walls']"]),
        ("walls", ["mapping", "'walls'"]),
    ],
)
def test_a_wrong_maze_is_refused_with_one_clear_line(content, words):
    with pytest.raises(InputError, match="maze mine") as error:
        maze_from(content, "mine")
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_an_unknown_maze_is_refused_with_the_nearest_and_all_known_ones():
    with pytest.raises(InputError, match="unknown maze 'lop'; did you mean 'loop'") as error:
        load_maze("lop")
    for name in maze_names():
        assert name in str(error.value)


@pytest.mark.parametrize("name", ["missing.yaml", "missing.txt", "nowhere/loop"])
def test_a_missing_file_is_named(name):
    with pytest.raises(InputError, match=f"no maze file {name}"):
        load_maze(name)


@pytest.mark.parametrize(
    ("name", "content"), [("bad.yaml", b"walls: [\n  a: b: c\n"), ("bad.yaml", b"\xff\xfe"), ("bad.txt", b"S..\xff#")]
)
def test_a_file_that_cannot_be_read_is_refused_with_one_line_that_names_it(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name) as error:
        load_maze(str(tmp_path / name))
    assert "\n" not in str(error.value)
