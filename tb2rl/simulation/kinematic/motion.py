"""The compiled motion of the fast twin.

Arrays of all robots: poses (num_envs, 3) x [m], y [m], yaw [rad]; rims (num_envs, 2), speeds of the left and the right
wheel's rim [m/s]; commands (num_envs, 2), v [m/s] and w [rad/s]; starts (num_envs, 32), the columns of
`tb2rl.simulation.spec`, among them each robot's parameters and its flaws; boxes, posts, parts and lists, the
`Index` of all worlds.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.obstacles.outlines import cast_at_movers
from tb2rl.simulation.random_streams import normal, uniform
from tb2rl.simulation.spec import (
    ACCELERATION,
    ASSUMED_SEPARATION,
    BIAS,
    COUPLING,
    DROPPED,
    MAX_SPEED,
    MAX_TURN_RATE,
    MOUNT,
    NOISE,
    RADIUS,
    WHEEL,
    WHEEL_SEPARATION,
)
from tb2rl.worlds.geometry import cast_one, clearance_one, limit_ranges

CONTACT = 1.0e-4  # [m] a gap below this is contact
MOUNT_X, MOUNT_Y, MOUNT_YAW = MOUNT.start, MOUNT.start + 1, MOUNT.start + 2
_EMPTY = np.uint64(0x5851F42D4C957F2D)  # makes a stream for dropped beams of that for the laser's noise
_NUDGE = 1.0e-3  # [m] how far to look whether the way leads off a wall that is touched


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def move_along_arc(x, y, yaw, length, turn, radius, boxes, posts, parts, lists, world):
    """Move a robot along an arc, up to where an obstacle stops it; it turns all the same.

    Conservative advancement (Mirtich 1996): no step is longer than the gap to the nearest obstacle, so none is jumped
    over, however fast the robot is.

    Args:
        x, y, yaw: Pose [m, m, rad].
        length: Of the arc [m], negative backwards.
        turn: From its start to its end [rad].
        radius: Of the robot [m].
        boxes, posts, parts, lists: Of all worlds.
        world: The number of its own.

    Returns:
        The pose after it, the way [m], and whether an obstacle was touched.
    """
    whole = abs(length)
    left, bumped = whole, False
    while left > 0.0:
        gap = clearance_one(x, y, boxes, posts, parts, lists, world) - radius
        if gap < CONTACT:
            nudge = math.copysign(_NUDGE, length)
            off = clearance_one(x + nudge * math.cos(yaw), y + nudge * math.sin(yaw), boxes, posts, parts, lists, world)
            if off - radius <= gap:
                bumped = True
                break
            gap = _NUDGE
        part = min(gap, left)
        x, y, yaw = along_arc(x, y, yaw, math.copysign(part, length), turn * part / whole)
        left -= part
    if left > 0.0 or whole == 0.0:
        yaw += turn * left / whole if whole > 0.0 else turn
    return x, y, yaw, math.copysign(whole - left, length), bumped


@njit(cache=True, error_model="numpy", forceinline=True)
def along_arc(x, y, yaw, length, turn):
    """The pose at the end of an arc of `length` [m] and `turn` [rad]: its chord, at half the turn."""
    half = 0.5 * turn
    chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


@njit(cache=True, error_model="numpy", forceinline=True)
def rim_speed(start, change, together, clock, acceleration, coupling):
    """Speed of a rim on its way to `start` + `change` [m/s], `clock` [s] after both motors began to push.

    Until `together` [s] both push, and push each other along (positive) or back (negative); after that the one that is
    left pushes alone. `acceleration` and `coupling` are the robot's [m/s^2].
    """
    both = acceleration + math.copysign(1.0, together) * coupling
    early = min(clock, abs(together))
    gained = min(both * early + acceleration * (clock - early), abs(change))
    return start + math.copysign(gained, change)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def move(poses, wheel_speeds, commands, duration, physics_step, starts, i, boxes, posts, parts, lists, world, ways):
    """The control step of robot `i`: both rims speed up, then one, then none.

    Args:
        poses, rims: Of all robots; its rows are changed in place.
        commands: Of all robots.
        duration: Of the step [s].
        physics_step: Of PyBullet [s], which moves with the speed at such a step's end, along the heading at its start.
        starts: Of all robots.
        i: Which one it is.
        boxes, posts, parts, lists: Of all worlds.
        world: The number of its own.
        ways: How far each robot went [m] and turned [rad], shape (num_envs, 2): its row is a result.

    Returns:
        Whether it touched an obstacle.
    """
    radius, separation = starts[i, RADIUS], starts[i, WHEEL_SEPARATION]
    acceleration, coupling = starts[i, ACCELERATION], starts[i, COUPLING]
    v, w = commands[i, 0], commands[i, 1]
    wheel = starts[i, WHEEL]
    reach = 0.5 * separation * min(max(w, -starts[i, MAX_TURN_RATE]), starts[i, MAX_TURN_RATE])
    reach *= starts[i, ASSUMED_SEPARATION] * wheel
    v = min(max(v, -starts[i, MAX_SPEED]), starts[i, MAX_SPEED]) * wheel
    left, right = wheel_speeds[i, 0], wheel_speeds[i, 1]
    change_left, change_right = v - reach - left, v + reach - right
    sense_of_both = math.copysign(1.0, change_left * change_right)
    fewer, more = min(abs(change_left), abs(change_right)), max(abs(change_left), abs(change_right))
    first = fewer / (acceleration + sense_of_both * coupling)
    second = first + (more - fewer) / acceleration
    together = math.copysign(first, sense_of_both)

    x, y, yaw = poses[i, 0], poses[i, 1], poses[i, 2]
    # Far from walls nothing needs to be looked at on the way.
    longest = max(abs(left), abs(right), abs(v) + abs(reach)) * duration
    free = clearance_one(x, y, boxes, posts, parts, lists, world) > radius + longest
    bumped, way, turned = False, 0.0, 0.0
    clock, end = 0.5 * physics_step, duration + 0.5 * physics_step
    last_left = rim_speed(left, change_left, together, clock, acceleration, coupling)
    last_right = rim_speed(right, change_right, together, clock, acceleration, coupling)
    for phase in range(3):
        until = min(first if phase == 0 else second if phase == 1 else end, end)
        if until <= clock:
            continue
        next_left = rim_speed(left, change_left, together, until, acceleration, coupling)
        next_right = rim_speed(right, change_right, together, until, acceleration, coupling)
        mean_left, mean_right = 0.5 * (last_left + next_left), 0.5 * (last_right + next_right)
        length = 0.5 * (mean_left + mean_right) * (until - clock)
        rate = (mean_right - mean_left) / separation
        lag = 0.5 * rate * physics_step
        if free:
            x, y, yaw = along_arc(x, y, yaw - lag, length, rate * (until - clock))
        else:
            x, y, yaw, length, hit = move_along_arc(
                x, y, yaw - lag, length, rate * (until - clock), radius, boxes, posts, parts, lists, world
            )
            bumped = bumped or hit
        yaw += lag
        way += length
        turned += rate * (until - clock)
        last_left, last_right, clock = next_left, next_right, until
    ways[i, 0], ways[i, 1] = way, turned
    poses[i, 0], poses[i, 1] = x, y
    poses[i, 2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
    wheel_speeds[i, 0] = rim_speed(left, change_left, together, duration, acceleration, coupling)
    wheel_speeds[i, 1] = rim_speed(right, change_right, together, duration, acceleration, coupling)
    return bumped


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def sense(
    poses, starts, i, cos_beams, sin_beams, boxes, posts, parts, lists, world, limits, streams, over_x, over_y, ranges,
    dynamic_obstacles=None, nearest_is_dynamic=None,
):  # fmt: skip
    """The laser of robot `i`.

    Args:
        poses, starts: Of all robots.
        i: Which one it is.
        cos_beams, sin_beams: Of each beam's direction, shape (beams,).
        boxes, posts, parts, lists: Of all worlds.
        world: The number of its own.
        limits: The laser's noise, shortest and longest range [m], shape (3,).
        streams: Key of each robot's stream of random numbers, and how often it has read, shape (num_envs, 2), uint64.
        over_x, over_y: Room to calculate in, shape (beams,).
        ranges: Of all robots; its row is the result [m], shape (num_envs, beams).
        dynamic_obstacles: Of all robots, see `tb2rl.simulation.obstacles.outlines`; None: nothing moves.
        nearest_is_dynamic: Whether what is nearest to each robot is one of them, shape (num_envs,): its row is a
        result.
    """
    x, y, yaw, beams = poses[i, 0], poses[i, 1], poses[i, 2], ranges.shape[1]
    east, north = starts[i, MOUNT_X], starts[i, MOUNT_Y]
    if east != 0.0 or north != 0.0:
        x, y = x + east * math.cos(yaw) - north * math.sin(yaw), y + east * math.sin(yaw) + north * math.cos(yaw)
    yaw += starts[i, MOUNT_YAW]
    cast_one(x, y, yaw, cos_beams, sin_beams, boxes, posts, parts, lists, world, over_x, over_y, ranges, i)
    if dynamic_obstacles is not None:
        nearest_is_dynamic[i] = cast_at_movers(x, y, yaw, cos_beams, sin_beams, dynamic_obstacles, i, ranges, i)
    noise, bias, dropped = starts[i, NOISE], starts[i, BIAS], starts[i, DROPPED]
    noise = limits[0] if noise < 0.0 else noise
    first = streams[i, 1] * np.uint64(beams)
    if noise > 0.0:
        for beam in range(beams):
            ranges[i, beam] += noise * normal(streams[i, 0], first + np.uint64(beam))
    if bias != 0.0:
        for beam in range(beams):
            ranges[i, beam] += bias
    limit_ranges(ranges, i, limits[1], limits[2])
    if dropped > 0.0:
        for beam in range(beams):
            if uniform(streams[i, 0] ^ _EMPTY, first + np.uint64(beam)) < dropped:
                ranges[i, beam] = np.inf
