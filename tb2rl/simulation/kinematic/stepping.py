"""Compiled control steps of many robots of the kinematic simulator, with and without dynamic obstacles.

`obstacles` are `ObstacleArrays`, or None; then numba leaves out what concerns them.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.kinematic.motion import move, scan
from tb2rl.simulation.obstacles.motion import (
    DECIDE_EVERY,
    decide,
    move_obstacles,
    out_of_reach,
    share_until_contact,
    step_obstacles_alone,
)
from tb2rl.simulation.spec import PHYSICS_RATE
from tb2rl.worlds.geometry import shortest_of


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def move_among_obstacles(i, constants, motion, duration, obstacles):
    """`move`, with the dynamic obstacles of robot `i`, which go first in each physics step.

    Returns:
        The length [m] and the turn [rad] of its way, whether it touched a wall, and whether a dynamic obstacle.
    """
    robot, poses, wheel_speeds = constants.initial[i], motion.poses, motion.wheel_speeds
    initial, index, world, radius = constants.initial, constants.index, int(robot.world), robot.radius
    steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))  # as many as in PyBullet
    physics_step = duration / steps
    speed = max(abs(wheel_speeds[i, 0]), abs(wheel_speeds[i, 1]), robot.max_speed * robot.wheel_radius)
    x, y = poses[i, 0], poses[i, 1]
    if out_of_reach(x, y, speed, duration, radius, obstacles.obstacles, i):
        step_obstacles_alone(i, steps, physics_step, obstacles, initial, index, world, x, y)
        length, turn, at_wall = move(i, constants, motion, duration)
        return length, turn, at_wall, False
    at_wall, at_obstacle, length, turn = False, False, 0.0, 0.0
    for step in range(steps):
        x, y, yaw, v = poses[i, 0], poses[i, 1], poses[i, 2], 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        if step % DECIDE_EVERY == 0:
            span = min(DECIDE_EVERY, steps - step) * physics_step
            decide(i, span, obstacles, initial, index, world, (x, y, v * math.cos(yaw), v * math.sin(yaw)))
        hit = move_obstacles(i, physics_step, obstacles, index, world, x, y, radius)
        at_obstacle = hit or at_obstacle
        covered, turned, hit = move(i, constants, motion, physics_step)
        at_wall = hit or at_wall
        share = 1.0
        for k in range(obstacles.obstacles.shape[1]):
            obstacle = obstacles.obstacles[i, k]
            if obstacle.length > 0.0:
                relative = x - obstacle.x, y - obstacle.y, poses[i, 0] - obstacle.x, poses[i, 1] - obstacle.y
                share = min(share, share_until_contact(*relative, radius, obstacle))
        if share < 1.0:
            at_obstacle = True
            poses[i, 0], poses[i, 1] = x + share * (poses[i, 0] - x), y + share * (poses[i, 1] - y)
        length, turn = length + share * covered, turn + turned
    return length, turn, at_wall, at_obstacle


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _step_robots(first, last, constants, motion, duration, measured, scratch, obstacles):
    """`step_block` without allocations, because the arrays of a function that allocates are counted in every turn."""
    poses, wheel_speeds, twists = motion.poses, motion.wheel_speeds, motion.twists
    for i in range(first, last):
        x, y, speed = poses[i, 0], poses[i, 1], 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        if obstacles is None:
            length, turn, motion.bumped[i] = move(i, constants, motion, duration)
        else:
            length, turn, at_wall, at_obstacle = move_among_obstacles(i, constants, motion, duration, obstacles)
            motion.bumped[i] = at_wall or at_obstacle
        measured.arcs[i, 0], measured.arcs[i, 1] = length, turn
        measured.travelled[i] = math.hypot(poses[i, 0] - x, poses[i, 1] - y)
        twists[i, 0] = 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        twists[i, 1] = (wheel_speeds[i, 1] - wheel_speeds[i, 0]) / constants.initial[i].wheel_separation
        motion.accelerations[i] = (twists[i, 0] - speed) / duration
        motion.streams[i, 1] += np.uint64(1)
        if obstacles is None:
            scan(i, constants, motion, scratch, measured.ranges, None)
        else:
            nearest = scan(i, constants, motion, scratch, measured.ranges, obstacles.obstacles)
            measured.nearest_is_dynamic[i] = not at_wall and (at_obstacle or nearest)
        measured.nearest[i] = shortest_of(measured.ranges, i)


@njit(cache=True, nogil=True, error_model="numpy")
def step_block(first, last, constants, motion, duration, measured, obstacles):
    """Step robots `first` to `last` - 1 for a control period.

    Args:
        first, last: Range of environments.
        constants: `Constants`.
        motion: `Motion`; its commands are read, and the rest changes in place.
        duration: [s].
        measured: `Measured`, the result.
        obstacles: `ObstacleArrays`, changed in place; None: there are none.
    """
    beams = constants.beams[0].size
    _step_robots(first, last, constants, motion, duration, measured, (np.empty(beams), np.empty(beams)), obstacles)


@njit(cache=True, error_model="numpy")
def scan_some(indices, constants, motion, ranges, nearest_is_dynamic, obstacles):
    """The laser of some robots: into their rows of `ranges` [m] (num_envs, beams), and of `nearest_is_dynamic`."""
    scratch = np.empty(ranges.shape[1]), np.empty(ranges.shape[1])
    for i in indices:
        if obstacles is None:
            scan(i, constants, motion, scratch, ranges, None)
        else:
            nearest_is_dynamic[i] = scan(i, constants, motion, scratch, ranges, obstacles.obstacles)


@njit(cache=True)
def reset_some(indices, rows, initial, motion):
    """Copy the initial states `rows` (n,) to `initial` (num_envs,) and put these robots there, at rest."""
    for row, i in enumerate(indices):
        initial[i] = rows[row]
        motion.poses[i, 0], motion.poses[i, 1], motion.poses[i, 2] = rows[row].x, rows[row].y, rows[row].yaw
        motion.wheel_speeds[i], motion.twists[i], motion.commands[i] = 0.0, 0.0, 0.0
        motion.accelerations[i], motion.bumped[i] = 0.0, False
        motion.streams[i, 1] += np.uint64(1)
