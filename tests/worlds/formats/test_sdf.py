"""Gazebo's worlds: poses, states, included models, and warnings about omissions."""

import math

import pytest
import shapely

from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.registry import read_world


def posts(world):
    return sorted(tuple(row) for row in world.posts.round(6).tolist())


def polyline(half):
    """A square, 5 m high, with sides of two halves [m]."""
    corners = ((-half, -half), (half, -half), (half, half), (-half, half))
    return f"<polyline>{''.join(f'<point>{x} {y}</point>' for x, y in corners)}<height>5</height></polyline>"


def test_a_pose_is_composed_from_model_to_model_to_link_to_collision(read, sdf):
    quarter = math.pi / 2
    collision = sdf.collision(sdf.cylinder(), "1 0 0 0 0 0")
    inner = sdf.solid("<sphere><radius>0.5</radius></sphere>", "1 0 0.55 0 0 0", "inner")
    world, warned = read(sdf.model(sdf.link(collision, f"0 2 0 0 0 {quarter}") + inner, f"10 20 0 0 0 {quarter}"))
    # Two quarters turn the last metre to -x; the link's two metres north point to -x, too.
    assert posts(world) == [(10 - 2 - 1, 20, 0.2), (10, 21, 0.4)]
    assert warned == []


@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere"])
def test_shapes_are_cut_at_the_height_of_the_laser(shape, read, sdf):
    text = {"box": sdf.box(), "cylinder": sdf.cylinder(), "sphere": "<sphere><radius>0.5</radius></sphere>"}[shape]
    for pose, side in (("0 0 0.6 0.3 0 0", None), ("0 0 2 0.3 0 0", "above"), ("0 0 -0.6 0.3 0 0", "below")):
        world, warned = read(sdf.solid(text, pose), laser_height=0.3)
        assert world.obstacles.is_empty == (side is not None)
        assert warned == ([f"world mine: omitted, because they are {side} the laser (at 0.3 m): m/c"] if side else [])


def test_only_collision_shapes_except_the_ground_are_obstacles_also_of_a_model_alone(read, write, sdf):
    plane = sdf.collision("<plane><normal>0 0 1</normal><size>100 100</size></plane>")
    visual = f"<visual name='v'><geometry>{sdf.box()}</geometry></visual>"
    world, warned = read(sdf.model(sdf.link(plane + visual)) + sdf.solid(sdf.cylinder()))
    assert (len(world.boxes), len(world.posts), warned) == (0, 1, [])
    path = write("pole.sdf", f"<sdf version='1.6'>{sdf.solid(sdf.cylinder())}</sdf>")
    assert posts(read_world(path, options=ImportOptions(start=(2, 0, 0)))) == [(0, 0, 0.2)]


@pytest.mark.parametrize(("tilt", "scale"), [(0, 1.0), (0.3, 1 / math.cos(0.3))])
def test_a_polyline_within_another_is_a_hole_and_one_within_that_is_none(read, tilt, scale):
    collision = f"<collision name='c'><geometry>{''.join(map(polyline, (3, 2, 0.5)))}</geometry></collision>"
    pose = f"9 9 -2 0 {tilt} 0"
    world, _ = read(f"<model name='m'><pose>{pose}</pose><link name='l'>{collision}</link></model>")
    middle = shapely.centroid(world.obstacles)
    for x, y, solid in ((0, 0, True), (0, 1.25, False), (1.25, 0, False), (0, -2.5, True), (2.5 * scale, 0, True)):
        assert (world.clearance(middle.x + x, middle.y + y) == 0) == solid, (x, y)
    assert world.obstacles.area == pytest.approx((36 - 16 + 1) * scale, rel=0.03)


def test_a_model_stands_where_the_frame_that_it_is_placed_by_is_put(read, write, sdf):
    hut = f"<frame name='wall'><pose>0 1 0 0 0 1.570796</pose></frame>{sdf.link(sdf.collision(sdf.cylinder(0.1)))}"
    write("models/hut/model.sdf", f"<sdf version='1.7'><model name='hut'>{hut}</model></sdf>")
    world, (warned,) = read(
        f"<model name='own' placement_frame='wall'><pose>1 0 0 0 0 0</pose>{hut}</model>"
        + state("<model name='c'><pose>8 8 0 0 0 0</pose></model>")
        + "".join(
            f"<include><name>{name}</name><uri>model://hut</uri><placement_frame>{frame}</placement_frame>"
            f"<pose>{pose}</pose></include>"
            for name, frame, pose in (("a", "wall", "0 9 0 0 0 0"), ("b", "gate", "7 7 0 0 0 0"), ("c", "wall", ""))
        )
    )
    assert posts(world) == [(-1, 9, 0.1), (0, 0, 0.1), (7, 7, 0.1), (8, 8, 0.1)]
    assert "gate (of b)" in warned


def state(*models):
    return f"<state world_name='default'><sim_time>1 0</sim_time>{''.join(models)}</state>"


