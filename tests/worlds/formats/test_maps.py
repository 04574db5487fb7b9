"""Maps of ROS: the meaning of their cells, and how they are written."""

import math
import os

import numpy as np
import pytest
import shapely
from PIL import Image

from tb2rl.core.errors import InputError, WorldWarning
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.maps import write_map
from tb2rl.worlds.occupancy_grid import merge_cells, occupied_cells
from tb2rl.worlds.registry import find_world, read_world
from tb2rl.worlds.world import World

START = (0.0, 0.0, 0.0)


@pytest.fixture
def read(write, tmp_path):
    """A function that reads a map from the values of its pixels, the top row first."""

    def read_map(pixels, picture="map.pgm", settings="", start=START, **options):
        Image.fromarray(np.array(pixels, dtype=np.uint8)).save(tmp_path / picture)
        text = f"image: {picture}\n{settings}"
        path = write("map.yaml", text if "resolution" in text else f"resolution: 1.0\n{text}")
        return read_world(path, options=ImportOptions(start=start, **options))

    return read_map


def occupied(world, rows, columns):
    """Which cells of 1 m of a map that lies at the origin are obstacles, the top row first."""
    cells = [[world.clearance(x + 0.5, y + 0.5) == 0 for x in range(columns)] for y in range(rows)]
    return np.array(cells)[::-1].astype(int).tolist()


@pytest.mark.parametrize(
    ("settings", "unknown", "expected"),
    [
        # grey      0  88  90 204 206 255 (90: occupancy 0.647; 204: 0.2; 206: 0.192)
        ("", "obstacle", [1, 1, 1, 1, 0, 0]),
        ("", "free", [1, 1, 0, 0, 0, 0]),
        ("negate: 1", "obstacle", [0, 1, 1, 1, 1, 1]),
        ("occupied_thresh: 0.6", "free", [1, 1, 1, 0, 0, 0]),
        ("free_thresh: 0.64", "obstacle", [1, 1, 1, 0, 0, 0]),
        ("mode: raw", "obstacle", [0, 1, 1, 1, 1, 1]),
    ],
)
def test_cells_mean_what_map_server_says(settings, unknown, expected, read):
    world = read([[0, 88, 90, 204, 206, 255], [255] * 6], settings=settings, unknown=unknown)
    assert occupied(world, 2, 6)[0] == expected


@pytest.mark.parametrize(("unknown", "expected"), [("obstacle", [1, 1, 0]), ("free", [1, 0, 0])])
def test_transparent_cells_are_unknown_in_mode_scale(unknown, expected, read):
    pixels = [[[0, 0, 0, 255], [255, 255, 255, 0], [255, 255, 255, 255]]]
    assert occupied(read(pixels, "map.png", "mode: scale", unknown=unknown), 1, 3)[0] == expected


def test_the_top_row_of_the_picture_is_the_highest_and_a_map_turns_about_its_origin(read):
    world = read([[0, 254], [254, 254], [254, 254]], settings="resolution: 0.5\norigin: [10.0, -20.0, 0.0]\n")
    assert (world.bounds, world.obstacles.bounds) == ((10, -20, 11, -18.5), (10, -19, 10.5, -18.5))
    world = read([[254, 254, 254], [254, 254, 0]], settings="origin: [1, 2, 0.5]\n")
    boxes = shapely.box([1, 3], 2, 4, [4, 3])
    whole, cell = (shapely.affinity.rotate(box, 0.5, origin=(1, 2), use_radians=True) for box in boxes)
    assert world.obstacles.symmetric_difference(cell).area < 1e-9
    assert world.bounds == pytest.approx(whole.bounds)


def test_a_map_written_and_read_again_is_the_same(read, tmp_path):
    cells = np.random.default_rng(3).random((40, 60)) < 0.3
    settings = "resolution: 0.05\norigin: [-6.8999999999999915, 3.3, 0.0]\n"
    world = read(np.where(cells[::-1], 0, 254), settings=settings, goal=None)
    path, picture = write_map(world, tmp_path / "again.yaml")
    assert np.array_equal(np.asarray(Image.open(picture)) == 0, cells[::-1])
    again = read_world(path)
    assert again.start == world.start
    assert np.allclose(again.boxes, world.boxes)
    assert write_map(again, tmp_path / "third.pgm")[1].read_bytes() == picture.read_bytes()
    assert (tmp_path / "third.yaml").read_text() == path.read_text().replace("again", "third")


