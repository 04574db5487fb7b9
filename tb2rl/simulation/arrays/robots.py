"""Records of the robots, and compiled functions that reset them and read their lasers.

Arguments in common: `constants` is `Constants`, `robots` is `RobotArrays`, and `i` is the environment. `obstacles` is
`ObstacleArrays`, or None without dynamic obstacles; numba compiles each function for both types.
"""

import math
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation.obstacles.outlines import cast_at_obstacles
from tb2rl.simulation.random_streams import normal, uniform
from tb2rl.worlds.geometry import cast_beams, limit_ranges
from tb2rl.worlds.spatial_index import SpatialIndex

_DROPPED_STREAM = np.uint64(0x5851F42D4C957F2D)  # its xor with the key of a laser's noise is the key for dropped beams

# Motion of a robot, and its measurements of the last step.
ROBOT = np.dtype(
    [
        ("pose", "f8", 3),  # x [m], y [m], yaw [rad]
        ("wheel_speeds", "f8", 2),  # [m/s] of the left and the right rim
        ("stream", "u8", 2),  # random stream of the laser: its key, and the number of scans
        ("command", "f8", 2),  # v [m/s], w [rad/s]
        ("twist", "f8", 2),  # v [m/s], w [rad/s]
        ("arc", "f8", 2),  # distance driven by the wheels [m] and turn [rad] in the step
        ("travelled", "f8"),  # [m] straight distance between the positions before and after the step
        ("acceleration", "f8"),  # [m/s^2] forward, mean of the step
        ("nearest_range", "f8"),  # [m] shortest range of the laser
        ("bumped", "?"),  # whether the base touched an obstacle
        ("nearest_is_dynamic", "?"),  # see `RobotState`
    ],
    align=True,
)


class Constants(NamedTuple):
    """Values for compiled code that never change."""

    spatial_index: SpatialIndex  # obstacles of all worlds
    beams: tuple[np.ndarray, np.ndarray]  # cosines and sines of the laser's beam directions, each of shape (beams,)
    laser_noise: float  # [m] standard deviation
    min_range: float  # [m]
    max_range: float  # [m]
    physics_step: float  # [s] duration of a step of the physics simulators


class RobotArrays(NamedTuple):
    """All robots; compiled code changes the arrays in place."""

    initial_states: np.ndarray  # records of `spec.RECORD`, shape (num_envs,); only `reset_robots` changes them
    records: np.ndarray  # records of `ROBOT`, shape (num_envs,)
    ranges: np.ndarray  # [m] laser ranges, shape (num_envs, beams)


@njit(cache=True, **NO_REFCOUNT, error_model="numpy", forceinline=True)
def scan(i, constants, robots, scratch, obstacles):
    """Write the laser's ranges [m] of robot `i`, the shortest range, and whether a dynamic obstacle is nearest.

    `scratch` consists of two arrays of shape (beams,).
    """
    episode, robot, ranges = robots.initial_states[i], robots.records[i], robots.ranges
    x, y, yaw, beam_count = robot.pose[0], robot.pose[1], robot.pose[2], ranges.shape[1]
    if episode.mount_x != 0.0 or episode.mount_y != 0.0:
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = x + episode.mount_x * cos - episode.mount_y * sin, y + episode.mount_x * sin + episode.mount_y * cos
    yaw += episode.mount_yaw
    cast_beams((x, y, yaw), constants.beams, constants.spatial_index, int(episode.world), scratch, ranges, i)
    if obstacles is not None:
        robot.nearest_is_dynamic = cast_at_obstacles(x, y, yaw, constants.beams, obstacles.obstacles, i, ranges)
    noise = constants.laser_noise if episode.laser_noise < 0.0 else episode.laser_noise
    key, first_number = robot.stream[0], robot.stream[1] * np.uint64(beam_count)
    if noise > 0.0:
        for beam in range(beam_count):
            ranges[i, beam] += noise * normal(key, first_number + np.uint64(beam))
    if episode.bias != 0.0:
        for beam in range(beam_count):
            ranges[i, beam] += episode.bias
    if episode.dropped > 0.0:
        for beam in range(beam_count):
            if uniform(key ^ _DROPPED_STREAM, first_number + np.uint64(beam)) < episode.dropped:
                ranges[i, beam] = np.inf
    robot.nearest_range = limit_ranges(ranges, i, constants.min_range, constants.max_range)


@njit(cache=True, error_model="numpy")
def scan_robots(indices, constants, robots, obstacles):
    """Read the lasers of the robots `indices` (n,), see `scan`."""
    beams = constants.beams[0].size
    scratch = np.empty(beams), np.empty(beams)
    for i in indices:
        scan(i, constants, robots, scratch, obstacles)


@njit(cache=True)
def reset_robots(indices, new_states, keys, constants, robots, obstacles):
    """Put the robots `indices` (n,) at rest in `new_states` (n,), which become their `initial_states`, and scan.

    `keys` (n,) are those of new random streams for the lasers; None: the streams continue.
    """
    for row, i in enumerate(indices):
        start, robot = new_states[row], robots.records[i]
        robots.initial_states[i] = start
        robot.pose[0], robot.pose[1], robot.pose[2] = start.x, start.y, start.yaw
        robot.wheel_speeds[:], robot.command[:], robot.twist[:] = 0.0, 0.0, 0.0
        robot.acceleration, robot.bumped = 0.0, False
        robot.stream[1] += np.uint64(1)
        if keys is not None:
            robot.stream[0], robot.stream[1] = keys[row], np.uint64(0)
    scan_robots(indices, constants, robots, obstacles)


@njit(cache=True)
def wheel_twists(records, initial_states):
    """V [m/s] and w [rad/s] of robots without slip from the speeds of their wheels, shape (num_envs, 2)."""
    twists = np.empty((len(records), 2))
    for i in range(len(records)):
        left, right = records[i].wheel_speeds
        twists[i, 0], twists[i, 1] = 0.5 * (left + right), (right - left) / initial_states[i].wheel_separation
    return twists
