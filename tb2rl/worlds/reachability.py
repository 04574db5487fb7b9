"""Reachability analysis: how much of a world's floor a robot reaches, and which narrow doors are in its way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.values import Point
from tb2rl.worlds.world import World

_FINE = 5e-4  # [m] tolerance to which round posts are simplified, because thousands of them take seconds
_TOUCH = 1e-6  # [m]
_SMALLEST = 0.05  # [m^2] smaller parts of the floor are ignored
_ROUND = 16  # segments of a quarter circle: circles are off by a five-hundredth of the robot
_STEPS = 12  # bisections of the robot's radius: the width of a door is known to a tenth of a millimetre


@dataclass(frozen=True)
class Region:
    """A region of the floor that the robot fits in but cannot reach.

    Attributes:
        place: A point in it, x and y [m].
        area: [m^2]
        closed: Whether it is closed on all sides, so that not even a point could get there.
    """

    place: Point
    area: float
    closed: bool


@dataclass(frozen=True)
class Door:
    """A passage that is too narrow: `place` is x and y of its middle [m], `width` the widest robot that fits [m]."""

    place: Point
    width: float


@dataclass(frozen=True)
class Reachability:
    """Reachability of a world for one robot.

    Attributes:
        floor: Area that is free of obstacles [m^2].
        reached: Area that the robot's base can cover [m^2].
        unreached: Regions that it cannot reach, largest first.
        doors: Narrow doors between two regions.
        goal_reached: Whether its centre can be at the goal; None for a world without a goal.
    """

    floor: float
    reached: float
    unreached: tuple[Region, ...]
    doors: tuple[Door, ...]
    goal_reached: bool | None


def find_reachability(world: World, radius: float) -> Reachability:
    """Analyse what a round robot can reach from the start.

    Raises:
        InputError: If there is no room for it at the start.
    """
    inside, obstacles = shapely.box(*world.bounds), shapely.union_all(shapely.simplify(world.outlines(), _FINE))
    floor, start = inside.difference(obstacles), shapely.Point(world.start[:2])
    rooms = _rooms(inside, obstacles, radius)
    near = [room for room in rooms if room.distance(start) <= 2 * _FINE]
    reached = near[0] if near else world.free_space(radius)  # which raises the error if there is none
    rooms = [room for room in rooms if not room.intersects(reached) and _covered(room, radius).area > _SMALLEST]
    rooms.sort(key=lambda room: -room.area)
    connected = [part for part in shapely.get_parts(floor) if part.intersects(reached)]
    unreached = [
        Region(
            room.representative_point().coords[0],
            _covered(room, radius).area,
            not any(part.intersects(room) for part in connected),
        )
        for room in rooms
    ]
    doors = _doors(inside, obstacles, floor, [reached, *rooms], radius)
    goal = None if world.goal is None else bool(reached.buffer(2 * _FINE).covers(shapely.Point(world.goal[:2])))
    covered = _covered(reached, radius).intersection(floor).area
    return Reachability(floor.area, covered, tuple(unreached), tuple(doors), goal)


def _rooms(inside: BaseGeometry, obstacles: BaseGeometry, radius: float) -> list[BaseGeometry]:
    """Connected parts of the free space of the robot's centre."""
    free = inside.buffer(-radius).difference(obstacles.buffer(radius, quad_segs=_ROUND))
    return [part for part in shapely.get_parts(free) if part.area > 0]


def _covered(room: BaseGeometry, radius: float) -> BaseGeometry:
    return room.buffer(radius, quad_segs=_ROUND)


def _doors(
    inside: BaseGeometry, obstacles: BaseGeometry, floor: BaseGeometry, rooms: Sequence[BaseGeometry], radius: float
) -> list[Door]:
    """Doors: where floor that no robot can cover lies between two rooms."""
    if len(rooms) < 2:
        return []
    covered = [_covered(room, radius * 1.001) for room in rooms]  # a little more, because arcs are polygons
    pieces = shapely.get_parts(floor.difference(shapely.union_all(covered)))
    between = [piece for piece in pieces if sum(area.distance(piece) < _TOUCH for area in covered) >= 2]
    doors = []
    for door in shapely.get_parts(shapely.union_all([piece.buffer(radius) for piece in between])):
        around = door.buffer(2 * radius).envelope
        nearest = sorted(rooms, key=door.distance)[:2]
        width = _width(inside.intersection(around), obstacles.intersection(around), nearest, radius)
        if width > 0:
            doors.append(Door((door.centroid.x, door.centroid.y), width))
    return doors


def _width(inside: BaseGeometry, obstacles: BaseGeometry, rooms: Sequence[BaseGeometry], radius: float) -> float:
    """Width of the widest robot that gets from one of two rooms to the other [m], by bisection."""
    low, high = 0.0, radius
    for _ in range(_STEPS):
        middle = (low + high) / 2
        free = inside.difference(obstacles.buffer(middle, quad_segs=_ROUND))
        joined = any(all(part.intersects(room) for room in rooms) for part in shapely.get_parts(free))
        low, high = (middle, high) if joined else (low, middle)
    return 2 * low