@pytest.mark.parametrize("name", ["maze", "round"])
def test_a_world_written_as_a_map_has_its_walls_within_half_a_cell(name, tmp_path):
    world, side = find_world(name), 0.05
    again = read_world(write_map(world, tmp_path / "map.yaml", side)[0])
    edge = shapely.box(*world.bounds)
    there, then = world.obstacles.intersection(edge), again.obstacles.intersection(edge)
    # The corners of a cell are farther from its middle than half its side, where walls stand askew.
    assert there.hausdorff_distance(then) < side / 2 * (1.001 if name != "round" else math.sqrt(2))
    assert (again.start, again.goal) == (pytest.approx(world.start), pytest.approx(world.goal))


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_no_wall_is_too_thin_for_a_cell(yaw):
    bounds = (0, 0, 2, 2)
    world = World.from_shapes("thin", [(1.013, 1, 1, 0.004, yaw)], [(0.2, 0.2, 0.003)], start=START, bounds=bounds)
    boxes = merge_cells(occupied_cells(world, 0.05), 0.05, (0, 0, 0))
    found = World.from_shapes("cells", boxes, start=START, bounds=bounds).obstacles
    corners = [corner for part in shapely.get_parts(world.obstacles) for corner in part.exterior.coords]
    assert max(found.distance(shapely.Point(corner)) for corner in corners) < 0.03
    assert len(shapely.get_parts(found.buffer(1e-6))) == 2, "the wall has no gap"


def test_a_written_map_has_the_form_of_map_server_and_neither_too_many_cells_nor_dynamic_obstacles(tmp_path):
    for resolution in (math.nan, 1e-4):
        with pytest.raises(InputError, match="more than 4000000 cells"):
            write_map(find_world("maze"), tmp_path / "maze.yaml", resolution)
    assert list(tmp_path.iterdir()) == []
    world = World.from_shapes("hall", start=START, bounds=(-1, -1, 1, 1), dynamic_obstacles={"people": 1})
    with pytest.warns(WorldWarning, match=r"world hall: .* dynamic obstacles are left out"):
        write_map(world, tmp_path / "hall.yaml")
    path, picture = write_map(find_world("maze"), tmp_path / "maze.yaml", 0.1)
    assert picture.read_bytes().startswith(b"P5\n# 0.1 m/pix\n101 101\n255\n")
    assert set(np.unique(np.asarray(Image.open(picture)))) == {0, 254}
    assert path.read_text() == (
        "image: maze.pgm\nmode: trinary\nresolution: 0.1\norigin: [-0.05, -0.05, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\nstart: [1.0, 1.0, 1.5707963]\ngoal: [9.0, 9.0, 0.0]\n"
    )


def test_start_and_goal_are_in_the_file_or_given_and_unknown_keys_are_named(read):
    pixels = np.full((20, 20), 254)
    text = "start: [3, 4, 0.5]\ngoal: [9, 9]\ncost_translation_table: x.yaml\n"
    for start, goal in ((None, None), ((5, 5, 0), (8, 8, 0))):
        with pytest.warns(WorldWarning, match="cost_translation_table"):
            world = read(pixels, settings=text, start=start, goal=goal)
        assert (world.start, world.goal) == (start or (3, 4, 0.5), goal or (9, 9, 0))


def test_a_file_is_read_once_and_again_when_it_or_its_picture_changed(read, tmp_path):
    before = read([[254, 0]])
    assert read_world(tmp_path / "map.yaml", options=ImportOptions(start=START)) is before
    Image.fromarray(np.array([[0, 254]], dtype=np.uint8)).save(tmp_path / "map.pgm")
    os.utime(tmp_path / "map.pgm", ns=(0, 1))  # two writes within a tick of the file system's clock look alike
    after = read_world(tmp_path / "map.yaml", options=ImportOptions(start=START))
    assert (occupied(before, 1, 2), occupied(after, 1, 2)) == ([[0, 1]], [[1, 0]])
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 2.0\n")
    os.utime(tmp_path / "map.yaml", ns=(0, 1))
    assert read_world(tmp_path / "map.yaml", options=ImportOptions(start=START)).bounds == (0, 0, 4, 2)
