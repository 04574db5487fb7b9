"""The compiled control steps of the fast twin, of many robots, among things that move or where nothing does.

Arrays are as in `tb2rl.simulation.kinematic.motion`. Movers (num_envs, movers, 24), their `walks` (num_envs, 2), keys
and
counts of
their random numbers, and `routes` (points, 2) are as in `tb2rl.simulation.obstacles.motion`; where nothing moves they
are None,
and numba leaves out what concerns them.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.kinematic.motion import move, sense
from tb2rl.simulation.obstacles.motion import (
    THINK,
    out_of_reach,
    share_until_touch,
    step_obstacles_alone,
    think,
    walk,
)
from tb2rl.simulation.obstacles.outlines import LENGTH, X, Y
from tb2rl.simulation.spec import MAX_SPEED, PHYSICS_RATE, POSE, RADIUS, WHEEL, WHEEL_SEPARATION, WORLD
from tb2rl.worlds.geometry import shortest_of


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def step_with_obstacles(
    poses, wheel_speeds, commands, duration, physics_step, starts, i, boxes, posts, parts, lists, world, ways,
    dynamic_obstacles, walks,
    routes,
):  # fmt: skip
    """The control step of robot `i` and of its movers, which go first in each physics step.

    Returns:
        Whether it touched a wall, and whether it touched a mover.
    """
    steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))  # as many as PyBullet makes
    part, radius = duration / steps, starts[i, RADIUS]
    speed = max(abs(wheel_speeds[i, 0]), abs(wheel_speeds[i, 1]), starts[i, MAX_SPEED] * starts[i, WHEEL])
    x, y = poses[i, 0], poses[i, 1]
    if out_of_reach(x, y, speed, duration, radius, dynamic_obstacles, i):
        step_obstacles_alone(
            i, steps, part, dynamic_obstacles, walks, routes, starts, boxes, posts, parts, lists, world, x, y
        )
        return move(
            poses, wheel_speeds, commands, duration, physics_step, starts, i, boxes, posts, parts, lists, world, ways
        ), False
    at_wall, at_mover, way, turned = False, False, 0.0, 0.0
    for step in range(steps):
        x, y, yaw, v = poses[i, 0], poses[i, 1], poses[i, 2], 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        vx, vy = v * math.cos(yaw), v * math.sin(yaw)
        if step % THINK == 0:
            span = min(THINK, steps - step) * part
            think(i, span, dynamic_obstacles, walks, starts, boxes, posts, parts, lists, world, x, y, vx, vy)
        hit = walk(i, part, dynamic_obstacles, routes, boxes, posts, parts, lists, world, x, y, radius)
        at_mover = hit or at_mover
        hit = move(
            poses, wheel_speeds, commands, part, physics_step, starts, i, boxes, posts, parts, lists, world, ways
        )
        at_wall = hit or at_wall
        share = 1.0
        for k in range(dynamic_obstacles.shape[1]):
            if dynamic_obstacles[i, k, LENGTH] > 0.0:
                at_x, at_y = dynamic_obstacles[i, k, X], dynamic_obstacles[i, k, Y]
                seen = x - at_x, y - at_y, poses[i, 0] - at_x, poses[i, 1] - at_y
                share = min(share, share_until_touch(*seen, radius, dynamic_obstacles, i, k))
        if share < 1.0:
            at_mover = True
            poses[i, 0], poses[i, 1] = x + share * (poses[i, 0] - x), y + share * (poses[i, 1] - y)
        way, turned = way + share * ways[i, 0], turned + ways[i, 1]
    ways[i, 0], ways[i, 1] = way, turned
    return at_wall, at_mover


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def step_robots(
    first, last, poses, wheel_speeds, commands, duration, physics_step, starts, boxes, posts, parts, lists, cos_beams,
    sin_beams, limits, streams, over_x, over_y, twists, ways, moved, accelerations, bumped, nearest, ranges,
    dynamic_obstacles,
    walks, routes, nearest_is_dynamic,
):  # fmt: skip
    """`step_block`, with room to calculate in: arrays that a loop's own function made are counted in every turn."""
    for i in range(first, last):
        world = int(starts[i, WORLD])
        x, y, earlier = poses[i, 0], poses[i, 1], 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        if dynamic_obstacles is None:
            bumped[i] = move(
                poses,
                wheel_speeds,
                commands,
                duration,
                physics_step,
                starts,
                i,
                boxes,
                posts,
                parts,
                lists,
                world,
                ways,
            )
        else:
            at_wall, at_mover = step_with_obstacles(
                poses, wheel_speeds, commands, duration, physics_step, starts, i, boxes, posts, parts, lists, world,
                ways,
                dynamic_obstacles, walks, routes,
            )  # fmt: skip
            bumped[i] = at_wall or at_mover
        moved[i] = math.hypot(poses[i, 0] - x, poses[i, 1] - y)
        twists[i, 0] = 0.5 * (wheel_speeds[i, 0] + wheel_speeds[i, 1])
        twists[i, 1] = (wheel_speeds[i, 1] - wheel_speeds[i, 0]) / starts[i, WHEEL_SEPARATION]
        accelerations[i] = (twists[i, 0] - earlier) / duration
        streams[i, 1] += np.uint64(1)
        sense(
            poses, starts, i, cos_beams, sin_beams, boxes, posts, parts, lists, world, limits, streams, over_x, over_y,
            ranges, dynamic_obstacles, nearest_is_dynamic,
        )  # fmt: skip
        nearest[i] = shortest_of(ranges, i)
        if dynamic_obstacles is not None:
            nearest_is_dynamic[i] = not at_wall and (at_mover or nearest_is_dynamic[i])


