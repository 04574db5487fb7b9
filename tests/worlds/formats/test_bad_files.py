"""Files that are broken, or meant to do harm: one line, at most 2 s, at most 1 GB."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import time
import zlib
from pathlib import Path

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


def outline(pose):
    points = "".join(f"<point>{x} {y}</point>" for x, y in ((0, 0), (1, 0), (0.5, 0.3), (1, 1), (0, 1)))
    return SOLID.format(pose=pose, shape=f"<polyline>{points}<height>1</height></polyline>")


def include(uri):
    return world(f"<include><uri>{uri}</uri></include>")


ENTITIES = "".join(f"<!ENTITY e{i} '{f'&e{i - 1};' * 10 if i else 'x' * 10}'>" for i in range(10))
MODEL = "<sdf version='1.6'><model name='m'>{}</model></sdf>"
TEN = "".join(f"<include><name>n{i}</name><uri>model://{{}}</uri></include>" for i in range(10))
BAD = {
    "truncated": (solid()[:-30], "is not XML"),
    "not-xml": ("a robot's world", "is not XML"),
    "not-sdf": ("<robot name='turtlebot2'/>", "begins with <robot>"),
    "empty": ("", "is not XML"),
    "nothing": ("<sdf version='1.6'/>", "neither a <world> nor a <model>"),
    "encoding": ("<?xml version='1.0' encoding='klingon'?>" + solid(), "is not XML"),
    "entities": (f"<!DOCTYPE sdf [{ENTITIES}]>" + solid("&e9;"), "<!DOCTYPE"),
    "external": ("<!DOCTYPE sdf SYSTEM 'file:///etc/passwd'>" + solid(), "<!DOCTYPE"),
    "huge": ("<sdf>" + "<a/>" * 3_000_000 + "</sdf>", "too large"),
    "many-elements": ("<sdf version='1.6'><world name='w'>" + "<a/>" * 2_000_000, "too large"),
    "large-file": ("<sdf>" + " " * 17_000_000 + "</sdf>", "too large"),
    "attributes": ("<sdf " + " ".join(f"a{i}=''" for i in range(500_000)) + "/>", "too large"),
    "crossing-line": (
        solid(shape="<polyline><point>0 0</point><point>1 1</point><point>1 0</point><point>0 1</point>"
                    "<height>1</height></polyline>"),
        "crosses nothing",
    ),
    "deep": ("<sdf><world>" + "<model name='m'>" * 100_000 + "</model>" * 100_000 + "</world></sdf>", "20 deep"),
    "circle": (include("model://circle-model"), "includes itself"),
    "itself": (include("file://itself.world"), "includes itself"),
    "many-by-includes": (include("model://ten-0"), "more than 20000"),
    "climbs": (include("model://../../../../../../../etc/passwd"), "climbs out"),
    "climbs-encoded": (include("model://..%2F..%2F..%2F..%2F..%2F..%2Fetc%2Fpasswd"), "climbs out"),
    "climbs-absolute": (include("file:///etc/passwd"), "climbs out"),
    "climbs-mesh": (solid(shape="<mesh><uri>../../../../../../etc/passwd</uri></mesh>"), "climbs out"),
    "climbs-config": (include("model://config-climbs"), "not in its folder"),
    "nan-pose": (solid("0 nan 0 0 0 0"), "finite numbers"),
    "inf-pose": (solid("0 inf 0 0 0 0"), "finite numbers"),
    "far-pose": (solid("1e300 0 0 0 0 0"), "finite numbers"),
    "short-pose": (solid("1 2 3"), "6 numbers"),
    "words-pose": (solid("here"), "finite numbers"),
    "zero-box": (solid(shape="<box><size>1 0 1</size></box>"), "above 0"),
    "minus-cylinder": (solid(shape="<cylinder><radius>-1</radius><length>1</length></cylinder>"), "above 0"),
    "zero-sphere": (solid(shape="<sphere><radius>0</radius></sphere>"), "above 0"),
    "no-size": (solid(shape="<box/>"), "no <size>"),
    "nan-scale": (
        solid(shape="<mesh><uri>model://mesh/mesh.stl</uri><scale>nan 1 1</scale></mesh>"),
        "finite numbers",
    ),
    "zero-scale": (solid(shape="<mesh><uri>model://mesh/mesh.stl</uri><scale>0 1 1</scale></mesh>"), "above 0"),
    "line": (solid(shape="<polyline><point>0 0</point><point>1 1</point><height>1</height></polyline>"), "three"),
    "zero-state": (
        world(SOLID.format(pose="", shape=BOX) + "<state><model name='m'><scale>0 1 1</scale></model></state>"),
        "above 0",
    ),
    "frames": (
        world("<frame name='a'><pose relative_to='a'>1 0 0 0 0 0</pose></frame>"
              "<model name='m'><pose relative_to='a'>1 0 0 0 0 0</pose></model>"),
        "relative to itself",
    ),
    "frame-chain": (
        world("".join(f"<frame name='f{i}'><pose relative_to='f{i + 1}'>0 0 0 0 0 0</pose></frame>" for i in range(600))
              + "<model name='m'><pose relative_to='f0'>1 0 0 0 0 0</pose></model>"),
        "more than 100 frames",
    ),
    "crossing-lines": (
        solid(shape="".join(f"<polyline><point>{x} 0</point><point>{x + 2} 0</point><point>{x + 1} 2</point>"
                            "<height>1</height></polyline>" for x in (0, 1))),
        "must not touch or cross",
    ),
    "many-lines": (
        solid(shape=200 * ("<polyline><point>0 0</point><point>2 0</point><point>1 2</point><height>1</height>"
              "</polyline>")),
        "more than 100 <polyline>",
    ),
    "many-outlines": (
        world("".join(outline(f"{k % 70} {k // 70} 0 0.1 0 0") for k in range(5000))),
        "more than 10000 obstacles",
    ),
    "overlapping": (
        world("".join(SOLID.format(pose=f"0 0 0 0 0 {k / 1000}", shape="<box><size>100 1 1</size></box>")
                      for k in range(3000))),
        "give one",
    ),
    "quaternion": (
        world("<model name='m'><pose rotation_format='quat_xyzw'>0 0 0 0 0 0 0</pose></model>"),
        "length 0",
    ),
}  # fmt: skip


@pytest.fixture
def bad(write):
    """A function that writes a bad file and what it includes."""

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
def test_a_bad_world_is_one_line_within_two_seconds(name, bad):
    path = bad(name)
    began = time.process_time()
    with pytest.raises(InputError) as refused:
        read_world(path)
    assert time.process_time() - began < 2.0
    message = str(refused.value)
    assert BAD[name][1] in message
    assert name in message
    assert "\n" not in message
    assert "root:" not in message, "nothing of a file outside is shown"


def deletions():
    gone = "".join(f"<name>n{i}</name>" for i in range(60_000))
    return f"<state><deletions>{gone}</deletions></state>" + "".join(row("", 1000))


def states():
    here = "".join(f"<model name='a{i}'><pose>{i} 0 0 0 0 0</pose></model>" for i in range(15_000))
    return f"<state>{here}</state>" + "".join(row("", 3000))


def frames():
    poses = (f"<frame name='f{i}'><pose relative_to='f{i + 1}'>0 0 0 0 0 0</pose></frame>" for i in range(90))
    return "".join(poses) + "<frame name='f90'/>" + "".join(row(" relative_to='f0'", 2000))


def row(frame, count):
    for i in range(count):
        yield (
            SOLID.format(pose="{pose}", shape=BOX)
            .replace("'m'", f"'m{i}'")
            .replace("<pose>{pose}", f"<pose{frame}>{i % 50 * 2} {i // 50 * 2} 0 0 0 0")
        )


def posts():
    shape = "<cylinder><radius>0.2</radius><length>1</length></cylinder>"
    return "".join(SOLID.format(pose=f"{k % 70} {k // 70} 0 0 0 0", shape=shape) for k in range(5000))


@pytest.mark.filterwarnings("ignore::tb2rl.core.errors.WorldWarning")
@pytest.mark.parametrize("inside", [deletions, states, frames, posts])
def test_a_world_of_thousands_of_parts_is_read_within_two_seconds(inside, write):
    path = write("large.world", world(inside()))
    began = time.process_time()
    found = read_world(path)
    assert time.process_time() - began < 2.0
    assert len(found.boxes) + len(found.posts) in (1000, 2000, 3000, 5000)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read as Linux tells it")
def test_the_worst_of_them_take_little_memory(bad):
    files = [str(bad(name)) for name in ("entities", "huge", "attributes", "deep", "many-by-includes")]
    code = """
