"""Reachability analysis: the area that a robot can reach, and doors that are too narrow for it."""

from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from tb2rl.core.values import Point
from tb2rl.worlds.world import World

_TOLERANCE = 5e-4  # [m] for the simplification of outlines, because thousands of exact posts take seconds
_MIN_AREA = 0.05  # [m^2] smaller parts of the floor are ignored
_BISECTIONS = 12  # enough to find the width of a door to 0.1 mm


@dataclass(frozen=True)
class Region:
    """A region with room for the robot that the robot cannot reach."""

    point: Point  # a point in the region, x and y [m]
    area: float  # area that the robot would cover there [m^2]
    closed: bool  # whether the region is enclosed, so that no robot, however small, can reach it


@dataclass(frozen=True)
class Door:
    """A passage that is too narrow for the robot."""

    centre: Point  # x and y [m]
    width: float  # diameter of the widest robot that passes [m]


@dataclass(frozen=True)
class Reachability:
    """Reachability of a world for one robot."""

    floor_area: float  # area without obstacles [m^2]
    reachable_area: float  # area that the robot can cover from the start [m^2]
    unreachable: tuple[Region, ...]  # largest first
    doors: tuple[Door, ...]  # each between two areas with room for the robot
    goal_is_reachable: bool | None  # whether the robot's centre can be at the goal; None for a world without a goal


def find_reachability(world: World, radius: float) -> Reachability:
    """Find the regions that a round robot of this radius [m] can and cannot reach from the start of a world.

    Raises:
        InputError: If the start has no room for the robot.
    """
    inside, obstacles = shapely.box(*world.bounds), shapely.union_all(shapely.simplify(world.outlines(), _TOLERANCE))
    floor, start = inside.difference(obstacles), shapely.Point(world.start[:2])
    free = inside.buffer(-radius).difference(obstacles.buffer(radius))  # positions of the robot's centre
    rooms = [part for part in shapely.get_parts(free) if part.area > 0]
    start_rooms = [room for room in rooms if room.distance(start) <= 2 * _TOLERANCE]
    reachable = start_rooms[0] if start_rooms else world.free_space(radius)  # raises the `InputError`
    other_rooms = [room for room in rooms if not room.intersects(reachable) and room.buffer(radius).area > _MIN_AREA]
    other_rooms.sort(key=lambda room: -room.area)
    connected = shapely.union_all([part for part in shapely.get_parts(floor) if part.intersects(reachable)])
    unreachable = tuple(
        Region(room.representative_point().coords[0], room.buffer(radius).area, not connected.intersects(room))
        for room in other_rooms
    )
    doors = tuple(_find_doors(inside, obstacles, [reachable, *other_rooms], radius))
    reaches_goal = None if world.goal is None else reachable.distance(shapely.Point(world.goal[:2])) <= 2 * _TOLERANCE
    return Reachability(floor.area, reachable.buffer(radius).intersection(floor).area, unreachable, doors, reaches_goal)


def _find_doors(inside: BaseGeometry, obstacles: BaseGeometry, rooms: list[BaseGeometry], radius: float) -> list[Door]:
    """Find doors: floor that the robot cannot cover, between the areas that it covers from two or more rooms."""
    covered = [room.buffer(radius * 1.001) for room in rooms]  # enlarged, because arcs are polygons
    pieces = shapely.get_parts(inside.difference(obstacles).difference(shapely.union_all(covered)))
    door_parts = [piece for piece in pieces if sum(area.distance(piece) < 1e-6 for area in covered) >= 2]
    doors = []
    for door in shapely.get_parts(shapely.union_all([piece.buffer(radius) for piece in door_parts])):
        surroundings = door.buffer(2 * radius).envelope
        nearest = sorted(rooms, key=door.distance)[:2]
        width = _door_width(inside.intersection(surroundings), obstacles.intersection(surroundings), nearest, radius)
        if width > 0:
            doors.append(Door((door.centroid.x, door.centroid.y), width))
    return doors


def _door_width(inside: BaseGeometry, obstacles: BaseGeometry, rooms: list[BaseGeometry], radius: float) -> float:
    """Diameter of the widest robot, up to this radius, that gets from one of two rooms to the other [m]."""
    low, high = 0.0, radius
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        free = inside.difference(obstacles.buffer(middle))
        passes = any(all(part.intersects(room) for room in rooms) for part in shapely.get_parts(free))
        low, high = (middle, high) if passes else (low, middle)
    return 2 * low
