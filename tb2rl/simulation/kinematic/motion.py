"""Compiled motion and laser of one robot of the kinematic simulator."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.obstacles.outlines import cast_at_obstacles
from tb2rl.simulation.random_streams import normal, uniform
from tb2rl.worlds.geometry import cast_beams, clearance_at, limit_ranges

CONTACT = 1.0e-4  # [m] a gap below this is contact
_DROPPED_STREAM = np.uint64(0x5851F42D4C957F2D)  # xor the key of the laser's noise: key of the stream for dropped beams
_PROBE = 1.0e-3  # [m] how far to look whether a motion leads away from an obstacle in contact


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def move_along_arc(x, y, yaw, length, turn, radius, index, world):
    """Move a robot along an arc, up to where an obstacle stops it; it turns all the same.

    Conservative advancement (Mirtich 1996): no step is longer than the gap to the nearest obstacle, so none is jumped
    over, however fast the robot is.

    Args:
        x, y, yaw: Pose [m, m, rad].
        length: Of the arc [m], negative backwards.
        turn: From its start to its end [rad].
        radius: Of the robot [m].
        index: `WorldIndex` of all worlds.
        world: Number of the robot's world.

    Returns:
        The pose after it, the length covered [m], and whether an obstacle was touched.
    """
    whole = abs(length)
    left, bumped = whole, False
    while left > 0.0:
        gap = clearance_at(x, y, index, world) - radius
        if gap < CONTACT:
            probe = math.copysign(_PROBE, length)
            clearance = clearance_at(x + probe * math.cos(yaw), y + probe * math.sin(yaw), index, world)
            if clearance - radius <= gap:
                bumped = True
                break
            gap = _PROBE
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
def wheel_speed(start, change, together, clock, acceleration, coupling):
    """Speed of a wheel's rim on its way to `start` + `change` [m/s], `clock` [s] after both motors began to push.

    Until abs(`together`) [s] both motors push, and add to each other (positive) or oppose each other (negative); then
    one pushes alone. `acceleration` and `coupling` are the robot's [m/s^2].
    """
    both = acceleration + math.copysign(1.0, together) * coupling
    early = min(clock, abs(together))
    gained = min(both * early + acceleration * (clock - early), abs(change))
    return start + math.copysign(gained, change)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def move(i, constants, motion, duration):
    """Drive robot `i` for a `duration` [s] in three phases: both wheels accelerate, then one, then none.

    PyBullet moves with the speed at the end of a physics step along the heading at its start; so does this.

    Returns:
        The length [m] and the turn [rad] of its way, and whether it touched an obstacle.
    """
    robot, poses, wheel_speeds = constants.initial[i], motion.poses, motion.wheel_speeds
    index, world, physics_step = constants.index, int(robot.world), constants.physics_step
    radius, separation = robot.radius, robot.wheel_separation
    acceleration, coupling = robot.wheel_acceleration, robot.wheel_coupling
    v, w = motion.commands[i, 0], motion.commands[i, 1]
    wheel = robot.wheel_radius
    reach = 0.5 * separation * min(max(w, -robot.max_turn_rate), robot.max_turn_rate)
    reach *= robot.assumed_separation * wheel
    v = min(max(v, -robot.max_speed), robot.max_speed) * wheel
    left, right = wheel_speeds[i, 0], wheel_speeds[i, 1]
    change_left, change_right = v - reach - left, v + reach - right
    sense_of_both = math.copysign(1.0, change_left * change_right)
    fewer, more = min(abs(change_left), abs(change_right)), max(abs(change_left), abs(change_right))
    first = fewer / (acceleration + sense_of_both * coupling)
    second = first + (more - fewer) / acceleration
    together = math.copysign(first, sense_of_both)

    x, y, yaw = poses[i, 0], poses[i, 1], poses[i, 2]
    longest = max(abs(left), abs(right), abs(v) + abs(reach)) * duration
    free = clearance_at(x, y, index, world) > radius + longest  # then no obstacle matters in this step
    bumped, covered, turned = False, 0.0, 0.0
    clock, end = 0.5 * physics_step, duration + 0.5 * physics_step
    last_left = wheel_speed(left, change_left, together, clock, acceleration, coupling)
    last_right = wheel_speed(right, change_right, together, clock, acceleration, coupling)
    for phase in range(3):
        until = min(first if phase == 0 else second if phase == 1 else end, end)
        if until <= clock:
            continue
        next_left = wheel_speed(left, change_left, together, until, acceleration, coupling)
        next_right = wheel_speed(right, change_right, together, until, acceleration, coupling)
        mean_left, mean_right = 0.5 * (last_left + next_left), 0.5 * (last_right + next_right)
        length = 0.5 * (mean_left + mean_right) * (until - clock)
        rate = (mean_right - mean_left) / separation
        turn, lag = rate * (until - clock), 0.5 * rate * physics_step
        if free:
            x, y, yaw = along_arc(x, y, yaw - lag, length, turn)
        else:
            x, y, yaw, length, hit = move_along_arc(x, y, yaw - lag, length, turn, radius, index, world)
            bumped = bumped or hit
        yaw += lag
        covered += length
        turned += turn
        last_left, last_right, clock = next_left, next_right, until
    poses[i, 0], poses[i, 1] = x, y
    poses[i, 2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
    wheel_speeds[i, 0] = wheel_speed(left, change_left, together, duration, acceleration, coupling)
    wheel_speeds[i, 1] = wheel_speed(right, change_right, together, duration, acceleration, coupling)
    return covered, turned, bumped


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def scan(i, constants, motion, scratch, ranges, obstacles):
    """Write the laser's ranges [m] of robot `i` into its row of `ranges` (num_envs, beams).

    Args:
        i, constants, motion: The robot, `Constants` and `Motion`.
        scratch: Two arrays of shape (beams,).
        ranges: The result.
        obstacles: Records of dynamic obstacles, shape (num_envs, obstacles); None: there are none.

    Returns:
        Whether the shortest range is that to a dynamic obstacle.
    """
    robot, poses, index = constants.initial[i], motion.poses, constants.index
    x, y, yaw, beams = poses[i, 0], poses[i, 1], poses[i, 2], ranges.shape[1]
    if robot.mount_x != 0.0 or robot.mount_y != 0.0:
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = x + robot.mount_x * cos - robot.mount_y * sin, y + robot.mount_x * sin + robot.mount_y * cos
    yaw += robot.mount_yaw
    cast_beams(x, y, yaw, constants.beams, index, int(robot.world), scratch, ranges, i)
    nearest_is_dynamic = False
    if obstacles is not None:
        nearest_is_dynamic = cast_at_obstacles(x, y, yaw, constants.beams, obstacles, i, ranges)
    noise = constants.laser_noise if robot.laser_noise < 0.0 else robot.laser_noise
    key, first = motion.streams[i, 0], motion.streams[i, 1] * np.uint64(beams)
    if noise > 0.0:
        for beam in range(beams):
            ranges[i, beam] += noise * normal(key, first + np.uint64(beam))
    if robot.bias != 0.0:
        for beam in range(beams):
            ranges[i, beam] += robot.bias
    limit_ranges(ranges, i, constants.min_range, constants.max_range)
    if robot.dropped > 0.0:
        for beam in range(beams):
            if uniform(key ^ _DROPPED_STREAM, first + np.uint64(beam)) < robot.dropped:
                ranges[i, beam] = np.inf
    return nearest_is_dynamic
