"""Compiled motion of dynamic obstacles, shared by all simulators, so that an episode has the same obstacles in each.

Posts and boxes move in straight lines, along a path or to random points. People follow the social force model of
`tb2rl.simulation.obstacles.people`. An obstacle that touches the robot stops, because nothing pushes the robot.

Arguments in common: `arrays` is `ObstacleArrays`, `i` is the environment, `world_id` is its world in the
`spatial_index`, and `initial_states` has a record for each environment: the robot's radius and the world's bounds.
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation.obstacles import people
from tb2rl.simulation.obstacles.outlines import EMPTY, PATH, PERSON, TO_TARGETS, distance_to_outline, outer_radius
from tb2rl.simulation.random_streams import uniform
from tb2rl.worlds.geometry import clearance_at

DECISION_STEPS = 4  # physics steps from one call of `decide` to the next, so that there are 20 calls a second
STOP_GAP = 2e-3  # [m] an obstacle with a smaller gap to the robot stops; below 1 mm, PyBullet would push the robot
_MARGIN = 0.1  # [m] gap to walls on the way to a target; an obstacle that is nearer to a wall keeps its present gap
_PERSON_ARRIVAL = 0.3  # [m] a person this near to the target chooses another
_ARRIVAL = 1e-3  # [m] the same for posts and boxes
_WAITING_TIME = 1.0  # [s] after a contact with the robot, until another target is chosen
_DIRECTIONS = 4  # number of random directions; the target is in the direction with the longest free way
_MIN_DISTANCE, _MAX_DISTANCE = 1.0, 6.0  # [m] range of random distances to a target


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def decide(i, duration, arrays, initial_states, spatial_index, world_id, robot_motion):
    """Choose targets, and the velocities of people, for the next `duration` [s].

    `robot_motion` is the robot's position x, y [m] and velocity vx, vy [m/s].
    """
    obstacles = arrays.obstacles
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.kind < TO_TARGETS:  # `EMPTY` and `PATH` have no targets
            continue
        distance = math.hypot(obstacle.target_x - obstacle.x, obstacle.target_y - obstacle.y)
        obstacle.patience -= duration
        if obstacle.patience <= 0.0 or distance < (_PERSON_ARRIVAL if obstacle.kind == PERSON else _ARRIVAL):
            _choose_target(i, obstacle, arrays.streams, initial_states, spatial_index, world_id)
        if obstacle.kind == PERSON:
            people.attract_to_target(obstacle)
    for k in range(obstacles.shape[1]):
        for other in range(k + 1, obstacles.shape[1]):
            people.repel_each_other(obstacles[i, k], obstacles[i, other])  # only people feel forces
    for k in range(obstacles.shape[1]):
        if obstacles[i, k].kind == PERSON:
            robot_radius = initial_states[i].radius
            people.repel_from_walls_and_robot(obstacles[i, k], spatial_index, world_id, robot_motion, robot_radius)
            people.accelerate(obstacles[i, k], duration)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def step_obstacles(i, step, steps, physics_step, arrays, initial_states, spatial_index, world_id, robot_motion):
    """Run the physics step number `step` of the `steps` in a control step; the robot moves afterwards.

    `physics_step` is the duration of a step [s], and `robot_motion` is that of `decide`.

    Returns:
        Whether an obstacle touched the robot.
    """
    x, y, _, _ = robot_motion
    if step % DECISION_STEPS == 0:
        duration = min(DECISION_STEPS, steps - step) * physics_step
        decide(i, duration, arrays, initial_states, spatial_index, world_id, robot_motion)
    return move_obstacles(i, physics_step, arrays, spatial_index, world_id, x, y, initial_states[i].radius)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def move_obstacles(i, duration, arrays, spatial_index, world_id, x, y, radius):
    """Move the obstacles of an environment for a physics step of a `duration` [s]; they stop at the robot.

    x, y and `radius` [m] are the centre and the radius of the robot.

    Returns:
        Whether an obstacle touched the robot.
    """
    touched = False
    for k in range(arrays.obstacles.shape[1]):
        obstacle = arrays.obstacles[i, k]
        kind, from_x, from_y = obstacle.kind, obstacle.x, obstacle.y
        if kind == EMPTY:
            continue
        cos, sin, next_point = obstacle.cos, obstacle.sin, obstacle.next
        if kind == PATH:
            to_x, to_y = _advance_on_path(obstacle, arrays.path_points, duration * obstacle.speed)
        elif kind == TO_TARGETS:
            dx, dy = obstacle.target_x - from_x, obstacle.target_y - from_y
            share = min(1.0, duration * obstacle.speed / max(math.sqrt(dx * dx + dy * dy), 1e-9))
            to_x, to_y = from_x + share * dx, from_y + share * dy
        else:
            to_x, to_y = people.walk_along_walls(obstacle, duration, spatial_index, world_id)
        dx, dy = to_x - from_x, to_y - from_y
        length = math.sqrt(dx * dx + dy * dy)
        if length > 1e-9:
            obstacle.cos, obstacle.sin = dx / length, dy / length
        share = share_until_contact(x - from_x, y - from_y, x - to_x, y - to_y, radius + STOP_GAP, obstacle)
        if share < 1.0:
            touched = True
            obstacle.vx, obstacle.vy = 0.0, 0.0
            obstacle.patience = min(obstacle.patience, _WAITING_TIME)
            obstacle.next = next_point  # undoes `_advance_on_path`
            to_x, to_y = from_x + share * (to_x - from_x), from_y + share * (to_y - from_y)
            if share == 0.0:  # a box does not turn if it does not move
                obstacle.cos, obstacle.sin = cos, sin
        elif kind != PERSON:
            obstacle.vx, obstacle.vy = (to_x - from_x) / duration, (to_y - from_y) / duration
        obstacle.x, obstacle.y = to_x, to_y
    return touched


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def share_until_contact(from_x, from_y, to_x, to_y, radius, obstacle):
    """Share in [0, 1] of a motion, of robot or obstacle, before they touch; 1 without contact, or if they move apart.

    The robot's positions before and after the motion are relative to the obstacle's centre [m]. `radius` [m] is the
    robot's radius, to which `STOP_GAP` may be added.
    """
    gap = distance_to_outline(to_x, to_y, obstacle) - radius
    if gap >= 0.0 or gap > distance_to_outline(from_x, from_y, obstacle) - radius:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(16):
        middle = 0.5 * (low + high)
        x, y = from_x + middle * (to_x - from_x), from_y + middle * (to_y - from_y)
        if distance_to_outline(x, y, obstacle) < radius:
            high = middle
        else:
            low = middle
    return low


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def is_out_of_reach(x, y, max_speed, duration, radius, obstacles, i):
    """Whether the robot and its obstacles cannot affect each other in a control step of a `duration` [s].

    In this case they move independently, which is much faster. The robot at x, y [m] is not faster than
    `max_speed` [m/s]. People who avoid the robot are never out of reach.
    """
    for k in range(obstacles.shape[1]):
        obstacle = obstacles[i, k]
        if obstacle.kind != EMPTY:
            distance = math.hypot(obstacle.x - x, obstacle.y - y)
            approach = duration * (max_speed + people.MAX_SPEED_RATIO * obstacle.speed)
            if obstacle.avoids_robot != 0.0 or distance < radius + STOP_GAP + outer_radius(obstacle) + approach:
                return False
    return True


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def step_obstacles_alone(i, steps, physics_step, arrays, initial_states, spatial_index, world_id, position):
    """Run `steps` steps of `physics_step` [s]; the robot, out of reach, is a resting point at `position` x, y [m]."""
    x, y = position
    for step in range(steps):
        if step % DECISION_STEPS == 0:
            duration = min(DECISION_STEPS, steps - step) * physics_step
            decide(i, duration, arrays, initial_states, spatial_index, world_id, (x, y, 0.0, 0.0))
        move_obstacles(i, physics_step, arrays, spatial_index, world_id, x, y, 0.0)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _advance_on_path(obstacle, path_points, length):
    """Advance `obstacle.next` by `length` [m] of the path; returns the new position x, y [m], and does not set it."""
    x, y, first, count = obstacle.x, obstacle.y, int(obstacle.first), int(obstacle.count)
    for _ in range(count + 1):  # a path may be shorter than a step
        next_point = int(obstacle.next)
        dx, dy = path_points[first + next_point, 0] - x, path_points[first + next_point, 1] - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > length:
            return x + length / distance * dx, y + length / distance * dy
        x, y, length = x + dx, y + dy, length - distance
        obstacle.next = (next_point + 1) % count
    return x, y


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _choose_target(i, obstacle, streams, initial_states, spatial_index, world_id):
    """Draw random targets in random directions, and choose the one with the longest free way."""
    x, y, longest_way, bounds = obstacle.x, obstacle.y, 0.0, initial_states[i]
    obstacle.target_x, obstacle.target_y = x, y
    min_clearance = min(outer_radius(obstacle) + _MARGIN, clearance_at(x, y, spatial_index, world_id))
    for _ in range(_DIRECTIONS):
        angle = math.tau * uniform(streams[i, 0], streams[i, 1])
        share = uniform(streams[i, 0], streams[i, 1] + np.uint64(1))
        max_length = _MIN_DISTANCE + (_MAX_DISTANCE - _MIN_DISTANCE) * share
        streams[i, 1] += np.uint64(2)
        cos, sin, length, room = math.cos(angle), math.sin(angle), 0.0, 0.0
        while length < max_length:  # sphere tracing along the way
            length = min(length + max(room, 0.05), max_length)
            point_x, point_y = x + length * cos, y + length * sin
            room = clearance_at(point_x, point_y, spatial_index, world_id) - min_clearance
            is_inside = bounds.min_x <= point_x <= bounds.max_x and bounds.min_y <= point_y <= bounds.max_y
            if room < 0.0 or not is_inside:
                break
            if length > longest_way:
                longest_way, obstacle.target_x, obstacle.target_y = length, point_x, point_y
    obstacle.patience = 2.0 + 2.0 * longest_way / obstacle.speed if longest_way > 0.0 else 0.0
