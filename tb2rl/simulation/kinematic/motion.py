"""Compiled control steps of the kinematic simulator, with and without dynamic obstacles.

Arguments in common: `constants` is `Constants`, `robots` is `RobotArrays`, and `i` is the environment. `obstacles` is
`ObstacleArrays`, or None without dynamic obstacles; numba compiles each function for both types.
"""

import math

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation.arrays.robots import scan
from tb2rl.simulation.obstacles import motion
from tb2rl.simulation.spec import PHYSICS_RATE
from tb2rl.worlds.geometry import clearance_at

CONTACT = 1.0e-4  # [m] a robot whose gap to an obstacle is smaller touches the obstacle
_PROBE = 1.0e-3  # [m] distance at which to test whether a motion leads away from an obstacle in contact


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def move_along_arc(x, y, yaw, length, turn, radius, spatial_index, world_id):
    """Move a robot along an arc of `length` [m] and `turn` [rad], up to an obstacle, where it completes the turn.

    Conservative advancement (Mirtich 1996): no step is longer than the gap to the nearest obstacle, so that the robot
    cannot jump over an obstacle, however fast it is.

    Returns:
        The final pose, the length covered [m], and whether the robot touched an obstacle.
    """
    distance = abs(length)
    remaining, bumped = distance, False
    while remaining > 0.0:
        gap = clearance_at(x, y, spatial_index, world_id) - radius
        if gap < CONTACT:
            probe = math.copysign(_PROBE, length)
            clearance = clearance_at(x + probe * math.cos(yaw), y + probe * math.sin(yaw), spatial_index, world_id)
            if clearance - radius <= gap:
                bumped = True
                break
            gap = _PROBE
        step = min(gap, remaining)
        x, y, yaw = pose_after_arc(x, y, yaw, math.copysign(step, length), turn * step / distance)
        remaining -= step
    if remaining > 0.0 or distance == 0.0:
        yaw += turn * remaining / distance if distance > 0.0 else turn
    return x, y, yaw, math.copysign(distance - remaining, length), bumped


@njit(cache=True, error_model="numpy", forceinline=True)
def pose_after_arc(x, y, yaw, length, turn):
    """Pose at the end of an arc of `length` [m] and `turn` [rad]."""
    half = 0.5 * turn
    chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


