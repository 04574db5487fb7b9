"""Meshes of Gazebo's worlds, cut at the laser's height; with the extra `meshes`."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import install_extra


def dae(mesh, unit="1"):
    """A COLLADA file of a mesh."""
    points = " ".join(map(str, mesh.triangles.ravel()))
    count = 3 * len(mesh.faces)
    return f"""<?xml version="1.0"?>
<COLLADA version="1.4.1" xmlns="http://www.collada.org/2005/11/COLLADASchema">
 <asset><unit name="u" meter="{unit}"/><up_axis>Y_UP</up_axis></asset>
 <library_geometries><geometry id="g"><mesh>
  <source id="s"><float_array id="f" count="{3 * count}">{points}</float_array>
   <technique_common><accessor source="#f" count="{count}" stride="3">
    <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
   </accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
  <triangles count="{len(mesh.faces)}"><input semantic="VERTEX" source="#v" offset="0"/>
   <p>{" ".join(map(str, range(count)))}</p></triangles>
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="scene"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
 </library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>"""


def stl(mesh):
    return mesh.export(file_type="stl")


@pytest.fixture
def read_mesh(read, write, sdf):
    """A function that reads a world with one mesh: its obstacles, the world, and its warnings."""

    def read_file(name, content, *, scale="1 1 1", pose="0 0 0 0 0 0"):
        write(f"models/thing/meshes/{name}", content)
        mesh = f"<mesh><uri>model://thing/meshes/{name}</uri><scale>{scale}</scale></mesh>"
        world, warned = read(sdf.solid(mesh, pose), bounds=(-20, -20, 60, 60))
        return world.obstacles, world, warned

    return read_file


@pytest.fixture
def trimesh():
    """The library; skips the test where the extra is not installed."""
    pytest.importorskip("collada")
    return pytest.importorskip("trimesh")


@pytest.fixture
def block(trimesh):
    """A cube of 2 m."""
    return trimesh.creation.box((2, 2, 2))


@pytest.mark.parametrize(("name", "content"), [("box.stl", stl), ("box.dae", dae)])
def test_a_mesh_is_cut_where_it_stands_in_its_size(name, content, block, read_mesh):
    found, world, warned = read_mesh(name, content(block), scale="2 0.5 1", pose="3 4 0.5 0 0 0.6")
    expected = shapely.affinity.rotate(shapely.box(-2, -0.5, 2, 0.5), 0.6, use_radians=True)
    assert found.symmetric_difference(shapely.affinity.translate(expected, 3, 4)).area < 1e-4
    assert (len(world.boxes), warned) == (1, [])


def test_the_unit_of_a_mesh_counts_and_its_up_axis_does_not(block, read_mesh):
    found, _, warned = read_mesh("inch.dae", dae(block.apply_scale((100, 100, 150)), unit="0.0254"))
    assert found.symmetric_difference(shapely.box(-2.54, -2.54, 2.54, 2.54)).area < 1e-4
    assert warned == []


def test_a_wall_around_a_room_leaves_the_room_free(trimesh, read_mesh):
    found, _, _ = read_mesh("ring.stl", stl(trimesh.creation.annulus(0.8, 1.0, 2.0, sections=4)))
    outer = shapely.Polygon([(1, 0), (0, 1), (-1, 0), (0, -1)])
    expected = outer.difference(shapely.affinity.scale(outer, 0.8, 0.8))
    assert found.symmetric_difference(expected).area < 0.02


def test_thin_walls_without_a_floor_are_walls_and_no_block(block, read_mesh):
    block.update_faces(np.abs(block.face_normals[:, 2]) < 0.5)
    found, world, _ = read_mesh("sheets.stl", stl(block))
    assert not found.contains(shapely.Point(0, 0))
    assert found.hausdorff_distance(shapely.box(-1, -1, 1, 1).exterior) < 0.015
    assert len(world.boxes) == 4


def test_a_mesh_that_cannot_be_read_is_named(trimesh, block, read_mesh):
    tangle = trimesh.Trimesh(np.random.default_rng(0).uniform(-10, 10, (6_000, 3)), np.arange(6_000).reshape(-1, 3))
    for name, content, words in (
        ("broken.stl", b"solid nothing", ""),
        ("nan.stl", stl(block).replace(np.float32(1).tobytes(), np.float32(math.nan).tobytes()), ""),
        ("unit.dae", dae(block, unit="-1"), ""),
        ("thing.fbx", b"FBX", ""),
        ("tangle.stl", stl(tangle), "too fine, or whose faces cut each other"),
    ):
        found, _, (warned,) = read_mesh(name, content)
        assert found.is_empty, name
        assert f"m/c ({name})" in warned
        assert words in warned


def test_without_the_extra_a_mesh_is_named_with_what_it_takes(read_mesh, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    found, _, (warned,) = read_mesh("box.stl", b"")
    assert found.is_empty
    assert install_extra("meshes") in warned
    assert "m/c (box.stl)" in warned
