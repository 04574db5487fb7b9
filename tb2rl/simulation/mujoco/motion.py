"""Compiled parts of MuJoCo's control step: what comes before and after the physics.

Arguments in common: `first` and `end` are a range of robots, and `step` is `ControlStep`; for the others, see
`tb2rl.simulation.arrays.robots`.
"""

import math
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation.arrays.robots import scan
from tb2rl.simulation.obstacles import motion
from tb2rl.worlds.geometry import clearance_at

X, Y, YAW = 0, 1, 3  # columns of the joints of the base in `ControlStep.joints`; 2 is z
NEAR_OBSTACLES = -1  # value of `ControlStep.free_steps`: dynamic obstacles may affect the robot
_MARGIN = 0.02  # [m] added to the robot's radius, because a robot that rebounds can exceed its commanded speed


class ControlStep(NamedTuple):
    """A control step of all robots."""

    commands: np.ndarray  # v [m/s] and w [rad/s], shape (num_envs, 2)
    duration: float  # [s]
    steps: int  # number of physics steps
    wheel_radius: float  # [m] nominal
    wheel_separation: float  # [m] nominal
    wheels: tuple[int, int]  # columns of the left and the right wheel in the arrays of joints
    joints_before: np.ndarray  # [m, m, m, rad, rad, rad] joint positions, shape (num_envs, 6)
    # Results of `begin_step`:
    wheel_rates: np.ndarray  # [rad/s] target rates of the wheels, shape (num_envs, 2)
    free_steps: np.ndarray  # physics steps in which a robot cannot reach a wall, or `NEAR_OBSTACLES`, shape (num_envs,)
    # Results of the physics:
    joints: np.ndarray  # joint positions, shape (num_envs, 6)
    rates: np.ndarray  # [m/s or rad/s] joint velocities, shape (num_envs, 6)
    touches: np.ndarray  # whether a robot touched a wall, and whether a dynamic obstacle, bool, shape (num_envs, 2)


@njit(cache=True, nogil=True, error_model="numpy")
def begin_step(first, end, constants, robots, step, obstacles):
    """Compute the targets of the wheels; obstacles that cannot reach their robot complete the control step."""
    for i in range(first, end):
        episode, pose, world_id = robots.initial_states[i], robots.records[i].pose, int(robots.initial_states[i].world)
        x, y = pose[0], pose[1]
        v = min(max(step.commands[i, 0], -episode.max_speed), episode.max_speed)
        w = min(max(step.commands[i, 1], -episode.max_turn_rate), episode.max_turn_rate)
        # The model has nominal wheels. Scaled commands move the robot as other wheels would.
        turn_speed = 0.5 * step.wheel_separation * episode.assumed_separation * w
        scale = episode.wheel_radius / step.wheel_radius  # `episode.wheel_radius` is a ratio, true / nominal
        step.wheel_rates[i, 0], step.wheel_rates[i, 1] = (v - turn_speed) * scale, (v + turn_speed) * scale
        gap = clearance_at(x, y, constants.spatial_index, world_id) - episode.radius - _MARGIN
        max_speed = episode.max_speed * episode.wheel_radius
        share = max(gap, 0.0) / max(max_speed * step.duration, 1e-9)
        step.free_steps[i] = int(min(share, 1.0) * step.steps)
        if obstacles is None:
            continue
        speed = max(abs(robots.records[i].twist[0]), max_speed)
        if motion.is_out_of_reach(x, y, speed, step.duration, episode.radius, obstacles.obstacles, i):
            world = robots.initial_states, constants.spatial_index, world_id
            motion.step_obstacles_alone(i, step.steps, step.duration / step.steps, obstacles, *world, (x, y))
        else:
            step.free_steps[i] = NEAR_OBSTACLES


@njit(cache=True, **NO_REFCOUNT, error_model="numpy")
def _measure(first, end, constants, before, robots, step, obstacles, scratch):
    """Loop of `end_step`, without allocations, because numba counts array references in functions that allocate."""
    left_wheel, right_wheel = step.wheels
    for i in range(first, end):
        robots.records[i] = before[i]
        robot, separation = robots.records[i], robots.initial_states[i].wheel_separation
        yaw, last_x, last_y, last_speed = step.joints[i, YAW], robot.pose[0], robot.pose[1], robot.twist[0]
        robot.command[0], robot.command[1] = step.commands[i, 0], step.commands[i, 1]
        robot.pose[0], robot.pose[1] = step.joints[i, X], step.joints[i, Y]
        robot.pose[2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
        robot.twist[0] = step.rates[i, X] * math.cos(yaw) + step.rates[i, Y] * math.sin(yaw)
        robot.twist[1] = step.rates[i, YAW]
        robot.acceleration = (robot.twist[0] - last_speed) / step.duration
        robot.travelled = math.hypot(robot.pose[0] - last_x, robot.pose[1] - last_y)
        left = (step.joints[i, left_wheel] - step.joints_before[i, left_wheel]) * step.wheel_radius
        right = (step.joints[i, right_wheel] - step.joints_before[i, right_wheel]) * step.wheel_radius
        robot.arc[0], robot.arc[1] = 0.5 * (left + right), (right - left) / step.wheel_separation
        left, right = step.rates[i, left_wheel] * step.wheel_radius, step.rates[i, right_wheel] * step.wheel_radius
        half_difference = 0.5 * separation * (right - left) / step.wheel_separation  # of wheels with this separation
        robot.wheel_speeds[0] = 0.5 * (left + right) - half_difference
        robot.wheel_speeds[1] = 0.5 * (left + right) + half_difference
        robot.bumped = step.touches[i, 0] or step.touches[i, 1]
        robot.stream[1] += np.uint64(1)
        scan(i, constants, robots, scratch, obstacles)
        if obstacles is not None:  # contacts override ranges, and wall contacts override obstacle contacts
            robot.nearest_is_dynamic = not step.touches[i, 0] and (step.touches[i, 1] or robot.nearest_is_dynamic)


@njit(cache=True, nogil=True, error_model="numpy")
def end_step(first, end, constants, before, robots, step, obstacles):
    """Write records and ranges of the robots after a control step; `before` are their records before it."""
    beams = constants.beams[0].size
    _measure(first, end, constants, before, robots, step, obstacles, (np.empty(beams), np.empty(beams)))