@njit(cache=True, nogil=True, error_model="numpy")
def step_block(
    first, last, poses, wheel_speeds, commands, duration, physics_step, starts, boxes, posts, parts, lists, beams,
    limits,
    streams, twists, ways, moved, accelerations, bumped, nearest, ranges,
):  # fmt: skip
    """A control step of robots `first` to `last` - 1, in place; see the module for the arrays.

    `beams` (2, beams) are cosines and sines, `limits` is as in `sense`, `streams` (num_envs, 2) are keys and counts.
    Results are `twists` (num_envs, 2) v and w [m/s, rad/s], `ways` (num_envs, 2) as in `move`, `moved` (num_envs,)
    how far
    from where it was [m], `accelerations` (num_envs,) the mean one ahead [m/s^2], `bumped` (num_envs,), `ranges`
    (num_envs, beams) [m] and the shortest of each robot, `nearest` (num_envs,) [m].
    """
    over_x, over_y = np.empty(beams.shape[1]), np.empty(beams.shape[1])
    step_robots(
        first, last, poses, wheel_speeds, commands, duration, physics_step, starts, boxes, posts, parts, lists,
        beams[0],
        beams[1], limits, streams, over_x, over_y, twists, ways, moved, accelerations, bumped, nearest, ranges, None,
        None, None, None,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def step_block_among(
    first, last, poses, wheel_speeds, commands, duration, physics_step, starts, boxes, posts, parts, lists, beams,
    limits,
    streams, twists, ways, moved, accelerations, bumped, nearest, ranges, dynamic_obstacles, walks, routes,
    nearest_is_dynamic,
):  # fmt: skip
    """`step_block` among things that move; `nearest_is_dynamic` (num_envs,) is a result, too.

    It says whether what a robot touched, or else what its laser says is nearest, is a mover.
    """
    over_x, over_y = np.empty(beams.shape[1]), np.empty(beams.shape[1])
    step_robots(
        first, last, poses, wheel_speeds, commands, duration, physics_step, starts, boxes, posts, parts, lists,
        beams[0],
        beams[1], limits, streams, over_x, over_y, twists, ways, moved, accelerations, bumped, nearest, ranges,
        dynamic_obstacles,
        walks, routes, nearest_is_dynamic,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def sense_some(
    indices, poses, starts, boxes, posts, parts, lists, beams, limits, streams, ranges, dynamic_obstacles=None,
    nearest_is_dynamic=None
):  # fmt: skip
    """The laser of the robots with the indices `robots` (n,), into their rows of `ranges` (num_envs, beams).

    `dynamic_obstacles` and `nearest_is_dynamic` are as in `sense`.
    """
    over_x, over_y = np.empty(beams.shape[1]), np.empty(beams.shape[1])
    for i in indices:
        sense(
            poses, starts, i, beams[0], beams[1], boxes, posts, parts, lists, int(starts[i, WORLD]), limits, streams,
            over_x, over_y, ranges, dynamic_obstacles, nearest_is_dynamic,
        )  # fmt: skip


@njit(cache=True)
def begin_some(indices, table, starts, poses, wheel_speeds, streams, twists, commands, accelerations, bumped):
    """The robots with the indices `robots` (n,) stand where the rows of `table` (n, 32) say, and read once more.

    `table` goes into their rows of `starts` (num_envs, 32); the other arrays are as in `step_block`.
    """
    for row, i in enumerate(indices):
        starts[i], poses[i] = table[row], table[row, POSE]
        wheel_speeds[i], twists[i], commands[i], accelerations[i], bumped[i] = 0.0, 0.0, 0.0, 0.0, False
        streams[i, 1] += np.uint64(1)
