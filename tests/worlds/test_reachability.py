"""Reachability: rooms, doors that are too narrow, and a goal."""

from __future__ import annotations

import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds.reachability import find_reachability
from tb2rl.worlds.world import World

RADIUS = 0.178  # of a TurtleBot2


def rooms(*doors, goal=None):
    """Rooms of 3 x 3 m in a row, with doors of these widths [m] between them."""
    length = 3 * (len(doors) + 1)
    boxes = [(length / 2, y, length, 0.1, 0) for y in (-0.05, 3.05)]
    boxes += [(x, 1.5, 0.1, 3.2, 0) for x in (-0.05, length + 0.05)]
    for number, door in enumerate(doors, start=1):
        side = (3 - door) / 2
        boxes += [(3 * number, y, 0.1, side, 0) for y in (side / 2, 3 - side / 2)]
    return World.from_shapes("rooms", boxes, start=(1.5, 1.5, 0), goal=goal)


def test_wide_doors_let_the_robot_through():
    found = find_reachability(rooms(1.0, 0.8, goal=(8, 1, 0)), RADIUS)
    assert (found.unreached, found.doors, found.goal_reached) == ((), (), True)
    assert found.reached == pytest.approx(found.floor, rel=0.02)


def test_every_narrow_door_is_named_with_its_width_and_the_region_behind_it():
    found = find_reachability(rooms(1.0, 0.3, goal=(8, 1, 0)), RADIUS)
    (door,), (region,) = found.doors, found.unreached
    assert door.width == pytest.approx(0.3, abs=0.002)
    assert door.place == pytest.approx((6, 1.5), abs=0.2)
    assert (region.area, region.closed) == (pytest.approx(8.7, rel=0.03), False)
    assert found.reached / found.floor == pytest.approx(2 / 3, abs=0.02)
    assert found.goal_reached is False
    assert find_reachability(rooms(1.0, 0.3), 0.149).doors == (), "it depends on the robot"
    doors = find_reachability(rooms(0.2, 0.3, 0.35), RADIUS).doors
    assert sorted(door.width for door in doors) == pytest.approx([0.2, 0.3, 0.35], abs=0.002)


def test_a_room_without_a_door_is_closed():
    found = find_reachability(rooms(0.0), RADIUS)
    assert found.doors == ()
    assert [region.closed for region in found.unreached] == [True]


def test_a_start_in_a_wall_is_refused():
    with pytest.raises(InputError, match="inside a wall"):
        find_reachability(World.from_shapes("full", [(0, 0, 1, 1, 0)], start=(0, 0, 0), bounds=(-9, -9, 9, 9)), RADIUS)
