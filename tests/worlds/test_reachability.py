"""Reachability: rooms, doors that are too narrow, and a goal."""

import pytest

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


def test_wide_doors_let_the_robot_through_and_a_room_without_a_door_is_closed():
    found = find_reachability(rooms(1.0, 0.8, goal=(8, 1, 0)), RADIUS)
    assert (found.unreachable, found.doors, found.goal_is_reachable) == ((), (), True)
    assert found.reachable_area == pytest.approx(found.floor_area, rel=0.02)
    found = find_reachability(rooms(0.0), RADIUS)
    assert (found.doors, [region.closed for region in found.unreachable]) == ((), [True])


def test_every_narrow_door_is_named_with_its_width_and_the_region_behind_it():
    found = find_reachability(rooms(1.0, 0.3, goal=(8, 1, 0)), RADIUS)
    (door,), (region,) = found.doors, found.unreachable
    assert door.width == pytest.approx(0.3, abs=0.002)
    assert door.centre == pytest.approx((6, 1.5), abs=0.2)
    assert (region.area, region.closed) == (pytest.approx(8.7, rel=0.03), False)
    assert found.reachable_area / found.floor_area == pytest.approx(2 / 3, abs=0.02)
    assert found.goal_is_reachable is False
    assert find_reachability(rooms(1.0, 0.3), 0.149).doors == (), "it depends on the robot"
    doors = find_reachability(rooms(0.2, 0.3, 0.35), RADIUS).doors
    assert sorted(door.width for door in doors) == pytest.approx([0.2, 0.3, 0.35], abs=0.002)
