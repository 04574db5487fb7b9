"""Solid shapes cut at a height, against points inside of them by definition."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.worlds.formats.poses import rotation_from_rpy
from tb2rl.worlds.formats.slices import Slice
from tb2rl.worlds.world import World


def pose(turn, place=(0.3, -0.2, 0.4)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_from_rpy(*turn), place
    return matrix


def obstacles(cut):
    return World.from_shapes("cut", cut.boxes, cut.posts, start=(0, 0, 0), bounds=(-9, -9, 9, 9)).obstacles


def misplaced(cut, at, inside):
    """Where obstacles and a shape differ [m from its border], of points in the plane; `inside` takes its own frame."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 2, (4000, 2)), np.full(4000, cut.height)])
    parts = shapely.get_parts(obstacles(cut))
    seen = shapely.union_all([shapely.Polygon(part.exterior) for part in parts])  # no laser sees gaps within
    covered = shapely.contains_xy(seen, points[:, 0], points[:, 1])
    wrong = points[covered != inside((points - at[:3, 3]) @ at[:3, :3])]
    assert covered.sum() > 20
    return max((seen.boundary.distance(shapely.Point(point)) for point in wrong), default=0.0)


@pytest.mark.parametrize("turn", [(0, 0, 0.7), (math.pi, 0, 0.3), (0.5, 0.5, -1.0), (math.pi / 2, 0, 0.3)])
def test_a_box_and_a_cylinder_turned_in_any_way_are_their_cross_sections(turn):
    at, half = pose(turn), np.array([0.8, 0.3, 0.5])
    box, cylinder = Slice(0.25), Slice(0.25)
    box.add_box(at, half)
    cylinder.add_cylinder(at, 0.5, 1.2)
    assert misplaced(box, at, lambda own: (np.abs(own) <= half).all(axis=1)) < 0.006
    within = misplaced(cylinder, at, lambda own: (np.hypot(own[:, 0], own[:, 1]) <= 0.5) & (np.abs(own[:, 2]) <= 0.6))
    assert within < 0.006
    if abs(at[2, 2]) == 1.0:
        assert (len(box.boxes), len(cylinder.posts)) == (1, 1), "an upright shape stays one box or one post"


@pytest.mark.parametrize("corners", [3, 6])
def test_an_outline_is_filled_and_nothing_sticks_out(corners):
    angles = np.arange(corners) * math.tau / corners
    outline = shapely.Polygon(np.column_stack([np.cos(angles), np.sin(angles)]))
    cut = Slice(0.25)
    cut.add_polygons(outline)
    assert obstacles(cut).difference(outline.buffer(0.009)).area < 1e-9
    hole = outline.difference(obstacles(cut))
    assert hole.is_empty or max(shapely.maximum_inscribed_circle(part).length for part in shapely.get_parts(hole)) < 0.1
