"""How people walk, compiled: forces towards their target, off each other, off walls and off the robot.

Moussaid et al. 2009, "Experimental study of the behavioural mechanisms underlying self-organization in human crowds",
with its numbers.
"""

from __future__ import annotations

import math

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.obstacles.outlines import gap_to
from tb2rl.simulation.obstacles.records import EMPTY, PERSON
from tb2rl.worlds.geometry import clearance_at

MAX_SPEED_RATIO = 1.3  # of a person's largest speed to its wanted speed (Helbing and Molnar 1995)
_GAMMA, _LAMBDA, _N_TURN, _N_SLOW = 0.35, 2.0, 2.0, 3.0  # as in the article
_RELAXATION = 0.54  # [s] to the wanted velocity
_STRENGTH = 4.5  # [m/s^2] of the force between two people
_WALL_STRENGTH, _WALL_RANGE = 3.0, 0.1  # [m/s^2], [m]
_WALLS_FROM = 0.6  # [m] a wall farther away exerts no force
_MOST_ROOM = 6.0  # [m]
_TINY = 1e-3  # [m]


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def social_force(east, north, vx, vy):
    """Force of another person, divided by its strength: slow down and turn aside.

    Args:
        east, north: Position of the other one, relative to this one [m].
        vx, vy: Velocity of this one, relative to the other one [m/s].
    """
    distance = math.sqrt(east * east + north * north)
    if distance < 1e-9:
        return 0.0, 0.0
    towards_x, towards_y = east / distance, north / distance
    tx, ty = _LAMBDA * vx + towards_x, _LAMBDA * vy + towards_y
    size = math.sqrt(tx * tx + ty * ty)
    if size < 1e-9:
        return 0.0, 0.0
    tx, ty, reach = tx / size, ty / size, _GAMMA * size
    angle = math.atan2(tx * towards_y - ty * towards_x, tx * towards_x + ty * towards_y)
    slow = -math.exp(-distance / reach - (_N_SLOW * reach * angle) ** 2)
    turn = -math.exp(-distance / reach - (_N_TURN * reach * angle) ** 2) if angle != 0.0 else 0.0
    turn = math.copysign(turn, -angle)
    return slow * tx - turn * ty, slow * ty + turn * tx


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def head_for_target(person):
    """Set the force on a person to that towards its target."""
    east, north = person.target_x - person.x, person.target_y - person.y
    wanted = person.speed / max(math.sqrt(east * east + north * north), 1e-9)
    person.force_x = (wanted * east - person.vx) / _RELAXATION
    person.force_y = (wanted * north - person.vy) / _RELAXATION


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def repel_each_other(one, other):
    """Add the forces between two obstacles, on those of them that are people; they are equal and opposite."""
    if one.kind == EMPTY or other.kind == EMPTY or (one.kind != PERSON and other.kind != PERSON):
        return
    east, north = other.x - one.x, other.y - one.y
    aside_x, aside_y = social_force(east, north, one.vx - other.vx, one.vy - other.vy)
    distance = max(math.sqrt(east * east + north * north), 1e-9)
    # Bodies do not overlap, because a body as near as a wall repels like one.
    if one.kind == PERSON:
        push = _push(gap_to(-east, -north, other) - one.length) / distance
        one.force_x = one.force_x + _STRENGTH * aside_x - push * east
        one.force_y = one.force_y + _STRENGTH * aside_y - push * north
    if other.kind == PERSON:
        push = _push(gap_to(east, north, one) - other.length) / distance
        other.force_x = other.force_x - _STRENGTH * aside_x + push * east
        other.force_y = other.force_y - _STRENGTH * aside_y + push * north


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def repel_from_walls_and_robot(person, index, world, robot, robot_radius):
    """Add the forces of the walls, and of the robot (x, y [m], vx, vy [m/s]) on a person that avoids it."""
    x, y, force_x, force_y = person.x, person.y, person.force_x, person.force_y
    robot_x, robot_y, robot_vx, robot_vy = robot
    if person.avoids != 0.0:
        east, north = robot_x - x, robot_y - y
        aside_x, aside_y = social_force(east, north, person.vx - robot_vx, person.vy - robot_vy)
        distance = max(math.sqrt(east * east + north * north), 1e-9)
        push = _push(distance - robot_radius - person.length) / distance
        force_x, force_y = force_x + _STRENGTH * aside_x - push * east, force_y + _STRENGTH * aside_y - push * north
    gap = clearance_at(x, y, index, world) - person.length
    if gap < _WALLS_FROM:
        away_x, away_y = _away_from_walls(x, y, index, world)
        push = _push(gap)
        force_x, force_y = force_x + push * away_x, force_y + push * away_y
    person.force_x, person.force_y, person.room = force_x, force_y, min(gap, _MOST_ROOM) - _TINY


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def accelerate(person, duration):
    """Apply the force on a person for a `duration` [s]."""
    vx, vy = person.vx + duration * person.force_x, person.vy + duration * person.force_y
    slow = min(1.0, MAX_SPEED_RATIO * person.speed / max(math.sqrt(vx * vx + vy * vy), 1e-9))
    person.vx, person.vy = slow * vx, slow * vy


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def walk_along_walls(person, duration, index, world):
    """The position x, y [m] of a person after a `duration` [s]: along a wall, not into it."""
    x, y, radius, vx, vy = person.x, person.y, person.length, person.vx, person.vy
    to_x, to_y = x + duration * vx, y + duration * vy
    person.room -= duration * (abs(vx) + abs(vy))  # an upper bound of the distance
    if person.room > 0.0:
        return to_x, to_y
    clearance = clearance_at(to_x, to_y, index, world)
    if clearance >= radius:
        return to_x, to_y
    here = clearance_at(x, y, index, world)
    if clearance >= here:
        return to_x, to_y
    away_x, away_y = _away_from_walls(x, y, index, world)
    into = min(vx * away_x + vy * away_y, 0.0)
    vx, vy = vx - into * away_x, vy - into * away_y
    to_x, to_y = x + duration * vx, y + duration * vy
    if clearance_at(to_x, to_y, index, world) < min(radius, here) - _TINY:
        vx, vy, to_x, to_y = 0.0, 0.0, x, y
    person.vx, person.vy = vx, vy
    return to_x, to_y


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def _push(gap):
    """Force of a wall or a body at a distance [m]: [m/s^2]."""
    return _WALL_STRENGTH * math.exp(-max(gap, -_WALL_RANGE) / _WALL_RANGE)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _away_from_walls(x, y, index, world):
    """Direction away from the nearest wall, a vector of length 1 at most."""
    right = clearance_at(x + _TINY, y, index, world)
    left = clearance_at(x - _TINY, y, index, world)
    above = clearance_at(x, y + _TINY, index, world)
    below = clearance_at(x, y - _TINY, index, world)
    return (right - left) / (2.0 * _TINY), (above - below) / (2.0 * _TINY)
