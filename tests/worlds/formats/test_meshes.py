"""Meshes of Gazebo's worlds, cut at the laser's height; with the extra `meshes`."""

import math
import sys

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import install_extra


def stl(mesh):
    return mesh.export(file_type="stl")


def dae(mesh, unit="1"):
    """A COLLADA file of a mesh, with a unit [m] and Y_UP."""
    return mesh.export(file_type="dae").replace(b"<up_axis>", f"<unit name='u' meter='{unit}'/><up_axis>".encode())


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


def inches(mesh):
    return dae(mesh.copy().apply_scale(1 / 0.0254), unit="0.0254")


@pytest.mark.parametrize(("name", "content"), [("box.stl", stl), ("box.dae", dae), ("inch.dae", inches)])
def test_a_mesh_is_cut_where_it_stands_in_its_size(name, content, block, read_mesh):
    found, world, warned = read_mesh(name, content(block), scale="2 0.5 1", pose="3 4 0.5 0 0 0.6")
    expected = shapely.affinity.rotate(shapely.box(-2, -0.5, 2, 0.5), 0.6, use_radians=True)
    assert found.symmetric_difference(shapely.affinity.translate(expected, 3, 4)).area < 1e-4
    assert (len(world.boxes), warned) == (1, [])


def test_a_wall_around_a_room_leaves_the_room_free_and_thin_walls_are_no_block(trimesh, block, read_mesh):
    found, _, _ = read_mesh("ring.stl", stl(trimesh.creation.annulus(0.8, 1.0, 2.0, sections=4)))
    outer = shapely.Polygon([(1, 0), (0, 1), (-1, 0), (0, -1)])
    assert found.symmetric_difference(outer.difference(shapely.affinity.scale(outer, 0.8, 0.8))).area < 0.02
    block.update_faces(np.abs(block.face_normals[:, 2]) < 0.5)
    found, world, _ = read_mesh("sheets.stl", stl(block))
    assert not found.contains(shapely.Point(0, 0))
    assert found.hausdorff_distance(shapely.box(-1, -1, 1, 1).exterior) < 0.015
    assert len(world.boxes) == 4


def test_a_mesh_that_cannot_be_read_is_named(trimesh, block, read_mesh):
    tangle = trimesh.Trimesh(np.random.default_rng(0).uniform(-10, 10, (6_000, 3)), np.arange(6_000).reshape(-1, 3))
    for name, content, words in (
        ("broken.stl", b"solid nothing", "unreadable meshes"),
        ("nan.stl", stl(block).replace(np.float32(1).tobytes(), np.float32(math.nan).tobytes()), "infinite numbers"),
        ("unit.dae", dae(block, unit="an inch"), "unreadable meshes"),
        ("thing.fbx", b"FBX", "other than .dae, .obj, .stl"),
        ("tangle.stl", stl(tangle), "too fine, or whose faces cut each other"),
    ):
        found, _, (warned,) = read_mesh(name, content)
        assert found.is_empty, name
        assert f"m/c (model://thing/meshes/{name})" in warned
        assert words in warned


def test_without_the_extra_a_mesh_is_named_with_what_it_takes(read_mesh, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    found, _, (warned,) = read_mesh("box.stl", b"")
    assert found.is_empty
    assert install_extra("meshes") in warned
