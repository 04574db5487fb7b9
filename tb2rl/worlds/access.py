"""What a robot can reach in a world: how much of the floor, which parts it cannot, and which doors are in its way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.values import Point
from tb2rl.worlds.world import World

_FINE = 5e-4  # [m] by which posts are simpler than they are drawn elsewhere: thousands of them take seconds
_TOUCH = 1e-6  # [m]
_SMALLEST = 0.05  # [m^2] a part of the floor below is none to drive in
_ROUND = 16  # segments of a quarter circle: circles are off by a five-hundredth of the robot
_STEPS = 12  # halvings of the robot's radius: a door's width is known to a tenth of a millimetre


@dataclass(frozen=True)
class Part:
    """A part of the floor where the robot would fit, but to where it cannot drive.

    Attributes:
        place: A point of it, x and y [m].
        area: [m^2]
        closed: Whether not even a point could get there.
    """

    place: Point
    area: float
    closed: bool


@dataclass(frozen=True)
class Door:
    """A way that is too narrow: `place` is x and y of its middle [m], `width` how wide a robot may be [m]."""

    place: Point
    width: float


@dataclass(frozen=True)
class Access:
    """What a robot can reach.

    Attributes:
        floor: Area that is free of obstacles [m^2].
        reached: Area that the robot's base can be on [m^2].
        parts: What it cannot reach, largest first.
        doors: Between such parts and others.
        goal_reached: Whether its middle can be where the goal is; None for a world without a goal.
    """

    floor: float
    reached: float
    parts: tuple[Part, ...]
    doors: tuple[Door, ...]
    goal_reached: bool | None


def find_access(world: World, radius: float) -> Access:
    """What a round robot can reach from the start.

    Raises:
        InputError: If there is no room for it at the start.
    """
    inside, obstacles = shapely.box(*world.bounds), shapely.union_all(shapely.simplify(world.outlines(), _FINE))
    floor, start = inside.difference(obstacles), shapely.Point(world.start[:2])
    every = _rooms(inside, obstacles, radius)
    near = [room for room in every if room.distance(start) <= 2 * _FINE]
    reached = near[0] if near else world.free_space(radius)  # which says why there is none
    rooms = [room for room in every if not room.intersects(reached) and _covered(room, radius).area > _SMALLEST]
    rooms.sort(key=lambda room: -room.area)
    ways = [part for part in shapely.get_parts(floor) if part.intersects(reached)]
    parts = [
        Part(_point(room), _covered(room, radius).area, not any(way.intersects(room) for way in ways)) for room in rooms
    ]
    doors = _doors(inside, obstacles, floor, [reached, *rooms], radius)
    goal = None if world.goal is None else bool(reached.buffer(2 * _FINE).covers(shapely.Point(world.goal[:2])))
    return Access(floor.area, _covered(reached, radius).intersection(floor).area, tuple(parts), tuple(doors), goal)


def _rooms(inside: BaseGeometry, obstacles: BaseGeometry, radius: float) -> Sequence[BaseGeometry]:
    """Where the middle of a robot can be, each part by itself."""
    free = inside.buffer(-radius).difference(obstacles.buffer(radius, quad_segs=_ROUND))
    return [part for part in shapely.get_parts(free) if part.area > 0]


def _covered(room: BaseGeometry, radius: float) -> BaseGeometry:
    return room.buffer(radius, quad_segs=_ROUND)


def _doors(
    inside: BaseGeometry, obstacles: BaseGeometry, floor: BaseGeometry, rooms: Sequence[BaseGeometry], radius: float
) -> list[Door]:
    """Where pieces of floor that no robot is ever on, such as the two sides of a door, lie between two rooms."""
    if len(rooms) < 2:
        return []
    covered = [_covered(room, radius * 1.001) for room in rooms]  # a little more: arcs are drawn with straight lines
    pieces = shapely.get_parts(floor.difference(shapely.union_all(covered)))
    between = [piece for piece in pieces if sum(area.distance(piece) < _TOUCH for area in covered) >= 2]
    doors = []
    for door in shapely.get_parts(shapely.union_all([piece.buffer(radius) for piece in between])):
        around = door.buffer(2 * radius).envelope
        one, other, *_ = sorted(rooms, key=door.distance)
        width = _width(inside.intersection(around), obstacles.intersection(around), one, other, radius)
        if width > 0:
            doors.append(Door((door.centroid.x, door.centroid.y), width))
    return doors


def _width(
    inside: BaseGeometry, obstacles: BaseGeometry, one: BaseGeometry, other: BaseGeometry, radius: float
) -> float:
    """How wide a robot may be to get from one room to the other [m]."""
    low, high = 0.0, radius
    for _ in range(_STEPS):
        middle = (low + high) / 2
        free = inside.difference(obstacles.buffer(middle, quad_segs=_ROUND))
        joined = any(part.intersects(one) and part.intersects(other) for part in shapely.get_parts(free))
        low, high = (middle, high) if joined else (low, middle)
    return 2 * low


def _point(shape: BaseGeometry) -> Point:
    point = shape.representative_point()
    return point.x, point.y