def test_a_state_moves_scales_inserts_and_deletes_models(read, sdf):
    link = "<link name='link'><pose>7 8 0 0 0 0</pose></link>"
    world, warned = read(
        sdf.solid(sdf.cylinder(0.1), "1 1 0 0 0 0", "moved")
        + sdf.solid(sdf.cylinder(0.2), "2 2 0 0 0 0", "linked")
        + sdf.solid(sdf.cylinder(0.3), "3 3 0 0 0 0", "wide")
        + sdf.solid(sdf.cylinder(0.2), "2 2 0 0 0 0", "gone")
        + state(
            "<model name='moved'><pose>4 5 0 0 0 0</pose></model>",
            f"<model name='linked'>{link}</model>",
            "<model name='wide'><scale>3 3 1</scale></model>",
            f"<insertions>{sdf.solid(sdf.cylinder(0.4), '9 9 0 0 0 0', 'new')}</insertions>",
            "<deletions><name>gone</name></deletions>",
        )
    )
    assert posts(world) == [(3, 3, 0.9), (4, 5, 0.1), (7, 8, 0.2), (9, 9, 0.4)]
    assert warned == []


@pytest.mark.parametrize("place", ["models", "../models", "variable", "setting"])
def test_an_included_model_is_found_in_each_place(place, read, write, sdf, tmp_path, monkeypatch):
    folder = {"models": "worlds/models", "../models": "models"}.get(place, "elsewhere")
    for version, radius in (("1_3", 0.3), ("1_10", 0.2)):
        pole = sdf.solid(sdf.cylinder(radius), "1 0 0 0 0 0", "pole")
        write(f"{folder}/pole/model-{version}.sdf", f"<sdf version='1.6'>{pole}</sdf>")
    named = "".join(f"<sdf version='{v}'>model-{v.replace('.', '_')}.sdf</sdf>" for v in ("1.3", "1.10"))
    write(f"{folder}/pole/model.config", f"<model>{named}</model>")  # the highest version is read
    if place == "variable":
        monkeypatch.setenv("GAZEBO_MODEL_PATH", f"/nowhere:{tmp_path / folder}")
    placed = "<include><uri>model://pole</uri><name>{}</name><pose>5 6 0 0 0 0</pose></include>"
    world, warned = read(
        "<include><uri>model://pole</uri></include>"
        + placed.format("second")
        + placed.format("third")
        + state("<model name='second'><pose>7 7 0 0 0 0</pose></model>"),
        name="worlds/mine.world",
        model_path=(str(tmp_path / folder),) if place == "setting" else (),
    )
    assert posts(world) == [(1, 0, 0.2), (5, 6, 0.2), (7, 7, 0.2)]
    assert warned == []


def test_poses_can_be_relative_to_frames_in_degrees_and_quaternions(read, sdf):
    half, link = math.sqrt(0.5), sdf.link(sdf.collision(sdf.cylinder(), "0.5 0 0 0 0 0"))
    world, warned = read(
        f"""<frame name='corner'><pose>10 0 0 0 0 0</pose></frame>
        <model name='a'><pose relative_to='corner'>1 0 0 0 0 0</pose>{link}</model>
        <model name='b'><pose relative_to='corner' degrees='true'>2 0 0 0 0 90</pose>{link}</model>
        <model name='c'><pose rotation_format='quat_xyzw'>3 0 0 0 0 {half} {half}</pose>{link}</model>"""
    )
    assert posts(world) == [(3, 0.5, 0.2), (11.5, 0, 0.2), (12, 0.5, 0.2)]
    assert warned == []


def collision(shape):
    return f"<model name='m'><link name='l'><collision name='c'><geometry>{shape}</geometry></collision></link></model>"


@pytest.mark.parametrize(
    ("inside", "named"),
    [
        ("<include><uri>https://fuel.gazebosim.org/1.0/OpenRobotics/models/Sun</uri></include>", "models/Sun"),
        ("<include><uri>model://missing</uri></include>", "model://missing"),
        ("<actor name='walker'/>", "walker (<actor>)"),
        ("<state><model name='ghost'><pose>1 1 0 0 0 0</pose></model></state>", "ghost"),
        ("<model name='m'><plugin name='mover' filename='libmover.so'/></model>", "mover of m"),
        ("<model name='m'><pose relative_to='lost'>1 0 0 0 0 0</pose></model>", "lost (of m)"),
        (collision("<heightmap/>"), "<heightmap> shapes are not supported: m/c"),
        (collision("<plane><normal>1 0 0</normal></plane>"), "only horizontal planes are supported: m/c"),
        (collision("<mesh><uri>model://x/y.dae</uri></mesh>"), "m/c (model://x/y.dae)"),
    ],
)
def test_an_element_that_is_not_understood_is_named(inside, named, read, sdf):
    world, (warned,) = read(sdf.solid(sdf.cylinder(), name="known") + inside)
    assert posts(world) == [(0, 0, 0.2)]
    assert named in warned
    assert "\n" not in warned


def test_there_is_floor_around_everything_and_a_start_in_the_room_with_the_farthest_walls(read, sdf):
    world, _ = read(sdf.solid(sdf.cylinder()), start=(-3, 0, 0), goal=(0, 8, 0))
    assert world.free_space(0.5).covers(shapely.MultiPoint([(-3, 0), (0, 8)]))
    alone, _ = read(sdf.solid(sdf.cylinder()), start=None)
    assert alone.clearance(*alone.start[:2]) > 1
    empty, _ = read("", start=None)
    assert (empty.bounds, empty.start) == ((-5, -5, 5, 5), (0, 0, 0))

    def room(side, x):
        return sdf.solid(polyline(side / 2 + 0.1) + polyline(side / 2 - 0.1), f"{x} 0 0 0 0 0", f"room{x}")

    world, (warned,) = read(room(2, 0) + room(4, 20), start=None)  # and 17 m of floor between them, outside
    assert world.start == pytest.approx((20, 0, 0), abs=0.02)
    assert "no start is given, so the start is [" in warned
