"""The social force model of walking people, compiled: forces to the target, from other people, walls and the robot.

Model and parameters follow Moussaid et al. 2009, "Experimental study of the behavioural mechanisms underlying
self-organization in human crowds". A person is a record of `outlines.OBSTACLE_TYPE`; `length` is the radius.
"""

import math

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation.obstacles.outlines import EMPTY, PERSON, distance_to_outline
from tb2rl.worlds.geometry import clearance_at

MAX_SPEED_RATIO = 1.3  # maximum speed / target speed of a person (Helbing and Molnar 1995)
_GAMMA, _LAMBDA, _N_TURN, _N_SLOW = 0.35, 2.0, 2.0, 3.0  # symbols of the article: gamma, lambda, n', n
_RELAXATION_TIME = 0.54  # [s] time constant with which a person approaches the target velocity
_STRENGTH = 4.5  # [m/s^2] force between two people
_WALL_STRENGTH, _WALL_DECAY = 3.0, 0.1  # [m/s^2] force at a wall; [m] distance over which it falls to 1 / e
_WALL_CUTOFF = 0.6  # [m] a wall farther away exerts no force
_MAX_ROOM = 6.0  # [m] upper limit of a person's "room", so that walls are tested again after that distance
_STEP = 1e-3  # [m] step of finite differences; also a tolerance of clearances


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def social_force(dx, dy, vx, vy):
    """Force of another person on a person, divided by `_STRENGTH`; it slows the person down and turns the person aside.

    Args:
        dx, dy: Position of the other person, relative to the person [m].
        vx, vy: Velocity of the person, relative to the other person [m/s].
    """
    distance = math.sqrt(dx * dx + dy * dy)
    if distance < 1e-9:
        return 0.0, 0.0
    towards_x, towards_y = dx / distance, dy / distance
    tx, ty = _LAMBDA * vx + towards_x, _LAMBDA * vy + towards_y  # direction of interaction, t in the article
    norm = math.sqrt(tx * tx + ty * ty)
    if norm < 1e-9:
        return 0.0, 0.0
    tx, ty, decay = tx / norm, ty / norm, _GAMMA * norm  # decay is B in the article
    angle = math.atan2(tx * towards_y - ty * towards_x, tx * towards_x + ty * towards_y)
    slowing = -math.exp(-distance / decay - (_N_SLOW * decay * angle) ** 2)
    turning = -math.exp(-distance / decay - (_N_TURN * decay * angle) ** 2) if angle != 0.0 else 0.0
    turning = math.copysign(turning, -angle)
    return slowing * tx - turning * ty, slowing * ty + turning * tx


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def attract_to_target(person):
    """Set the force on a person to the force that accelerates the person towards the target."""
    dx, dy = person.target_x - person.x, person.target_y - person.y
    rate = person.speed / max(math.sqrt(dx * dx + dy * dy), 1e-9)
    person.force_x = (rate * dx - person.vx) / _RELAXATION_TIME
    person.force_y = (rate * dy - person.vy) / _RELAXATION_TIME


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def repel_each_other(one, other):
    """Add the forces between two obstacles to the force on each of them that is a person."""
    if one.kind == EMPTY or other.kind == EMPTY or (one.kind != PERSON and other.kind != PERSON):
        return
    dx, dy = other.x - one.x, other.y - one.y
    social_x, social_y = social_force(dx, dy, one.vx - other.vx, one.vy - other.vy)
    distance = max(math.sqrt(dx * dx + dy * dy), 1e-9)
    # Obstacles also repel a person as walls do, so that they do not overlap.
    if one.kind == PERSON:
        push = _wall_force(distance_to_outline(-dx, -dy, other) - one.length) / distance
        one.force_x = one.force_x + _STRENGTH * social_x - push * dx
        one.force_y = one.force_y + _STRENGTH * social_y - push * dy
    if other.kind == PERSON:
        push = _wall_force(distance_to_outline(dx, dy, one) - other.length) / distance
        other.force_x = other.force_x - _STRENGTH * social_x + push * dx
        other.force_y = other.force_y - _STRENGTH * social_y + push * dy


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def repel_from_walls_and_robot(person, spatial_index, world_id, robot_motion, robot_radius):
    """Add the force of the walls, and the force of the robot if the person avoids the robot; set `person.room`.

    `robot_motion` is x, y [m], vx, vy [m/s].
    """
    x, y, force_x, force_y = person.x, person.y, person.force_x, person.force_y
    robot_x, robot_y, robot_vx, robot_vy = robot_motion
    if person.avoids_robot != 0.0:
        dx, dy = robot_x - x, robot_y - y
        social_x, social_y = social_force(dx, dy, person.vx - robot_vx, person.vy - robot_vy)
        distance = max(math.sqrt(dx * dx + dy * dy), 1e-9)
        push = _wall_force(distance - robot_radius - person.length) / distance
        force_x, force_y = force_x + _STRENGTH * social_x - push * dx, force_y + _STRENGTH * social_y - push * dy
    gap = clearance_at(x, y, spatial_index, world_id) - person.length
    if gap < _WALL_CUTOFF:
        away_x, away_y = _direction_from_walls(x, y, spatial_index, world_id)
        push = _wall_force(gap)
        force_x, force_y = force_x + push * away_x, force_y + push * away_y
    person.force_x, person.force_y, person.room = force_x, force_y, min(gap, _MAX_ROOM) - _STEP


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def accelerate(person, duration):
    """Apply the force on a person for a `duration` [s]."""
    vx, vy = person.vx + duration * person.force_x, person.vy + duration * person.force_y
    factor = min(1.0, MAX_SPEED_RATIO * person.speed / max(math.sqrt(vx * vx + vy * vy), 1e-9))
    person.vx, person.vy = factor * vx, factor * vy


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def walk_along_walls(person, duration, spatial_index, world_id):
    """Next x, y [m] of a person after a `duration` [s], along walls, not into them; sets only `room` and velocity."""
    x, y, radius, vx, vy = person.x, person.y, person.length, person.vx, person.vy
    to_x, to_y = x + duration * vx, y + duration * vy
    person.room -= duration * (abs(vx) + abs(vy))  # an upper bound of the distance
    if person.room > 0.0:
        return to_x, to_y
    clearance = clearance_at(to_x, to_y, spatial_index, world_id)
    if clearance >= radius:
        return to_x, to_y
    present_clearance = clearance_at(x, y, spatial_index, world_id)
    if clearance >= present_clearance:
        return to_x, to_y
    away_x, away_y = _direction_from_walls(x, y, spatial_index, world_id)
    normal_speed = min(vx * away_x + vy * away_y, 0.0)  # negative towards the wall
    vx, vy = vx - normal_speed * away_x, vy - normal_speed * away_y
    to_x, to_y = x + duration * vx, y + duration * vy
    if clearance_at(to_x, to_y, spatial_index, world_id) < min(radius, present_clearance) - _STEP:
        vx, vy, to_x, to_y = 0.0, 0.0, x, y
    person.vx, person.vy = vx, vy
    return to_x, to_y


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def _wall_force(gap):
    """Force [m/s^2] of a wall or another body at a distance `gap` [m]."""
    return _WALL_STRENGTH * math.exp(-max(gap, -_WALL_DECAY) / _WALL_DECAY)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _direction_from_walls(x, y, spatial_index, world_id):
    """Direction away from the nearest wall: the gradient of the clearance, of length 1 at most."""
    right = clearance_at(x + _STEP, y, spatial_index, world_id)
    left = clearance_at(x - _STEP, y, spatial_index, world_id)
    above = clearance_at(x, y + _STEP, spatial_index, world_id)
    below = clearance_at(x, y - _STEP, spatial_index, world_id)
    return (right - left) / (2.0 * _STEP), (above - below) / (2.0 * _STEP)
