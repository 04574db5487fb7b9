"""Motion of dynamic obstacles, compiled; all simulators call this, so an episode has the same obstacles in each.

Posts and boxes go straight, along a path or to random points; people walk as `tb2rl.simulation.obstacles.people` says.
An obstacle that runs into the robot touches it and stops there, because nothing pushes the robot.

Arguments in common: `arrays` are `ObstacleArrays`, `i` is the environment, `index` and `world` the `WorldIndex` and the
number of its world there, `initial` the records of the initial states.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.simulation.obstacles.outlines import gap_to, outer_radius
from tb2rl.simulation.obstacles.people import (
    MAX_SPEED_RATIO,
    accelerate,
    head_for_target,
    repel_each_other,
    repel_from_walls_and_robot,
    walk_along_walls,
)
from tb2rl.simulation.obstacles.records import EMPTY, PATH, PERSON, STRAIGHT
from tb2rl.simulation.random_streams import uniform
from tb2rl.worlds.geometry import clearance_at

DECIDE_EVERY = 4  # physics steps: 20 times a second
CONTACT = 2e-3  # [m] at which an obstacle touches the robot: PyBullet's bodies push each other from 1 mm on
_MARGIN = 0.1  # [m] between targets and walls, and on the way
_ARRIVED = 0.3  # [m] from its target, a person chooses the next one
_WAITS = 1.0  # [s] for the robot to go away, before another target is chosen
_TRIES = 4  # directions; the target is in the one with the longest way
_NEAREST, _FARTHEST = 1.0, 6.0  # [m] to a target
_TINY = 1e-3  # [m]


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def decide(i, duration, arrays, initial, index, world, robot):
    """Choose targets, and the velocities of people, for the next `duration` [s].

    `robot` is its position x, y [m] and velocity vx, vy [m/s].
    """
    obstacles = arrays.obstacles
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.kind < STRAIGHT:
            continue
        left = math.hypot(obstacle.target_x - obstacle.x, obstacle.target_y - obstacle.y)
        obstacle.patience -= duration
        if obstacle.patience <= 0.0 or left < (_ARRIVED if obstacle.kind == PERSON else _TINY):
            _choose_target(i, obstacle, arrays.streams, initial, index, world)
        if obstacle.kind == PERSON:
            head_for_target(obstacle)
    for k in range(obstacles.shape[1]):
        for other in range(k + 1, obstacles.shape[1]):
            repel_each_other(obstacles[i, k], obstacles[i, other])
    for k in range(obstacles.shape[1]):
        if obstacles[i, k].kind == PERSON:
            repel_from_walls_and_robot(obstacles[i, k], index, world, robot, initial[i].radius)
            accelerate(obstacles[i, k], duration)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def move_obstacles(i, duration, arrays, index, world, x, y, radius):
    """Move the obstacles of an environment for a physics step, up to where they run into the robot.

    Args:
        i, arrays, index, world: See the module.
        duration: [s].
        x, y, radius: Of the robot [m].

    Returns:
        Whether one of them ran into it.
    """
    touched = False
    for k in range(arrays.obstacles.shape[1]):
        obstacle = arrays.obstacles[i, k]
        kind, from_x, from_y = obstacle.kind, obstacle.x, obstacle.y
        if kind == EMPTY:
            continue
        cos, sin, point, stride = obstacle.cos, obstacle.sin, obstacle.next, obstacle.stride
        if kind == PATH:
            to_x, to_y = _follow_path(obstacle, arrays.path_points, duration * obstacle.speed)
        elif kind == STRAIGHT:
            east, north = obstacle.target_x - from_x, obstacle.target_y - from_y
            share = min(1.0, duration * obstacle.speed / max(math.sqrt(east * east + north * north), 1e-9))
            to_x, to_y = from_x + share * east, from_y + share * north
        else:
            to_x, to_y = walk_along_walls(obstacle, duration, index, world)
        east, north = to_x - from_x, to_y - from_y
        length = math.sqrt(east * east + north * north)
        if length > 1e-9:
            obstacle.cos, obstacle.sin = east / length, north / length
        share = share_until_contact(x - from_x, y - from_y, x - to_x, y - to_y, radius + CONTACT, obstacle)
        if share < 1.0:
            touched = True
            obstacle.vx, obstacle.vy = 0.0, 0.0
            obstacle.patience = min(obstacle.patience, _WAITS)
            obstacle.next, obstacle.stride = point, stride
            to_x, to_y = from_x + share * (to_x - from_x), from_y + share * (to_y - from_y)
            if share == 0.0:  # nor does a box turn
                obstacle.cos, obstacle.sin = cos, sin
        elif kind != PERSON:
            obstacle.vx, obstacle.vy = (to_x - from_x) / duration, (to_y - from_y) / duration
        obstacle.x, obstacle.y = to_x, to_y
    return touched


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def share_until_contact(from_east, from_north, to_east, to_north, radius, obstacle):
    """Share of a motion of the robot relative to an obstacle until they touch, in [0, 1]; 1 if they move apart.

    Args:
        from_east, from_north, to_east, to_north: Positions of the robot relative to the obstacle's centre [m].
        radius: Of the robot [m].
        obstacle: Its record.
    """
    gap = gap_to(to_east, to_north, obstacle) - radius
    if gap >= 0.0 or gap > gap_to(from_east, from_north, obstacle) - radius:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(16):
        middle = 0.5 * (low + high)
        east, north = from_east + middle * (to_east - from_east), from_north + middle * (to_north - from_north)
        if gap_to(east, north, obstacle) < radius:
            high = middle
        else:
            low = middle
    return low


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def out_of_reach(x, y, speed, duration, radius, obstacles, i):
    """Whether the robot and its obstacles can neither touch nor avoid each other in a control step.

    Then they move independently, which is much faster.

    Args:
        x, y: Position of the robot [m].
        speed: Its largest speed in the step [m/s].
        duration: Of the step [s].
        radius: Of the robot [m].
        obstacles: Records, shape (num_envs, obstacles).
        i: Environment.
    """
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.length > 0.0:
            distance = math.hypot(obstacle.x - x, obstacle.y - y)
            covered = duration * (speed + MAX_SPEED_RATIO * obstacle.speed)
            if obstacle.avoids != 0.0 or distance < radius + CONTACT + outer_radius(obstacle) + covered:
                return False
    return True


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def step_obstacles_alone(i, steps, physics_step, arrays, initial, index, world, x, y):
    """Step the obstacles of a robot that is `out_of_reach` at x, y [m], for some physics steps [s] at once."""
    for step in range(steps):
        if step % DECIDE_EVERY == 0:
            duration = min(DECIDE_EVERY, steps - step) * physics_step
            decide(i, duration, arrays, initial, index, world, (x, y, 0.0, 0.0))
        move_obstacles(i, physics_step, arrays, index, world, x, y, 0.0)


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _follow_path(obstacle, path_points, left):
    """Position of an obstacle on its path after `left` [m]: there and back, or around."""
    x, y, first, count = obstacle.x, obstacle.y, int(obstacle.first), int(obstacle.count)
    for _ in range(count + 1):  # a path may be shorter than a step
        point, stride = int(obstacle.next), int(obstacle.stride)
        east, north = path_points[first + point, 0] - x, path_points[first + point, 1] - y
        distance = math.sqrt(east * east + north * north)
        if distance > left:
            return x + left / distance * east, y + left / distance * north
        x, y, left = x + east, y + north, left - distance
        if obstacle.closed != 0.0:
            obstacle.next = (point + 1) % count
        else:
            stride = stride if 0 <= point + stride < count else -stride
            obstacle.next, obstacle.stride = point + stride, stride
    return x, y


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def _choose_target(i, obstacle, streams, initial, index, world):
    """Draw points that the obstacle can reach straight, and keep the farthest."""
    x, y, best, bounds = obstacle.x, obstacle.y, 0.0, initial[i]
    obstacle.target_x, obstacle.target_y = x, y
    needed = min(outer_radius(obstacle) + _MARGIN, clearance_at(x, y, index, world))
    for _ in range(_TRIES):
        angle = math.tau * uniform(streams[i, 0], streams[i, 1])
        farthest = _NEAREST + (_FARTHEST - _NEAREST) * uniform(streams[i, 0], streams[i, 1] + np.uint64(1))
        streams[i, 1] += np.uint64(2)
        cos, sin, length, free = math.cos(angle), math.sin(angle), 0.0, 0.0
        while length < farthest:
            length = min(length + max(free, 0.05), farthest)
            at_x, at_y = x + length * cos, y + length * sin
            free = clearance_at(at_x, at_y, index, world) - needed
            inside = bounds.min_x <= at_x <= bounds.max_x and bounds.min_y <= at_y <= bounds.max_y
            if free < 0.0 or not inside:
                break
            if length > best:
                best, obstacle.target_x, obstacle.target_y = length, at_x, at_y
    obstacle.patience = 2.0 + 2.0 * best / obstacle.speed if best > 0.0 else 0.0
