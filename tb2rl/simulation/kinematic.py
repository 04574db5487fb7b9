"""The fast twin of the physics: robots that move along exact arcs, thousands of them together in compiled code.

What is simulated is what decides where a TurtleBot2 goes on a floor: two wheels whose speeds ramp to what they are
told, the arcs between, walls that stop the base, and the exact laser. `tests/test_kinematic.py` identifies the ramp
from the robot in PyBullet, and holds the twin against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from tb2rl import robot
from tb2rl.laser import cast_one, clearance_one, limit_ranges
from tb2rl.maze import Maze
from tb2rl.simulation import PHYSICS_RATE, Reading
from tb2rl.streams import normal

WHEEL_ACCELERATION = 2.932  # [m/s^2] of a rim whose motor pushes alone, identified from the robot in PyBullet
WHEEL_COUPLING = 0.067  # [m/s^2] more where both motors push the same way, less where they push against each other
PHYSICS_STEP = (
    1.0 / PHYSICS_RATE
)  # [s] PyBullet moves with the speed at the end of a step, along the heading at its start
CONTACT = 1.0e-4  # [m] a gap below this is contact
BLOCK = 64  # robots that a thread takes at a time
ROBOT, BEAM = 0.4e-6, 5e-9  # [s] what a step costs a thread, for each robot and for each of its beams
WORTH_THREADS = 0.2e-3  # [s] of work; to wake a thread costs up to 0.09 ms, and more on a busy machine
_NUDGE = 1.0e-3  # [m] how far to look whether the way leads off a wall that is touched


@njit(cache=True, error_model="numpy")
def drive_arc(x, y, yaw, length, turn, boxes, posts):
    """Move a robot along an arc, up to where an obstacle stops it; it turns all the same.

    Conservative advancement (Mirtich 1996): no step is longer than the gap to the nearest obstacle, so none is jumped
    over, however fast the robot is.

    Args:
        x, y, yaw: Pose [m, m, rad].
        length: Of the arc [m], negative backwards.
        turn: From its start to its end [rad].
        boxes, posts: As in `Maze`.

    Returns:
        The pose after it, and whether an obstacle was touched.
    """
    whole = abs(length)
    left, bumped = whole, False
    while left > 0.0:
        gap = clearance_one(x, y, boxes, posts) - robot.BASE_RADIUS
        if gap < CONTACT:
            nudge = math.copysign(_NUDGE, length)
            off = clearance_one(x + nudge * math.cos(yaw), y + nudge * math.sin(yaw), boxes, posts)
            if off - robot.BASE_RADIUS <= gap:
                bumped = True
                break
            gap = _NUDGE
        part = min(gap, left)
        x, y, yaw = along_arc(x, y, yaw, math.copysign(part, length), turn * part / whole)
        left -= part
    if left > 0.0 or whole == 0.0:
        yaw += turn * left / whole if whole > 0.0 else turn
    return x, y, yaw, bumped


@njit(cache=True, error_model="numpy")
def along_arc(x, y, yaw, length, turn):
    """The pose at the end of an arc: its chord, at half the turn."""
    half = 0.5 * turn
    chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


@njit(cache=True, error_model="numpy")
def rim_speed(start, change, together, clock):
    """Speed of a rim on its way to `start` + `change` [m/s], `clock` [s] after both motors began to push.

    Until `together` [s] both push, and push each other along or back; after that the one that is left pushes alone.
    """
    both = WHEEL_ACCELERATION + math.copysign(WHEEL_COUPLING, together)
    early = min(clock, abs(together))
    gained = min(both * early + WHEEL_ACCELERATION * (clock - early), abs(change))
    return start + math.copysign(gained, change)


@njit(cache=True, error_model="numpy")
def drive(pose, rims, v, w, duration, boxes, posts):
    """One robot's control step: both rims ramp, then one, then none; changes `pose` (3,) and `rims` (2,) in place."""
    reach = 0.5 * robot.WHEEL_SEPARATION * min(max(w, -robot.MAX_TURN_RATE), robot.MAX_TURN_RATE)
    v = min(max(v, -robot.MAX_SPEED), robot.MAX_SPEED)
    left, right = rims[0], rims[1]
    change_left, change_right = v - reach - left, v + reach - right
    sense_of_both = math.copysign(1.0, change_left * change_right)
    fewer, more = min(abs(change_left), abs(change_right)), max(abs(change_left), abs(change_right))
    first = fewer / (WHEEL_ACCELERATION + sense_of_both * WHEEL_COUPLING)
    second = first + (more - fewer) / WHEEL_ACCELERATION
    together = math.copysign(first, sense_of_both)

    x, y, yaw = pose[0], pose[1], pose[2]
    # Far from walls nothing needs to be looked at on the way.
    longest = max(abs(left), abs(right), abs(v) + abs(reach)) * duration
    free = clearance_one(x, y, boxes, posts) > robot.BASE_RADIUS + longest
    bumped = False
    clock, end = 0.5 * PHYSICS_STEP, duration + 0.5 * PHYSICS_STEP
    last_left = rim_speed(left, change_left, together, clock)
    last_right = rim_speed(right, change_right, together, clock)
    for phase in range(3):
        until = min(first if phase == 0 else second if phase == 1 else end, end)
        if until <= clock:
            continue
        next_left = rim_speed(left, change_left, together, until)
        next_right = rim_speed(right, change_right, together, until)
        mean_left, mean_right = 0.5 * (last_left + next_left), 0.5 * (last_right + next_right)
        length = 0.5 * (mean_left + mean_right) * (until - clock)
        rate = (mean_right - mean_left) / robot.WHEEL_SEPARATION
        lag = 0.5 * rate * PHYSICS_STEP
        if free:
            x, y, yaw = along_arc(x, y, yaw - lag, length, rate * (until - clock))
        else:
            x, y, yaw, hit = drive_arc(x, y, yaw - lag, length, rate * (until - clock), boxes, posts)
            bumped = bumped or hit
        yaw += lag
        last_left, last_right, clock = next_left, next_right, until
    pose[0], pose[1] = x, y
    pose[2] = yaw - math.tau * math.floor((yaw + math.pi) / math.tau)
    rims[0] = rim_speed(left, change_left, together, duration)
    rims[1] = rim_speed(right, change_right, together, duration)
    return bumped


