"""How movers move, compiled; both simulations call this, so that the same episode has the same movers in both.

Posts and boxes go straight, along a path or to random points. People walk by the social force model of Moussaid et al.
2009, "Experimental study of the behavioural mechanisms underlying self-organization in human crowds", with its numbers.
A mover that runs into the robot has touched it and stops there: nothing pushes the robot.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, X, Y, gap_to, reach_of
from tb2rl.simulation.obstacles.social_force import social_force
from tb2rl.simulation.random_streams import uniform
from tb2rl.simulation.spec import BOUNDS, RADIUS
from tb2rl.worlds.geometry import clearance_one

# The columns of a table of movers, after their outlines.
VX, VY = 6, 7  # [m/s] of people
TARGET_X, TARGET_Y = 8, 9  # [m] where to, unless along a path
SPEED = 10  # [m/s] at which it goes, or wants to
PATIENCE = 11  # [s] until it looks for another target
NEXT, STRIDE = 12, 13  # number of the path's point that it goes to, and 1, or -1 on the way back
FORCE_X, FORCE_Y = 14, 15  # [m/s^2] room to calculate in
ROOM = 16  # [m] that a person may go until it has to look at walls
# What no step changes: the kind; the first of its points among all paths', how many, whether from the last one on to
# the first; whether it walks around the robot; the range of its speed [m/s].
KIND, FIRST, COUNT, CLOSED, AVOIDS, SLOWEST, FASTEST = range(17, 24)
MOVER_COLUMNS = 24
NOBODY, PATH, STRAIGHT, PERSON = range(4)  # kinds

THINK = 4  # physics steps between two decisions: 20 a second
RELAXATION = 0.54  # [s] to the wanted velocity; this and the following: Moussaid et al. 2009
STRENGTH = 4.5  # [m/s^2] of the force between two people
WALL_STRENGTH, WALL_REACH = 3.0, 0.1  # [m/s^2], [m]
HURRY = 1.3  # people are at most so many times as fast as they want to be (Helbing and Molnar 1995)
_FELT = 0.6  # [m] a wall farther away is not felt
_MARGIN = 0.1  # [m] that targets are off the walls, and the ways there
_ARRIVED = 0.3  # [m] from a target, a person looks for the next one
HALT = 2e-3  # [m] at which a mover touches the robot: PyBullet's bodies push each other from 1 mm on
_WAITS = 1.0  # [s] that a mover waits for the robot to go, unless it is on a path, before it goes elsewhere
_TRIES = 4  # directions that a mover looks in: it takes the one in which it gets farthest
_NEAREST, _FARTHEST = 1.0, 6.0  # [m] to where it looks, at most
_TINY = 1e-3  # [m]


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def think(i, span, dynamic_obstacles, streams, starts, boxes, posts, parts, lists, world, x, y, vx, vy):
    """What the movers of robot `i` decide for the next `span` [s]: where to, and how people walk there.

    Args:
        i: Which robot it is.
        span: [s].
        dynamic_obstacles: Of all robots, shape (num_envs, movers, 24); changed in place.
        streams: Key of each robot's stream of random numbers for them, and how many were drawn, shape (num_envs, 2).
        starts: Of all robots.
        boxes, posts, parts, lists: The `Index` of the worlds.
        world: The robot's in it.
        x, y, vx, vy: Where the robot is [m] and its velocity [m/s].
    """
    for k in range(dynamic_obstacles.shape[1]):
        if dynamic_obstacles[i, k, KIND] < STRAIGHT:
            continue
        left = math.hypot(
            dynamic_obstacles[i, k, TARGET_X] - dynamic_obstacles[i, k, X],
            dynamic_obstacles[i, k, TARGET_Y] - dynamic_obstacles[i, k, Y],
        )
        dynamic_obstacles[i, k, PATIENCE] -= span
        if dynamic_obstacles[i, k, PATIENCE] <= 0.0 or left < (
            _ARRIVED if dynamic_obstacles[i, k, KIND] == PERSON else _TINY
        ):
            _aim(i, k, dynamic_obstacles, streams, starts, boxes, posts, parts, lists, world)
        if dynamic_obstacles[i, k, KIND] == PERSON:
            _want(i, k, dynamic_obstacles)
    for k in range(dynamic_obstacles.shape[1]):
        for other in range(k + 1, dynamic_obstacles.shape[1]):
            _feel_each_other(i, k, other, dynamic_obstacles)
    for k in range(dynamic_obstacles.shape[1]):
        if dynamic_obstacles[i, k, KIND] == PERSON:
            _feel(i, k, dynamic_obstacles, boxes, posts, parts, lists, world, x, y, vx, vy, starts[i, RADIUS])
            east, north = (
                dynamic_obstacles[i, k, VX] + span * dynamic_obstacles[i, k, FORCE_X],
                dynamic_obstacles[i, k, VY] + span * dynamic_obstacles[i, k, FORCE_Y],
            )
            cut = min(1.0, HURRY * dynamic_obstacles[i, k, SPEED] / max(math.sqrt(east * east + north * north), 1e-9))
            dynamic_obstacles[i, k, VX], dynamic_obstacles[i, k, VY] = cut * east, cut * north


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def walk(i, duration, dynamic_obstacles, routes, boxes, posts, parts, lists, world, x, y, radius):
    """Move the movers of robot `i` for a physics step of `duration` [s], up to where they run into the robot.

    Args:
        i, movers, boxes, posts, parts, lists, world: As in `think`.
        duration: [s].
        routes: The points of all paths [m], shape (points, 2).
        x, y, radius: Of the robot [m].

    Returns:
        Whether one of them has run into it.
    """
    touched = False
    for k in range(dynamic_obstacles.shape[1]):
        kind, from_x, from_y = dynamic_obstacles[i, k, KIND], dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y]
        if kind == NOBODY:
            continue
        cos, sin, point, stride = (
            dynamic_obstacles[i, k, COS],
            dynamic_obstacles[i, k, SIN],
            dynamic_obstacles[i, k, NEXT],
            dynamic_obstacles[i, k, STRIDE],
        )
        if kind == PATH:
            to_x, to_y = _follow(i, k, dynamic_obstacles, routes, duration * dynamic_obstacles[i, k, SPEED])
        elif kind == STRAIGHT:
            east, north = dynamic_obstacles[i, k, TARGET_X] - from_x, dynamic_obstacles[i, k, TARGET_Y] - from_y
            share = min(
                1.0, duration * dynamic_obstacles[i, k, SPEED] / max(math.sqrt(east * east + north * north), 1e-9)
            )
            to_x, to_y = from_x + share * east, from_y + share * north
        else:
            to_x, to_y = _keep_off_walls(i, k, duration, dynamic_obstacles, boxes, posts, parts, lists, world)
        east, north = to_x - from_x, to_y - from_y
        length = math.sqrt(east * east + north * north)
        if length > 1e-9:
            dynamic_obstacles[i, k, COS], dynamic_obstacles[i, k, SIN] = east / length, north / length
        share = share_until_touch(x - from_x, y - from_y, x - to_x, y - to_y, radius + HALT, dynamic_obstacles, i, k)
        if share < 1.0:
            touched = True
            dynamic_obstacles[i, k, VX], dynamic_obstacles[i, k, VY] = 0.0, 0.0
            dynamic_obstacles[i, k, PATIENCE] = min(dynamic_obstacles[i, k, PATIENCE], _WAITS)
            dynamic_obstacles[i, k, NEXT], dynamic_obstacles[i, k, STRIDE] = point, stride
            to_x, to_y = from_x + share * (to_x - from_x), from_y + share * (to_y - from_y)
            if share == 0.0:  # nor does a box turn
                dynamic_obstacles[i, k, COS], dynamic_obstacles[i, k, SIN] = cos, sin
        elif kind != PERSON:
            dynamic_obstacles[i, k, VX], dynamic_obstacles[i, k, VY] = (
                (to_x - from_x) / duration,
                (to_y - from_y) / duration,
            )
        dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y] = to_x, to_y
    return touched


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def share_until_touch(from_east, from_north, to_east, to_north, radius, dynamic_obstacles, i, k):
    """How much of its way the robot or a mover goes until they touch, from 0 to 1: all of it, if it leads off.

    Args:
        from_east, from_north, to_east, to_north: The robot's way, seen from the middle of the mover [m].
        radius: Of the robot [m].
        movers, i, k: Mover `k` of robot `i`.
    """
    gap = gap_to(to_east, to_north, dynamic_obstacles, i, k) - radius
    if gap >= 0.0 or gap > gap_to(from_east, from_north, dynamic_obstacles, i, k) - radius:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(16):
        middle = 0.5 * (low + high)
        east, north = from_east + middle * (to_east - from_east), from_north + middle * (to_north - from_north)
        if gap_to(east, north, dynamic_obstacles, i, k) < radius:
            high = middle
        else:
            low = middle
    return low


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _follow(i, k, dynamic_obstacles, routes, left):
    """Where a mover is on its path after `left` [m] more: there and back, or around."""
    x, y, first, count = (
        dynamic_obstacles[i, k, X],
        dynamic_obstacles[i, k, Y],
        int(dynamic_obstacles[i, k, FIRST]),
        int(dynamic_obstacles[i, k, COUNT]),
    )
    for _ in range(count + 1):  # a path may be shorter than a step
        point, stride = int(dynamic_obstacles[i, k, NEXT]), int(dynamic_obstacles[i, k, STRIDE])
        east, north = routes[first + point, 0] - x, routes[first + point, 1] - y
        distance = math.sqrt(east * east + north * north)
        if distance > left:
            return x + left / distance * east, y + left / distance * north
        x, y, left = x + east, y + north, left - distance
        if dynamic_obstacles[i, k, CLOSED] != 0.0:
            dynamic_obstacles[i, k, NEXT] = (point + 1) % count
        else:
            stride = stride if 0 <= point + stride < count else -stride
            dynamic_obstacles[i, k, NEXT], dynamic_obstacles[i, k, STRIDE] = point + stride, stride
    return x, y


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _aim(i, k, dynamic_obstacles, streams, starts, boxes, posts, parts, lists, world):
    """Give a mover its next target: of some random points that it can go straight to, the farthest."""
    x, y, best = dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y], 0.0
    dynamic_obstacles[i, k, TARGET_X], dynamic_obstacles[i, k, TARGET_Y] = x, y
    needed = min(reach_of(dynamic_obstacles, i, k) + _MARGIN, clearance_one(x, y, boxes, posts, parts, lists, world))
    for _ in range(_TRIES):
        angle = math.tau * uniform(streams[i, 0], streams[i, 1])
        farthest = _NEAREST + (_FARTHEST - _NEAREST) * uniform(streams[i, 0], streams[i, 1] + np.uint64(1))
        streams[i, 1] += np.uint64(2)
        cos, sin, way, free = math.cos(angle), math.sin(angle), 0.0, 0.0
        while way < farthest:
            way = min(way + max(free, 0.05), farthest)
            at_x, at_y = x + way * cos, y + way * sin
            free = clearance_one(at_x, at_y, boxes, posts, parts, lists, world) - needed
            inside = starts[i, BOUNDS.start] <= at_x <= starts[i, BOUNDS.start + 2]
            inside = inside and starts[i, BOUNDS.start + 1] <= at_y <= starts[i, BOUNDS.start + 3]
            if free < 0.0 or not inside:
                break
            if way > best:
                best = way
                dynamic_obstacles[i, k, TARGET_X], dynamic_obstacles[i, k, TARGET_Y] = at_x, at_y
    dynamic_obstacles[i, k, PATIENCE] = 2.0 + 2.0 * best / dynamic_obstacles[i, k, SPEED] if best > 0.0 else 0.0


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def _want(i, k, dynamic_obstacles):
    """The force on a person towards its target."""
    east, north = (
        dynamic_obstacles[i, k, TARGET_X] - dynamic_obstacles[i, k, X],
        dynamic_obstacles[i, k, TARGET_Y] - dynamic_obstacles[i, k, Y],
    )
    wanted = dynamic_obstacles[i, k, SPEED] / max(math.sqrt(east * east + north * north), 1e-9)
    dynamic_obstacles[i, k, FORCE_X] = (wanted * east - dynamic_obstacles[i, k, VX]) / RELAXATION
    dynamic_obstacles[i, k, FORCE_Y] = (wanted * north - dynamic_obstacles[i, k, VY]) / RELAXATION


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def _feel_each_other(i, k, other, dynamic_obstacles):
    """The forces between two movers, on those of them that are people: one is the other turned round."""
    kind, others = dynamic_obstacles[i, k, KIND], dynamic_obstacles[i, other, KIND]
    if kind == NOBODY or others == NOBODY or (kind != PERSON and others != PERSON):
        return
    east, north = (
        dynamic_obstacles[i, other, X] - dynamic_obstacles[i, k, X],
        dynamic_obstacles[i, other, Y] - dynamic_obstacles[i, k, Y],
    )
    faster = (
        dynamic_obstacles[i, k, VX] - dynamic_obstacles[i, other, VX],
        dynamic_obstacles[i, k, VY] - dynamic_obstacles[i, other, VY],
    )
    aside_x, aside_y = social_force(east, north, *faster)
    distance = max(math.sqrt(east * east + north * north), 1e-9)
    # Bodies do not pass through each other; what is as near as a wall pushes like one.
    if kind == PERSON:
        push = _push(gap_to(-east, -north, dynamic_obstacles, i, other) - dynamic_obstacles[i, k, LENGTH]) / distance
        dynamic_obstacles[i, k, FORCE_X] = dynamic_obstacles[i, k, FORCE_X] + STRENGTH * aside_x - push * east
        dynamic_obstacles[i, k, FORCE_Y] = dynamic_obstacles[i, k, FORCE_Y] + STRENGTH * aside_y - push * north
    if others == PERSON:
        push = _push(gap_to(east, north, dynamic_obstacles, i, k) - dynamic_obstacles[i, other, LENGTH]) / distance
        dynamic_obstacles[i, other, FORCE_X] = dynamic_obstacles[i, other, FORCE_X] - STRENGTH * aside_x + push * east
        dynamic_obstacles[i, other, FORCE_Y] = dynamic_obstacles[i, other, FORCE_Y] - STRENGTH * aside_y + push * north


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def _feel(
    i, k, dynamic_obstacles, boxes, posts, parts, lists, world, robot_x, robot_y, robot_vx, robot_vy, robot_radius
):
    """The forces on a person off walls, and off the robot if it sees that."""
    x, y, force_x, force_y = (
        dynamic_obstacles[i, k, X],
        dynamic_obstacles[i, k, Y],
        dynamic_obstacles[i, k, FORCE_X],
        dynamic_obstacles[i, k, FORCE_Y],
    )
    if dynamic_obstacles[i, k, AVOIDS] != 0.0:
        east, north = robot_x - x, robot_y - y
        aside_x, aside_y = social_force(
            east, north, dynamic_obstacles[i, k, VX] - robot_vx, dynamic_obstacles[i, k, VY] - robot_vy
        )
        distance = max(math.sqrt(east * east + north * north), 1e-9)
        push = _push(distance - robot_radius - dynamic_obstacles[i, k, LENGTH]) / distance
        force_x, force_y = force_x + STRENGTH * aside_x - push * east, force_y + STRENGTH * aside_y - push * north
    gap = clearance_one(x, y, boxes, posts, parts, lists, world) - dynamic_obstacles[i, k, LENGTH]
    if gap < _FELT:
        off_x, off_y = _off_walls(x, y, boxes, posts, parts, lists, world)
        push = _push(gap)
        force_x, force_y = force_x + push * off_x, force_y + push * off_y
    dynamic_obstacles[i, k, FORCE_X], dynamic_obstacles[i, k, FORCE_Y], dynamic_obstacles[i, k, ROOM] = (
        force_x,
        force_y,
        min(gap, _FARTHEST) - _TINY,
    )


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def _push(gap):
    """The force [m/s^2] off a wall, or a body, that is so far away [m]."""
    return WALL_STRENGTH * math.exp(-max(gap, -WALL_REACH) / WALL_REACH)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _off_walls(x, y, boxes, posts, parts, lists, world):
    """The direction that leads away from the nearest wall, a vector of length 1 at most."""
    right = clearance_one(x + _TINY, y, boxes, posts, parts, lists, world)
    left = clearance_one(x - _TINY, y, boxes, posts, parts, lists, world)
    above = clearance_one(x, y + _TINY, boxes, posts, parts, lists, world)
    below = clearance_one(x, y - _TINY, boxes, posts, parts, lists, world)
    return (right - left) / (2.0 * _TINY), (above - below) / (2.0 * _TINY)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _keep_off_walls(i, k, duration, dynamic_obstacles, boxes, posts, parts, lists, world):
    """Where a person is after a step: along a wall, not into it."""
    x, y, radius = dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y], dynamic_obstacles[i, k, LENGTH]
    vx, vy = dynamic_obstacles[i, k, VX], dynamic_obstacles[i, k, VY]
    to_x, to_y = x + duration * vx, y + duration * vy
    dynamic_obstacles[i, k, ROOM] -= duration * (abs(vx) + abs(vy))  # it goes less far than that
    if dynamic_obstacles[i, k, ROOM] > 0.0:
        return to_x, to_y
    clearance = clearance_one(to_x, to_y, boxes, posts, parts, lists, world)
    if clearance >= radius:
        return to_x, to_y
    here = clearance_one(x, y, boxes, posts, parts, lists, world)
    if clearance >= here:
        return to_x, to_y
    off_x, off_y = _off_walls(x, y, boxes, posts, parts, lists, world)
    into = min(vx * off_x + vy * off_y, 0.0)
    vx, vy = vx - into * off_x, vy - into * off_y
    to_x, to_y = x + duration * vx, y + duration * vy
    if clearance_one(to_x, to_y, boxes, posts, parts, lists, world) < min(radius, here) - _TINY:
        vx, vy, to_x, to_y = 0.0, 0.0, x, y
    dynamic_obstacles[i, k, VX], dynamic_obstacles[i, k, VY] = vx, vy
    return to_x, to_y


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def out_of_reach(x, y, speed, duration, radius, dynamic_obstacles, i):
    """Whether robot `i` and its movers can neither meet nor see each other in a control step.

    Then robot and movers go through it by themselves, which takes far less time.

    Args:
        x, y: Where the robot is [m].
        speed: As fast as it can become [m/s].
        duration: Of the step [s].
        radius: Of the robot [m].
        dynamic_obstacles: Of all robots.
        i: Which robot it is.
    """
    for k in range(dynamic_obstacles.shape[1]):
        if dynamic_obstacles[i, k, LENGTH] > 0.0:
            apart = math.hypot(dynamic_obstacles[i, k, X] - x, dynamic_obstacles[i, k, Y] - y)
            way = duration * (speed + HURRY * dynamic_obstacles[i, k, SPEED])
            if (
                dynamic_obstacles[i, k, AVOIDS] != 0.0
                or apart < radius + HALT + reach_of(dynamic_obstacles, i, k) + way
            ):
                return False
    return True


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def step_obstacles_alone(
    i, steps, part, dynamic_obstacles, walks, routes, starts, boxes, posts, parts, lists, world, x, y
):
    """A control step of the movers of robot `i`, which is out of reach: so many physics steps of `part` [s].

    `x`, `y` [m] are where it is at the beginning; out of reach, it makes no difference where it goes.
    """
    for step in range(steps):
        if step % THINK == 0:
            span = min(THINK, steps - step) * part
            think(i, span, dynamic_obstacles, walks, starts, boxes, posts, parts, lists, world, x, y, 0.0, 0.0)
        walk(i, part, dynamic_obstacles, routes, boxes, posts, parts, lists, world, x, y, 0.0)
