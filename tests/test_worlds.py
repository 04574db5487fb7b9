"""The command that looks at worlds: it lists, draws, converts and checks."""

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
def folder(tmp_path, monkeypatch):
    """A folder to work in, where warnings are shown as they are to users."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "narrow.yaml").write_text(NARROW)
    (tmp_path / "pole.sdf").write_text(POLE)
    (tmp_path / "hall.yaml").write_text("image: 'scan.pgm'\nresolution: 1\nstart: [2, 2, 0]\n")
    (tmp_path / "scan.pgm").write_bytes(b"P5\n4 4\n255\n" + b"\xfe" * 16)
    (tmp_path / "two").mkdir()
    for name in ("one", "other"):
        (tmp_path / "two" / f"{name}.yaml").write_text(NARROW)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        yield tmp_path


def said(line, capsys):
    main(shlex.split(line))
    return capsys.readouterr().out.splitlines()


def test_it_lists_the_worlds_with_what_they_are(capsys):
    lines = said("list", capsys)
    assert [line.split()[0] for line in lines][: len(world_names())] == world_names()
    assert any("corridors of 2.5 m" in line for line in lines)


@pytest.mark.parametrize(("worlds", "tiles"), [("loop", 1), ("loop maze round", 4)])
def test_it_draws_one_world_or_a_sheet_of_many(worlds, tiles, folder, capsys):
    assert said(f"draw {worlds} -o seen.png", capsys) == ["wrote seen.png"]
    picture = np.asarray(Image.open("seen.png"))
    assert min(picture.shape[:2]) >= 600
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3


def test_the_sheet_of_a_generator_has_every_family(folder, monkeypatch):
    monkeypatch.setattr(worlds, "make_grid", lambda pictures, titles, columns: drawn.extend(titles) or pictures[0])
    monkeypatch.setattr(worlds, "draw_plan", lambda *_: np.zeros((2, 2, 3), np.uint8))
    drawn: list[str] = []
    main(["draw", "mixed", "-o", "mixed.png"])
    assert {title.split()[0] for title in drawn} == {maker.__name__ for maker in FAMILIES}


def test_it_checks_what_a_robot_can_reach(folder, capsys):
    about, reach, doors, parts = said("check narrow.yaml", capsys)
    assert about == "narrow: 3.3 x 1.5 m, 6 boxes, 0 posts"
    assert reach.startswith("turtlebot2 (0.356 m wide) reaches 48% of the floor, ")
    assert doors.startswith("1 door is narrower than the robot: 0.300 m at (1.6")
    assert "1 part of the floor cannot be reached, behind passages that are too narrow: 1.1 m2" in parts
    assert len(said("check narrow.yaml --robot turtlebot3", capsys)) == 2


def test_the_width_of_a_door_is_told_from_that_of_the_robot(folder, capsys):
    boxes = [(1.6, 0.286, 0.1, 0.572, 0.0), (1.6, 1.214, 0.1, 0.572, 0.0)]  # with 0.356 m between them
    world = World.from_shapes("door", boxes, start=(0.7, 0.75, 0.0), bounds=(0.0, 0.0, 3.3, 1.5))
    write_description(world, Path("door.yaml"))
    (line,) = [line for line in said("check door.yaml", capsys) if "narrower" in line]
    assert line.startswith("1 door is narrower than the robot: 0.3559 m (the robot needs 0.3560 m) at (1.6")


def test_it_says_whether_the_goal_can_be_reached(folder, capsys):
    assert said("check maze", capsys)[-1] == "the goal (9.00, 9.00) can be reached"
    assert said("check narrow.yaml --goal 2.5 0.75", capsys)[-1] == "the goal (2.50, 0.75) cannot be reached"


@pytest.mark.parametrize("name", world_names())
def test_what_it_converts_to_a_world_of_ours_is_the_same_world(name, folder, capsys):
    assert said(f"convert {name} mine.yaml", capsys) == ["wrote mine.yaml"]
    before, after = find_world(name), find_world("mine.yaml")
    assert np.allclose(after.boxes, before.boxes, atol=1e-12)
    assert np.allclose(after.posts, before.posts, atol=1e-12)
    assert (after.start, after.goal) == (before.start, before.goal)
    assert (after.bounds, after.description) == (before.bounds, before.description)


def test_it_converts_to_a_map_of_ros_and_back(folder, capsys):
    assert said("convert maze map.pgm --resolution 0.1", capsys) == ["wrote map.pgm", "wrote map.yaml"]
    with Image.open("map.pgm") as picture:
        assert picture.size == (101, 101)
    assert said("convert map.yaml mine.yaml", capsys) == ["wrote mine.yaml"]
    assert said("convert maze map.pgm", capsys)[0] == "wrote map.pgm", "the same once more"
    assert said("convert maze mine.yaml", capsys) == ["wrote mine.yaml"]
    assert find_world("mine.yaml").goal == find_world("maze").goal


def test_what_is_said_beside_a_world_counts_and_what_is_left_out_is_one_line(folder, capsys):
    main(shlex.split("check pole.sdf --start 2 0 0 --goal 0 3"))
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "from (2.00, 0.00)" in shown.out
    main(shlex.split("check pole.sdf --start 2 0 0 --laser-height 0.7"))
    assert capsys.readouterr().err == (
        "warning: world pole: left out, for they are above the laser (at 0.7 m): pole/c\n".replace("above", "below")
    )
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
        ("draw loop -o seen.doc", ["seen.doc", ".png"]),
        ("draw loop -o missing/seen.png", ["missing/"]),
        ("draw loop --robot turtelbot2", ["did you mean 'turtlebot2'"]),
        ("draw loop missing.world", ["there is no world file missing.world"]),
        ("convert loop mine.sdf", ["mine.sdf", ".yaml", ".pgm"]),
        ("convert narrow.yaml narrow.pgm", ["narrow.yaml is what the world is read from"]),
        ("convert narrow.yaml ./narrow.yaml", ["narrow.yaml is what the world is read from"]),
        ("convert '{file: narrow.yaml, goal: [2.5, 0.75]}' narrow.pgm", ["narrow.yaml is what the world is read from"]),
        ("convert hall.yaml scan.pgm", ["scan.pgm is what the world is read from"]),
        ("convert loop narrow.pgm", ["narrow.yaml is there, and is no map with the picture narrow.pgm"]),
        ("draw rooms --start 1 1 0", ["for start to count; rooms is not"]),
        ("check rooms --start 1 1 0", ["for start to count; rooms is not"]),
        ("check two --goal 1 1", ["for goal to count; two is not"]),
        ("check two", ["check takes one world, and two is 2"]),
        ("check '{generator: rooms, worlds: 3}'", ["check takes one world", "is 3"]),
        ("check '{file: 3}'", ["the world", "must name its generator"]),
        ("convert two mine.yaml", ["convert takes one world, and two is 2"]),
        ("convert rooms mine.yaml", ["convert takes one world, and rooms is 512"]),
        *(
            (f"draw loop -o seen.{ending}", [f"seen.{ending}", ".png"])
            for ending in ("h5", "wmf", "xbm", "fits", "mpg")
        ),
        ("convert loop mine.pgm --resolution 0", ["0 m", "cells"]),
        ("convert loop missing/mine.yaml", ["missing/"]),
        ("check narrow.yaml --start 0 0 0", ["start (0, 0)", "wall"]),
        ("check narrow.yaml --start nan 0 0", ["world.start", "finite"]),
        ("check pole.sdf --laser-height -1", ["world.laser_height", "greater than 0"]),
        ("check pole.sdf --unknown wall", ["'wall'", "obstacle"]),
    ],
)
def test_what_does_not_fit_is_one_line(line, named, folder, capsys):
    before = sorted(folder.iterdir())
    with pytest.raises(SystemExit) as stopped:
        main(shlex.split(line))
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1, message
    assert [part for part in named if part not in message] == [], message
    assert sorted(folder.iterdir()) == before, "it leaves nothing behind"
