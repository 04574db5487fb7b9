"""Meshes of Gazebo's worlds, cut at the laser's height; with the extra `meshes`."""

from __future__ import annotations

import math
import struct
import sys
from itertools import pairwise

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import install_extra

SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)


def walls(outline, low=0.0, high=1.0, inwards=False):
    """The triangles (n, 3, 3) of upright walls along a closed line."""
    found = []
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        a, b, c, d = (x0, y0, low), (x1, y1, low), (x1, y1, high), (x0, y0, high)
        found += [(a, c, b), (a, d, c)] if inwards else [(a, b, c), (a, c, d)]
    return np.array(found)


def caps(outline, low=0.0, high=1.0):
    """The triangles of the floor and the ceiling of a convex line."""
    found = []
    for (x0, y0), (x1, y1) in pairwise(outline[1:]):
        (x, y) = outline[0]
        found += [((x, y, high), (x0, y0, high), (x1, y1, high)), ((x, y, low), (x1, y1, low), (x0, y0, low))]
    return np.array(found)


def prism(outline):
    return np.concatenate([walls(outline), caps(outline)])


def stl(triangles):
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = triangles
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + rows.tobytes()


def dae(triangles, unit="1"):
    points = " ".join(map(str, np.ravel(triangles)))
    indices = " ".join(map(str, range(3 * len(triangles))))
    return f"""<?xml version="1.0"?>
<COLLADA version="1.4.1" xmlns="http://www.collada.org/2005/11/COLLADASchema">
 <asset><unit name="u" meter="{unit}"/><up_axis>Y_UP</up_axis></asset>
 <library_geometries><geometry id="g"><mesh>
  <source id="s"><float_array id="f" count="{9 * len(triangles)}">{points}</float_array>
   <technique_common><accessor source="#f" count="{3 * len(triangles)}" stride="3">
    <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
   </accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
  <triangles count="{len(triangles)}"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p></triangles>
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="scene"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
 </library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>"""


@pytest.fixture
def read_mesh(read, write, sdf):
    """A function that reads a world with one mesh: its obstacles, the world, and what it warned about."""

    def read_file(name, content, *, scale="1 1 1", pose="0 0 0 0 0 0"):
        write(f"models/thing/meshes/{name}", content)
        mesh = f"<mesh><uri>model://thing/meshes/{name}</uri><scale>{scale}</scale></mesh>"
        world, warned = read(sdf.solid(mesh, pose), bounds=(-20, -20, 60, 60))
        return world.obstacles, world, warned

    return read_file


@pytest.fixture
def trimesh():
    """Skips the test where the extra is not installed."""
    pytest.importorskip("collada")
    return pytest.importorskip("trimesh")


@pytest.mark.parametrize(("name", "content"), [("box.stl", stl(prism(SQUARE))), ("box.dae", dae(prism(SQUARE)))])
def test_a_mesh_is_cut_where_it_stands_in_its_size(name, content, trimesh, read_mesh):
    found, world, warned = read_mesh(name, content, scale="2 0.5 1", pose="3 4 -0.5 0 0 0.6")
    expected = shapely.affinity.rotate(shapely.box(-2, -0.5, 2, 0.5), 0.6, use_radians=True)
    assert found.symmetric_difference(shapely.affinity.translate(expected, 3, 4)).area < 1e-4
    assert (len(world.boxes), warned) == (1, [])


def test_the_unit_of_a_mesh_counts_and_the_axis_that_it_calls_up_does_not(trimesh, read_mesh):
    found, _, warned = read_mesh("inch.dae", dae(100 * prism(SQUARE), unit="0.0254"))
    assert found.symmetric_difference(shapely.box(-2.54, -2.54, 2.54, 2.54)).area < 1e-4
    assert warned == []


def test_a_wall_around_a_room_leaves_the_room_free(trimesh, read_mesh):
    inner = 0.8 * SQUARE
    ring = [walls(SQUARE), walls(inner, inwards=True)]
    for (a, b), (c, d) in zip(
        zip(SQUARE, np.roll(SQUARE, -1, axis=0), strict=True), zip(inner, np.roll(inner, -1, axis=0), strict=True),
        strict=True,
    ):  # fmt: skip
        for z in (0.0, 1.0):
            a3, b3, c3, d3 = ((*point, z) for point in (a, b, c, d))
            ring.append(np.array([(a3, b3, d3), (a3, d3, c3)] if z else [(a3, d3, b3), (a3, c3, d3)]))
    found, _, _ = read_mesh("ring.stl", stl(np.concatenate(ring)))
    expected = shapely.box(-1, -1, 1, 1).difference(shapely.box(-0.8, -0.8, 0.8, 0.8))
    assert found.symmetric_difference(expected).area < 0.02


def test_thin_walls_without_a_floor_are_walls_and_no_block(trimesh, read_mesh):
    found, world, _ = read_mesh("sheets.stl", stl(walls(2 * SQUARE)))
    assert not found.contains(shapely.Point(0, 0))
    assert found.hausdorff_distance(shapely.box(-2, -2, 2, 2).exterior) < 0.015
    assert len(world.boxes) == 4


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("broken.stl", b"solid nothing"),
        ("nan.stl", stl(prism(SQUARE) * math.nan)),
        ("unit.dae", dae(prism(SQUARE), unit="-1")),
        ("thing.fbx", b"FBX"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_named(name, content, trimesh, read_mesh):
    found, _, (warned,) = read_mesh(name, content)
    assert found.is_empty
    assert f"m/c ({name})" in warned


def test_without_the_extra_a_mesh_is_named_with_what_it_takes(read_mesh, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    found, _, (warned,) = read_mesh("box.stl", stl(prism(SQUARE)))
    assert found.is_empty
    assert install_extra("meshes") in warned
    assert "m/c (box.stl)" in warned


def test_a_mesh_meant_to_do_harm_is_named(trimesh, read_mesh):
    triangles = np.random.default_rng(0).uniform(-10, 10, (2_000, 3, 3))
    found, _, (warned,) = read_mesh("tangle.stl", stl(triangles))
    assert found.is_empty
    assert "too fine, or whose faces cut each other" in warned