@njit(cache=True, error_model="numpy")
def sense(pose, cos_beams, sin_beams, boxes, posts, limits, key, step, scratch, ranges):
    """One robot's laser, into `ranges` (beams,)."""
    cast_one(pose[0], pose[1], pose[2], cos_beams, sin_beams, boxes, posts, scratch, ranges)
    if limits[0] > 0.0:
        for beam in range(ranges.size):
            ranges[beam] += limits[0] * normal(key, step * np.uint64(ranges.size) + np.uint64(beam))
    limit_ranges(ranges, limits[1], limits[2])


@njit(cache=True, error_model="numpy")
def step_block(
    first, last, poses, rims, commands, duration, boxes, posts, cos_beams, sin_beams, limits, keys, steps,
    twists, bumped, ranges,
):  # fmt: skip
    """A control step of robots `first` to `last` - 1; `limits` are the laser's noise, shortest and longest range."""
    scratch = np.empty((2, cos_beams.size))
    for i in range(first, last):
        bumped[i] = drive(poses[i], rims[i], commands[i, 0], commands[i, 1], duration, boxes, posts)
        twists[i, 0] = 0.5 * (rims[i, 0] + rims[i, 1])
        twists[i, 1] = (rims[i, 1] - rims[i, 0]) / robot.WHEEL_SEPARATION
        steps[i] += np.uint64(1)
        sense(poses[i], cos_beams, sin_beams, boxes, posts, limits, keys[i], steps[i], scratch, ranges[i])


