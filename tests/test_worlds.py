"""The command `python -m tb2rl.worlds`: list, draw, convert and check."""

import shlex
import warnings

import numpy as np
import pytest
from PIL import Image

from tb2rl.commands import worlds
from tb2rl.worlds.__main__ import main
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


def test_worlds_are_listed_with_their_descriptions_and_drawn(folder, capsys):
    lines = output("list", capsys)
    assert [line.split()[0] for line in lines][: len(world_names())] == world_names()
    assert any("corridors of 2.5 m" in line for line in lines)
    assert output("draw loop maze -o seen.png", capsys) == ["wrote seen.png"]
    picture = np.asarray(Image.open("seen.png"))
    assert min(picture.shape[:2]) >= 300
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3


def test_the_picture_of_a_generator_has_every_family(folder, monkeypatch):
    monkeypatch.setattr(worlds, "make_grid", lambda pictures, titles, columns: drawn.extend(titles) or pictures[0])
    monkeypatch.setattr(worlds, "draw_floor_plan", lambda *_: np.zeros((2, 2, 3), np.uint8))
    drawn: list[str] = []
    main(["draw", "mixed", "-o", "mixed.png"])
    assert drawn[1].endswith(" 0 (training), difficulty 0.25, 8.2 x 8.2 m")
    assert {title.split()[0] for title in drawn} == {maker.__name__ for maker in FAMILIES}


def test_check_shows_what_a_robot_can_reach(folder, capsys):
    about, reach, doors, parts = output("check narrow.yaml", capsys)
    assert about == "narrow: 3.3 x 1.5 m, 6 boxes, 0 posts"
    assert reach.startswith("turtlebot2 (0.356 m wide) reaches 48% of the floor, ")
    assert doors.startswith("doors narrower than the robot (0.3560 m): 0.2999 m at (1.6")
    assert "unreachable floor, behind passages that are too narrow: 1.1 m2" in parts
    assert len(output("check narrow.yaml --robot turtlebot3", capsys)) == 2
    assert output("check maze", capsys)[-1] == "the goal (9.00, 9.00) can be reached"
    assert output("check narrow.yaml --goal 2.5 0.75", capsys)[-1] == "the goal (2.50, 0.75) cannot be reached"


def test_worlds_are_converted_to_yaml_and_to_a_ros_map(folder, capsys):
    assert output("convert maze same.yaml", capsys) == ["wrote same.yaml"]
    before, after = find_world("maze"), find_world("same.yaml")
    assert np.allclose(after.boxes, before.boxes, atol=1e-12)
    assert (after.start, after.goal, after.bounds) == (before.start, before.goal, before.bounds)
    assert output("convert maze map.pgm --resolution 0.1", capsys) == ["wrote map.pgm", "wrote map.yaml"]
    with Image.open("map.pgm") as picture:
        assert picture.size == (101, 101)
    assert output("convert map.yaml mine.yaml", capsys) == ["wrote mine.yaml"]
    assert output("convert maze map.pgm", capsys)[0] == "wrote map.pgm", "the same once more"
    assert find_world("mine.yaml").goal == before.goal


def test_options_take_precedence_over_the_file_and_omissions_are_one_line(folder, capsys):
    main(shlex.split("check pole.sdf --start 2 0 0 --goal 0 3"))
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "from (2.00, 0.00)" in shown.out
    main(shlex.split("check pole.sdf --start 2 0 0 --laser-height 0.7"))
    expected = "warning: world pole: omitted, because they are below the laser (at 0.7 m): pole/c\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["list | draw | convert | check"]),
        ("draw loop -o seen.h5", ["seen.h5", ".png"]),
        ("convert loop mine.sdf", ["mine.sdf", ".yaml", ".pgm"]),
        ("convert narrow.yaml narrow.pgm", ["narrow.yaml is the source of the world"]),
        ("convert hall.yaml scan.pgm", ["scan.pgm is the source of the world"]),
        ("convert loop narrow.pgm", ["narrow.yaml exists and is not the map of narrow.pgm"]),
        ("check '{generator: rooms, worlds: 3}'", ["check takes one world", "got 3"]),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file_behind(line, named, folder, refused):
    refused(main, line, named)
