"""Files that are broken or meant to do harm: one line, without reading anything outside of their folders."""

from __future__ import annotations

import io
import os
import zlib

import numpy as np
import pytest
from PIL import Image

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.readers import read_world

SOLID = (
    "<model name='m'><pose>{pose}</pose><link name='l'><collision name='c'><geometry>{shape}</geometry></collision>"
    "</link></model>"
)
BOX = "<box><size>1 1 1</size></box>"


def world(inside):
    return f"<sdf version='1.6'><world name='w'>{inside}</world></sdf>"


def solid(pose="0 0 0 0 0 0", shape=BOX):
    return world(SOLID.format(pose=pose, shape=shape))


def include(uri):
    return world(f"<include><uri>{uri}</uri></include>")


def polyline(*points):
    return f"<polyline>{''.join(f'<point>{x} {y}</point>' for x, y in points)}<height>1</height></polyline>"


def frames(count):
    chain = (f"<frame name='f{i}'><pose relative_to='f{i + 1}'>0 0 0 0 0 0</pose></frame>" for i in range(count))
    return "".join(chain) + "<model name='m'><pose relative_to='f0'>1 0 0 0 0 0</pose></model>"


ENTITIES = "".join(f"<!ENTITY e{i} '{f'&e{i - 1};' * 10 if i else 'x' * 10}'>" for i in range(10))
MODEL = "<sdf version='1.6'><model name='m'>{}</model></sdf>"
TEN = "".join(f"<include><name>n{i}</name><uri>model://{{}}</uri></include>" for i in range(10))
TRIANGLE = polyline((0, 0), (2, 0), (1, 2))
BAD = {
    "truncated": (solid()[:-30], "is not XML"),
    "not-sdf": ("<robot name='turtlebot2'/>", "begins with <robot>"),
    "nothing": ("<sdf version='1.6'/>", "neither a <world> nor a <model>"),
    "encoding": ("<?xml version='1.0' encoding='klingon'?>" + solid(), "is not XML"),
    "entities": (f"<!DOCTYPE sdf [{ENTITIES}]>" + solid("&e9;"), "<!DOCTYPE"),
    "large-file": ("<sdf>" + " " * 17_000_000 + "</sdf>", "too large"),
    "deep": ("<sdf><world>" + "<model name='m'>" * 50_000 + "</model>" * 50_000 + "</world></sdf>", "20 deep"),
    "circle": (include("model://circle-model"), "includes itself"),
    "itself": (include("file://itself.world"), "includes itself"),
    "many-by-includes": (include("model://ten-0"), "more than 20000"),
    "climbs-encoded": (include("model://..%2F..%2F..%2F..%2F..%2F..%2Fetc%2Fpasswd"), "climbs out"),
    "climbs-absolute": (include("file:///etc/passwd"), "climbs out"),
    "climbs-mesh": (solid(shape="<mesh><uri>../../../../../../etc/passwd</uri></mesh>"), "climbs out"),
    "climbs-config": (include("model://config-climbs"), "not in its folder"),
    "nan-pose": (solid("0 nan 0 0 0 0"), "finite numbers"),
    "far-pose": (solid("1e300 0 0 0 0 0"), "finite numbers"),
    "short-pose": (solid("1 2 3"), "6 numbers"),
    "zero-box": (solid(shape="<box><size>1 0 1</size></box>"), "above 0"),
    "no-size": (solid(shape="<box/>"), "no <size>"),
    "zero-scale": (solid(shape="<mesh><uri>model://mesh/mesh.stl</uri><scale>0 1 1</scale></mesh>"), "above 0"),
    "zero-state": (
        world(SOLID.format(pose="", shape=BOX) + "<state><model name='m'><scale>0 1 1</scale></model></state>"),
        "above 0",
    ),
    "line": (solid(shape=polyline((0, 0), (1, 1))), "three"),
    "crossing-line": (solid(shape=polyline((0, 0), (1, 1), (1, 0), (0, 1))), "crosses nothing"),
    "crossing-lines": (solid(shape=TRIANGLE + polyline((1, 0), (3, 0), (2, 2))), "must not touch or cross"),
    "frames": (world("<frame name='f0'><pose relative_to='f0'>1 0 0 0 0 0</pose></frame>" + frames(0)), "itself"),
    "frame-chain": (world(frames(600)), "more than 100 frames"),
    "overlapping": (
        world("".join(SOLID.format(pose=f"0 0 0 0 0 {k / 1000}", shape="<box><size>99 1 1</size></box>")
                      for k in range(1500))),
        "give one",
    ),
    "quaternion": (world("<model name='m'><pose rotation_format='quat_xyzw'>0 0 0 0 0 0 0</pose></model>"), "length 0"),
}  # fmt: skip