@njit(cache=True, error_model="numpy", forceinline=True)
def wheel_speed(initial_speed, change, signed_duration, time, acceleration, coupling):
    """Rim speed [m/s] of a wheel that changes its `initial_speed` by `change`, `time` [s] after the change began.

    Both motors push for abs(`signed_duration`) [s], in the same direction if it is positive; afterwards one motor
    pushes alone. The motors have the `acceleration` and the `coupling` of `Robot` [m/s^2].
    """
    coupled_acceleration = acceleration + math.copysign(1.0, signed_duration) * coupling
    coupled_time = min(time, abs(signed_duration))
    gain = min(coupled_acceleration * coupled_time + acceleration * (time - coupled_time), abs(change))
    return initial_speed + math.copysign(gain, change)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def move(i, constants, robots, duration):
    """Drive robot `i` for a `duration` [s] in three phases: both wheels accelerate, then one wheel, then none.

    The phases are solved without physics steps, but with PyBullet's error: a step has the speed at its end and the
    heading at its start.

    Returns:
        Distance covered [m], positive forwards; turn [rad]; and whether the robot touched an obstacle.
    """
    episode, robot = robots.initial_states[i], robots.records[i]
    spatial_index, world_id, physics_step = constants.spatial_index, int(episode.world), constants.physics_step
    radius, separation = episode.radius, episode.wheel_separation
    acceleration, coupling = episode.wheel_acceleration, episode.wheel_coupling
    v, w = robot.command[0], robot.command[1]
    scale = episode.wheel_radius  # a ratio, true / nominal
    turn_speed = 0.5 * separation * min(max(w, -episode.max_turn_rate), episode.max_turn_rate)  # of the rims
    turn_speed *= episode.assumed_separation * scale  # assumed / true separation
    v = min(max(v, -episode.max_speed), episode.max_speed) * scale
    left, right = robot.wheel_speeds[0], robot.wheel_speeds[1]
    change_left, change_right = v - turn_speed - left, v + turn_speed - right
    sign = math.copysign(1.0, change_left * change_right)
    smaller, larger = min(abs(change_left), abs(change_right)), max(abs(change_left), abs(change_right))
    first_end = smaller / (acceleration + sign * coupling)  # [s] when the first wheel has reached its speed
    second_end = first_end + (larger - smaller) / acceleration
    signed_duration = math.copysign(first_end, sign)

    x, y, yaw = robot.pose[0], robot.pose[1], robot.pose[2]
    max_distance = max(abs(left), abs(right), abs(v) + abs(turn_speed)) * duration
    is_free = clearance_at(x, y, spatial_index, world_id) > radius + max_distance  # no obstacle matters in this step
    bumped, distance, total_turn = False, 0.0, 0.0
    time, end = 0.5 * physics_step, duration + 0.5 * physics_step  # shifted, for the speed at a step's end
    last_left = wheel_speed(left, change_left, signed_duration, time, acceleration, coupling)
    last_right = wheel_speed(right, change_right, signed_duration, time, acceleration, coupling)
    for phase in range(3):
        phase_end = min(first_end if phase == 0 else second_end if phase == 1 else end, end)
        if phase_end <= time:
            continue
        next_left = wheel_speed(left, change_left, signed_duration, phase_end, acceleration, coupling)
        next_right = wheel_speed(right, change_right, signed_duration, phase_end, acceleration, coupling)
        mean_left, mean_right = 0.5 * (last_left + next_left), 0.5 * (last_right + next_right)
        length = 0.5 * (mean_left + mean_right) * (phase_end - time)
        rate = (mean_right - mean_left) / separation
        turn, lag = rate * (phase_end - time), 0.5 * rate * physics_step  # lag: for the heading at a step's start
        if is_free:
            x, y, yaw = pose_after_arc(x, y, yaw - lag, length, turn)
        else:
            x, y, yaw, length, hit = move_along_arc(x, y, yaw - lag, length, turn, radius, spatial_index, world_id)
            bumped = bumped or hit
        yaw += lag
        distance += length
        total_turn += turn
        last_left, last_right, time = next_left, next_right, phase_end
    robot.pose[0], robot.pose[1] = x, y
    robot.pose[2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
    robot.wheel_speeds[0] = wheel_speed(left, change_left, signed_duration, duration, acceleration, coupling)
    robot.wheel_speeds[1] = wheel_speed(right, change_right, signed_duration, duration, acceleration, coupling)
    return distance, total_turn, bumped


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def move_among_obstacles(i, constants, robots, duration, obstacles):
    """Move the dynamic obstacles of robot `i`, and then the robot as `move` does, in each physics step.

    Returns:
        Distance covered [m], turn [rad], and whether the robot touched a wall, or a dynamic obstacle (two flags).
    """
    initial_states, robot = robots.initial_states, robots.records[i]
    episode, spatial_index = initial_states[i], constants.spatial_index
    world_id, radius, pose, wheel_speeds = int(episode.world), episode.radius, robot.pose, robot.wheel_speeds
    steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))  # as many as in PyBullet
    step_time = duration / steps
    # `wheel_radius` is a ratio, true / nominal.
    max_speed = max(abs(wheel_speeds[0]), abs(wheel_speeds[1]), episode.max_speed * episode.wheel_radius)
    x, y = pose[0], pose[1]
    if motion.is_out_of_reach(x, y, max_speed, duration, radius, obstacles.obstacles, i):
        motion.step_obstacles_alone(i, steps, step_time, obstacles, initial_states, spatial_index, world_id, (x, y))
        distance, total_turn, wall_hit = move(i, constants, robots, duration)
        return distance, total_turn, wall_hit, False
    wall_hit, obstacle_hit, distance, total_turn = False, False, 0.0, 0.0
    for step in range(steps):
        x, y, yaw, v = pose[0], pose[1], pose[2], 0.5 * (wheel_speeds[0] + wheel_speeds[1])
        robot_motion, world = (x, y, v * math.cos(yaw), v * math.sin(yaw)), (initial_states, spatial_index, world_id)
        hit = motion.step_obstacles(i, step, steps, step_time, obstacles, *world, robot_motion)
        obstacle_hit = hit or obstacle_hit
        length, turn, hit = move(i, constants, robots, step_time)
        wall_hit = hit or wall_hit
        share = 1.0
        for k in range(obstacles.obstacles.shape[1]):
            obstacle = obstacles.obstacles[i, k]
            if obstacle.length > 0.0:  # otherwise the record is empty
                relative = x - obstacle.x, y - obstacle.y, pose[0] - obstacle.x, pose[1] - obstacle.y
                share = min(share, motion.share_until_contact(*relative, radius, obstacle))
        if share < 1.0:
            obstacle_hit = True
            pose[0], pose[1] = x + share * (pose[0] - x), y + share * (pose[1] - y)
        distance, total_turn = distance + share * length, total_turn + turn
    return distance, total_turn, wall_hit, obstacle_hit


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _step_robots(first, end, constants, before, robots, commands, duration, scratch, obstacles):
    """Loop of `step_block`, without allocations, because numba counts array references in functions that allocate."""
    for i in range(first, end):
        robots.records[i] = before[i]
        robot = robots.records[i]
        x, y, speed = robot.pose[0], robot.pose[1], robot.twist[0]
        robot.command[0], robot.command[1] = commands[i, 0], commands[i, 1]
        wall_hit, obstacle_hit = False, False
        if obstacles is None:
            distance, turn, wall_hit = move(i, constants, robots, duration)
        else:
            distance, turn, wall_hit, obstacle_hit = move_among_obstacles(i, constants, robots, duration, obstacles)
        robot.bumped = wall_hit or obstacle_hit
        robot.arc[0], robot.arc[1] = distance, turn
        robot.travelled = math.hypot(robot.pose[0] - x, robot.pose[1] - y)
        robot.twist[0] = 0.5 * (robot.wheel_speeds[0] + robot.wheel_speeds[1])
        robot.twist[1] = (robot.wheel_speeds[1] - robot.wheel_speeds[0]) / robots.initial_states[i].wheel_separation
        robot.acceleration = (robot.twist[0] - speed) / duration
        robot.stream[1] += np.uint64(1)
        scan(i, constants, robots, scratch, obstacles)
        if obstacles is not None:  # contacts override ranges, and wall contacts override obstacle contacts
            robot.nearest_is_dynamic = not wall_hit and (obstacle_hit or robot.nearest_is_dynamic)


@njit(cache=True, nogil=True, error_model="numpy")
def step_block(first, end, constants, before, robots, commands, duration, obstacles):
    """Step the robots from `first` to `end` - 1 for a control period.

    Args:
        first, end, constants, obstacles: See the line above, and the top of the module.
        before: Records of the robots before the step, shape (num_envs,).
        robots: The initial states are inputs; records and ranges are overwritten with the results.
        commands: v [m/s] and w [rad/s], shape (num_envs, 2).
        duration: Of the control period [s].
    """
    beams = constants.beams[0].size
    scratch = np.empty(beams), np.empty(beams)
    _step_robots(first, end, constants, before, robots, commands, duration, scratch, obstacles)