import sys
from pathlib import Path
from tb2rl.worlds.readers import read_world
for name in sys.argv[1:]:
    try:
        read_world(Path(name))
    except ValueError as error:
        print(type(error).__name__)
print(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])  # ru_maxrss begins with the parent's
"""
    done = subprocess.run([sys.executable, "-c", code, *files], capture_output=True, text=True, check=True)
    *errors, peak = done.stdout.split()
    assert errors == ["InputError"] * len(files)
    assert int(peak) * 1024 < 1e9


def test_a_pipe_is_no_world(tmp_path):
    os.mkfifo(tmp_path / "pipe.world")
    with pytest.raises(InputError, match="there is no file"):
        read_world(tmp_path / "pipe.world")


def png(width, height, rows=b""):
    """A picture of one channel that says how large it is, whatever is in it."""

    def chunk(kind, content):
        return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\0\0\0\0"
    body = zlib.compress(rows or b"\0" * min((width + 1) * height, 1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def noise():
    file = io.BytesIO()
    cells = np.random.default_rng(0).random((1900, 1900)) < 0.5
    Image.fromarray(cells.astype(np.uint8) * 255).save(file, "PNG")
    return file.getvalue()


FREE = b"P5\n4 4\n255\n" + b"\xfe" * 16
GOOD = "image: map.pgm\nresolution: 0.5\n"
MAPS = {
    "missing": ("image: no.pgm\nresolution: 0.5\n", b"", "there is no picture"),
    "directory": ("image: .\nresolution: 0.5\n", b"", "there is no picture"),
    "no-resolution": ("image: map.pgm\n", FREE, "resolution"),
    "zero-resolution": ("image: map.pgm\nresolution: 0\n", FREE, "greater than 0"),
    "nan-resolution": ("image: map.pgm\nresolution: .nan\n", FREE, "finite"),
    "nan-origin": (GOOD + "origin: [0, .nan, 0]\n", FREE, "finite"),
    "short-origin": (GOOD + "origin: [0, 0]\n", FREE, "[x, y, yaw]"),
    "mode": (GOOD + "mode: ternary\n", FREE, "'trinary', 'scale' or 'raw'"),
    "thresholds": (GOOD + "free_thresh: 0.8\n", FREE, "free_thresh must be at most"),
    "threshold": (GOOD + "occupied_thresh: 65\n", FREE, "less than or equal to 1"),
    "no-picture": (GOOD, b"hello", "cannot read the picture"),
    "truncated": (GOOD, FREE[:-5], "cannot read the picture"),
    "huge": (GOOD, b"P5\n90000 90000\n255\n", "too large"),
    "bomb": (GOOD, png(60_000, 60_000), "too large"),
    "torn": (GOOD, png(1000, 1000), "cannot read the picture"),
    "noise": (GOOD, noise(), "obstacles, the limit"),
    "occupied": (GOOD, b"P5\n4 4\n255\n" + b"\0" * 16, "no floor"),
    "huge-yaml": (GOOD + "more: [" + "1, " * 1_000_000 + "]\n", FREE, "too large"),
    "blanks": ("image: map.pgm" + " " * 200_000 + "b\nresolution: 0.5\n", FREE, "too large"),
    "image-number": ("image: 7\nresolution: 0.5\n", FREE, "image"),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_bad_map_is_one_line_within_two_seconds(name, write):
    settings, picture, words = MAPS[name]
    write("map.pgm", picture)
    path = write(f"{name}.yaml", settings)
    began = time.process_time()
    with pytest.raises(InputError) as refused:
        read_world(path, options=ImportOptions(unknown="free"))
    assert time.process_time() - began < 2.0
    message = str(refused.value)
    assert words in message
    assert "\n" not in message
