"""Files that are broken or meant to do harm: one line, without reading anything outside of their folders."""

import os

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.registry import read_world

SOLID = (
    "<model name='m'><pose>{pose}</pose><link name='l'><collision name='c'><geometry>{shape}</geometry></collision>"
    "</link></model>"
)


def world(inside):
    return f"<sdf version='1.6'><world name='w'>{inside}</world></sdf>"


def solid(pose="0 0 0 0 0 0", shape="<box><size>1 1 1</size></box>"):
    return world(SOLID.format(pose=pose, shape=shape))


def include(uri):
    return world(f"<include><uri>{uri}</uri></include>")


ENTITIES = "".join(f"<!ENTITY e{i} '{f'&e{i - 1};' * 10 if i else 'x' * 10}'>" for i in range(10))
MODEL = "<sdf version='1.6'><model name='m'>{}</model></sdf>"
TEN = "".join(f"<include><name>n{i}</name><uri>model://{{}}</uri></include>" for i in range(10))
LINE = "<polyline><point>0 0</point><point>1 1</point><point>1 0</point><point>0 1</point><height>1</height></polyline>"
BAD = {
    "truncated": (solid()[:-30], "is not XML"),
    "not-sdf": ("<robot name='turtlebot2'/>", "begins with <robot>"),
    "nothing": ("<sdf version='1.6'/>", "neither a <world> nor a <model>"),
    "entities": (f"<!DOCTYPE sdf [{ENTITIES}]>" + solid("&e9;"), "<!DOCTYPE"),
    "large-file": ("<sdf>" + " " * 9_000_000 + "</sdf>", "too large"),
    "deep": ("<sdf><world>" + "<model name='m'>" * 5_000 + "</model>" * 5_000 + "</world></sdf>", "nest too deep"),
    "circle": (include("model://circle"), "contain themselves"),
    "frame-circle": (
        world("<frame name='f'><pose relative_to='f'/></frame><model name='m'><pose relative_to='f'/></model>"),
        "contain themselves",
    ),
    "many-by-includes": (include("model://ten-0"), "more than 20000"),
    "climbs-encoded": (include("model://..%2F..%2F..%2F..%2F..%2F..%2Fetc%2Fpasswd"), "outside of the model path"),
    "climbs-mesh": (solid(shape="<mesh><uri>../../../../../../etc/passwd</uri></mesh>"), "outside of the model path"),
    "climbs-config": (include("model://config-climbs"), "outside of the model path"),
    "pose": (solid("0 nan 0 0 0 0"), "6 numbers up to 1e+06, got"),
    "zero-box": (solid(shape="<box><size>1 0 1</size></box>"), "above 0"),
    "zero-state": (solid().replace("</world>", "<state><model name='m'><scale>0 1 1</scale></model></state></world>"),
                   "above 0"),
    "crossing-line": (solid(shape=LINE), "without crossings"),
    "overlapping": (world("".join(SOLID.format(pose=f"0 0 0 0 0 {k / 1000}", shape="<box><size>99 1 1</size></box>")
                                  for k in range(1500))), "set one"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_world_is_one_line(name, write):
    write("models/circle/model.sdf", MODEL.format("<include><uri>model://circle</uri></include>"))
    for i in range(8):
        write(f"models/ten-{i}/model.sdf", MODEL.format(TEN.format(*[f"ten-{i + 1}"] * 10)))
    write("models/ten-8/model.sdf", MODEL.format(""))
    write("models/config-climbs/model.config", "<model><sdf version='1'>../../../secret.sdf</sdf></model>")
    with pytest.raises(InputError) as refused:
        read_world(write(f"{name}.world", BAD[name][0]))
    message = str(refused.value)
    assert BAD[name][1] in message
    assert name in message
    assert "\n" not in message
    assert "root:" not in message, "nothing of a file outside is shown"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")
def test_a_pipe_is_no_world(tmp_path):
    os.mkfifo(tmp_path / "pipe.world")
    with pytest.raises(InputError, match="there is no file"):
        read_world(tmp_path / "pipe.world")


FREE = b"P5\n4 4\n255\n" + b"\xfe" * 16
GOOD = "image: map.pgm\nresolution: 0.5\n"
MAPS = {
    "missing": ("image: no.pgm\nresolution: 0.5\n", b"", "there is no such file"),
    "nan-origin": (GOOD + "origin: [0, .nan, 0]\n", FREE, "origin"),
    "mode": (GOOD + "mode: ternary\n", FREE, "'trinary', 'scale' or 'raw'"),
    "thresholds": (GOOD + "free_thresh: 0.8\n", FREE, "free_thresh must be at most"),
    "truncated": (GOOD, FREE[:-5], "cannot read the picture"),
    "huge": (GOOD, b"P5\n9000 9000\n255\n", "more than 4000000"),
    "bomb": (GOOD, b"P5\n60000 60000\n255\n", "cannot read the picture"),
    "noise": (GOOD, b"P5\n400 400\n255\n" + np.random.default_rng(0).bytes(160_000), "obstacles, the limit"),
    "occupied": (GOOD, b"P5\n4 4\n255\n" + b"\0" * 16, "no free floor"),
    "not-yaml": ("image: map.pgm\nresolution: a: b\n", FREE, "as YAML"),
    "huge-yaml": (GOOD + "more: [" + "1, " * 400_000 + "]\n", FREE, "too large"),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_bad_map_is_one_line(name, write):
    settings, picture, words = MAPS[name]
    write("map.pgm", picture)
    with pytest.raises(InputError) as refused:
        read_world(write(f"{name}.yaml", settings), options=ImportOptions(unknown="free"))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
