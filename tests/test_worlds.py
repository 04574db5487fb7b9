"""The command `python -m tb2rl.worlds`: list, draw, convert and check."""

from __future__ import annotations

import shlex
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tb2rl.commands import worlds
from tb2rl.worlds import World
from tb2rl.worlds.__main__ import main
from tb2rl.worlds.description import write_description
from tb2rl.worlds.generators import FAMILIES
from tb2rl.worlds.registry import find_world, world_names

NARROW = "cell: 0.3\ndrawing: |\n  ###########\n  #....#....#\n  #.S.......#\n  #....#....#\n  ###########\n"
POLE = (
    "<sdf version='1.6'><model name='pole'><link name='l'><collision name='c'><geometry><cylinder><radius>0.2</radius>"
    "<length>1</length></cylinder></geometry></collision></link></model></sdf>"
)


@pytest.fixture
def folder(workdir):
    """A folder to work in, where warnings are shown as they are to users."""
    (workdir / "narrow.yaml").write_text(NARROW)
    (workdir / "pole.sdf").write_text(POLE)
    (workdir / "hall.yaml").write_text("image: 'scan.pgm'\nresolution: 1\nstart: [2, 2, 0]\n")
    (workdir / "scan.pgm").write_bytes(b"P5\n4 4\n255\n" + b"\xfe" * 16)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        yield


def output(line, capsys):
    main(shlex.split(line))
    return capsys.readouterr().out.splitlines()


def test_list_shows_the_worlds_with_their_descriptions(capsys):
    lines = output("list", capsys)
    assert [line.split()[0] for line in lines][: len(world_names())] == world_names()
    assert any("corridors of 2.5 m" in line for line in lines)


def test_draw_makes_a_picture_of_several_worlds(folder, capsys):
    assert output("draw loop maze -o seen.png", capsys) == ["wrote seen.png"]
    picture = np.asarray(Image.open("seen.png"))
    assert min(picture.shape[:2]) >= 300
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3


def test_the_picture_of_a_generator_has_every_family(folder, monkeypatch):
    monkeypatch.setattr(worlds, "make_grid", lambda pictures, titles, columns: drawn.extend(titles) or pictures[0])
    monkeypatch.setattr(worlds, "draw_plan", lambda *_: np.zeros((2, 2, 3), np.uint8))
    drawn: list[str] = []
    main(["draw", "mixed", "-o", "mixed.png"])
    assert {title.split()[0] for title in drawn} == {maker.__name__ for maker in FAMILIES}


def test_check_shows_what_a_robot_can_reach(folder, capsys):
    about, reach, doors, parts = output("check narrow.yaml", capsys)
    assert about == "narrow: 3.3 x 1.5 m, 6 boxes, 0 posts"
    assert reach.startswith("turtlebot2 (0.356 m wide) reaches 48% of the floor, ")
    assert doors.startswith("1 door is narrower than the robot: 0.300 m at (1.6")
    assert "1 part of the floor cannot be reached, behind passages that are too narrow: 1.1 m2" in parts
    assert len(output("check narrow.yaml --robot turtlebot3", capsys)) == 2
    assert output("check maze", capsys)[-1] == "the goal (9.00, 9.00) can be reached"
    assert output("check narrow.yaml --goal 2.5 0.75", capsys)[-1] == "the goal (2.50, 0.75) cannot be reached"


def test_the_width_of_a_door_never_looks_like_that_of_the_robot(folder, capsys):
    boxes = [(1.6, 0.286, 0.1, 0.572, 0.0), (1.6, 1.214, 0.1, 0.572, 0.0)]  # with 0.356 m between them
    world = World.from_shapes("door", boxes, start=(0.7, 0.75, 0.0), bounds=(0.0, 0.0, 3.3, 1.5))
    write_description(world, Path("door.yaml"))
    (line,) = [line for line in output("check door.yaml", capsys) if "narrower" in line]
    assert line.startswith("1 door is narrower than the robot: 0.3559 m (the robot needs 0.3560 m) at (1.6")


def test_a_world_converted_to_yaml_is_the_same_world(folder, capsys):
    assert output("convert maze mine.yaml", capsys) == ["wrote mine.yaml"]
    before, after = find_world("maze"), find_world("mine.yaml")
    assert np.allclose(after.boxes, before.boxes, atol=1e-12)
    assert np.allclose(after.posts, before.posts, atol=1e-12)
    assert (after.start, after.goal) == (before.start, before.goal)
    assert (after.bounds, after.description) == (before.bounds, before.description)


def test_convert_writes_a_ros_map_and_reads_it(folder, capsys):
    assert output("convert maze map.pgm --resolution 0.1", capsys) == ["wrote map.pgm", "wrote map.yaml"]
    with Image.open("map.pgm") as picture:
        assert picture.size == (101, 101)
    assert output("convert map.yaml mine.yaml", capsys) == ["wrote mine.yaml"]
    assert output("convert maze map.pgm", capsys)[0] == "wrote map.pgm", "the same once more"
    assert find_world("mine.yaml").goal == find_world("maze").goal


def test_options_take_precedence_over_the_file_and_omissions_are_one_line(folder, capsys):
    main(shlex.split("check pole.sdf --start 2 0 0 --goal 0 3"))
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "from (2.00, 0.00)" in shown.out
    main(shlex.split("check pole.sdf --start 2 0 0 --laser-height 0.7"))
    expected = "warning: world pole: left out, for they are below the laser (at 0.7 m): pole/c\n"
    assert capsys.readouterr().err == expected
    main(shlex.split("check pole.sdf"))
    err = capsys.readouterr().err
    assert err.startswith("warning: world pole: no start is given, so it is [")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["list | draw | convert | check"]),
        ("drow loop", ["'drow'", "draw"]),
        ("draw lop", ["did you mean 'loop'"]),
        ("draw loop -o seen.h5", ["seen.h5", ".png"]),
        ("draw loop -o missing/seen.png", ["missing/"]),
        ("convert loop mine.sdf", ["mine.sdf", ".yaml", ".pgm"]),
        ("convert narrow.yaml narrow.pgm", ["narrow.yaml is the source of the world"]),
        ("convert '{file: narrow.yaml, goal: [2.5, 0.75]}' narrow.pgm", ["narrow.yaml is the source of the world"]),
        ("convert hall.yaml scan.pgm", ["scan.pgm is the source of the world"]),
        ("convert loop narrow.pgm", ["narrow.yaml is there, and is no map with the picture narrow.pgm"]),
        ("draw rooms --start 1 1 0", ["for start to count; rooms is not"]),
        ("check '{generator: rooms, worlds: 3}'", ["check takes one world", "is 3"]),
        ("convert loop mine.pgm --resolution 0", ["0 m", "cells"]),
        ("check narrow.yaml --start 0 0 0", ["start (0, 0)", "wall"]),
        ("check pole.sdf --unknown wall", ["'wall'", "obstacle"]),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file_behind(line, named, folder, refused):
    refused(main, line, named)