@pytest.fixture
def bad(write):
    """A function that writes a bad file and its includes."""

    def write_files(name):
        write("models/circle-model/model.sdf", MODEL.format("<include><uri>model://circle-2</uri></include>"))
        write("models/circle-2/model.sdf", MODEL.format("<include><uri>model://circle-model</uri></include>"))
        for i in range(8):
            write(f"models/ten-{i}/model.sdf", MODEL.format(TEN.format(*[f"ten-{i + 1}"] * 10)))
        write("models/ten-8/model.sdf", MODEL.format(""))
        write("models/config-climbs/model.config", "<model><sdf version='1'>../../secret.sdf</sdf></model>")
        write("models/mesh/mesh.stl", "")
        return write(f"{name}.world", BAD[name][0])

    return write_files


@pytest.mark.parametrize("name", BAD)
def test_a_bad_world_is_one_line(name, bad):
    with pytest.raises(InputError) as refused:
        read_world(bad(name))
    message = str(refused.value)
    assert BAD[name][1] in message
    assert name in message
    assert "\n" not in message
    assert "root:" not in message, "nothing of a file outside is shown"


def test_a_pipe_is_no_world(tmp_path):
    os.mkfifo(tmp_path / "pipe.world")
    with pytest.raises(InputError, match="there is no file"):
        read_world(tmp_path / "pipe.world")


def png(width, height):
    """An image of one channel that claims a size without having it."""

    def chunk(kind, content):
        return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\0\0\0\0"
    body = zlib.compress(b"\0" * min((width + 1) * height, 1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def noise():
    file = io.BytesIO()
    cells = np.random.default_rng(0).random((500, 500)) < 0.5
    Image.fromarray(cells.astype(np.uint8) * 255).save(file, "PNG")
    return file.getvalue()


FREE = b"P5\n4 4\n255\n" + b"\xfe" * 16
GOOD = "image: map.pgm\nresolution: 0.5\n"
MAPS = {
    "missing": ("image: no.pgm\nresolution: 0.5\n", b"", "there is no picture"),
    "nan-origin": (GOOD + "origin: [0, .nan, 0]\n", FREE, "finite"),
    "mode": (GOOD + "mode: ternary\n", FREE, "'trinary', 'scale' or 'raw'"),
    "thresholds": (GOOD + "free_thresh: 0.8\n", FREE, "free_thresh must be at most"),
    "truncated": (GOOD, FREE[:-5], "cannot read the picture"),
    "huge": (GOOD, png(9000, 9000), "too large"),
    "bomb": (GOOD, png(60_000, 60_000), "cannot read the picture"),
    "torn": (GOOD, png(1000, 1000), "cannot read the picture"),
    "noise": (GOOD, noise(), "obstacles, the limit"),
    "occupied": (GOOD, b"P5\n4 4\n255\n" + b"\0" * 16, "no floor"),
    "huge-yaml": (GOOD + "more: [" + "1, " * 100_000 + "]\n", FREE, "too large"),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_bad_map_is_one_line(name, write):
    settings, picture, words = MAPS[name]
    write("map.pgm", picture)
    path = write(f"{name}.yaml", settings)
    with pytest.raises(InputError) as refused:
        read_world(path, options=ImportOptions(unknown="free"))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