@njit(cache=True, parallel=True, error_model="numpy")
def step_in_threads(
    poses, rims, commands, duration, boxes, posts, cos_beams, sin_beams, limits, keys, steps, twists, bumped, ranges
):
    """`step_block` for all robots, block by block in parallel."""
    robots = poses.shape[0]
    for block in prange((robots + BLOCK - 1) // BLOCK):
        step_block(
            block * BLOCK, min((block + 1) * BLOCK, robots), poses, rims, commands, duration, boxes, posts,
            cos_beams, sin_beams, limits, keys, steps, twists, bumped, ranges,
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def sense_some(robots, poses, boxes, posts, cos_beams, sin_beams, limits, keys, steps, ranges):
    """The laser of the robots with these indices, into their rows of `ranges`."""
    scratch = np.empty((2, cos_beams.size))
    for i in robots:
        sense(poses[i], cos_beams, sin_beams, boxes, posts, limits, keys[i], steps[i], scratch, ranges[i])


@dataclass(frozen=True)
class KinematicState:
    """Poses, rim speeds and random streams of all robots."""

    poses: np.ndarray
    rims: np.ndarray
    keys: np.ndarray
    steps: np.ndarray
    bumped: np.ndarray


class KinematicSimulation:
    """N robots in one maze that do not meet.

    Args:
        maze: Where they are.
        laser: What each reads.
        robots: How many.
    """

    state_type = KinematicState

    def __init__(self, maze: Maze, laser: robot.Laser, robots: int = 1) -> None:
        self.maze, self.laser, self.robots = maze, laser, robots
        self._beams = np.cos(laser.angles), np.sin(laser.angles)
        self._limits = np.array([laser.noise, laser.min_range, laser.max_range])
        self._poses, self._rims = np.zeros((robots, 3)), np.zeros((robots, 2))
        self._keys, self._steps = np.zeros(robots, dtype=np.uint64), np.zeros(robots, dtype=np.uint64)
        self._bumped = np.zeros(robots, dtype=bool)

    def reset(self, poses: np.ndarray, rng: np.random.Generator) -> Reading:
        keys = rng.integers(2**64, size=self.robots, dtype=np.uint64)
        still = np.zeros((self.robots, 2))
        none = np.zeros(self.robots, dtype=bool)
        return self.restore(KinematicState(np.array(poses, dtype=float), still, keys, np.zeros_like(keys), none))

    def step(self, commands: np.ndarray, duration: float) -> Reading:
        poses, rims = self._poses.copy(), self._rims.copy()  # readings keep what they show
        twists, bumped = np.empty_like(rims), np.empty(self.robots, dtype=bool)
        ranges = np.empty((self.robots, self._beams[0].size))
        self.advance(poses, rims, np.ascontiguousarray(commands, dtype=float), duration, twists, bumped, ranges)
        self._poses, self._rims, self._bumped = poses, rims, bumped
        return Reading(poses, twists, poses, ranges, bumped)

    def advance(
        self,
        poses: np.ndarray,
        rims: np.ndarray,
        commands: np.ndarray,
        duration: float,
        twists: np.ndarray,
        bumped: np.ndarray,
        ranges: np.ndarray,
    ) -> None:
        """The compiled work of a step alone, into the caller's arrays; for `step` and the benchmark."""
        data = (
            poses, rims, commands, duration, self.maze.boxes, self.maze.posts, *self._beams, self._limits,
            self._keys, self._steps, twists, bumped, ranges,
        )  # fmt: skip
        if self.robots * (ROBOT + BEAM * ranges.shape[1]) > WORTH_THREADS:
            step_in_threads(*data)
        else:
            step_block(0, self.robots, *data)

    def place(self, robots: np.ndarray, poses: np.ndarray, reading: Reading) -> Reading:
        """Put the robots with indices `robots` (n,) at `poses` (n, 3), at rest, and write it into the last reading."""
        self._poses[robots], self._rims[robots] = poses, 0.0
        self._steps[robots] += np.uint64(1)
        reading.twist[robots], reading.bumped[robots] = 0.0, False
        self._sense(robots, reading.ranges)
        return Reading(self._poses, reading.twist, self._poses, reading.ranges, reading.bumped)

    def state(self) -> KinematicState:
        now = (self._poses, self._rims, self._keys, self._steps, self._bumped)
        return KinematicState(*(array.copy() for array in now))

    def restore(self, state: KinematicState) -> Reading:
        if not (np.abs(state.rims) <= 2.0 * robot.MAX_SPEED + robot.WHEEL_SEPARATION * robot.MAX_TURN_RATE).all():
            raise ValueError("the wheels turn faster than they can")
        self._poses, self._rims = state.poses.copy(), state.rims.copy()
        self._keys, self._steps, self._bumped = state.keys.copy(), state.steps.copy(), state.bumped.copy()
        ranges = np.empty((self.robots, self._beams[0].size))
        self._sense(np.arange(self.robots), ranges)
        speeds = self._rims.mean(axis=1), np.diff(self._rims, axis=1)[:, 0] / robot.WHEEL_SEPARATION
        return Reading(self._poses, np.stack(speeds, axis=1), self._poses, ranges, self._bumped)

    def close(self) -> None:
        """Nothing to free."""

    def _sense(self, robots: np.ndarray, ranges: np.ndarray) -> None:
        boxes, posts = self.maze.boxes, self.maze.posts
        sense_some(robots, self._poses, boxes, posts, *self._beams, self._limits, self._keys, self._steps, ranges)
