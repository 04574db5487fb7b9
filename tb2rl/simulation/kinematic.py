"""The fast twin of the physics: robots that move along exact arcs, thousands of them together in compiled code.

What is simulated is what decides where a differential drive goes on a floor: two wheels whose speeds ramp to what they
are told, the arcs between, walls that stop the base, and the exact laser. `tests/simulation/test_kinematic.py` holds
the twin against the robot in PyBullet.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, WHEEL_SEPARATION
from tb2rl.simulation.depth import depth_images
from tb2rl.simulation.movers import movers_of
from tb2rl.simulation.odometry import believed, count_on, is_exact
from tb2rl.simulation.reading import Reading
from tb2rl.simulation.setup import BELIEVED_SEPARATION, PHYSICS_RATE, WHEEL, Setup
from tb2rl.simulation.start import Start
from tb2rl.simulation.stepping import begin_some, sense_some, step_block, step_block_among
from tb2rl.simulation.threads import share_out
from tb2rl.worlds.index import join

ROBOT, BEAM = 0.25e-6, 4e-9  # [s] what a step costs a thread, for each robot and for each of its beams
MOVER = 2e-6  # [s] and for each mover
WAKING = 0.06e-3  # [s] until another thread has begun
WORTH_THREADS = 0.25e-3  # [s] of work; to wake a thread costs 0.1 ms, and more on a busy machine


class KinematicSimulation:
    """N robots that do not meet, each in one of the worlds.

    Args:
        setup: The robot, its laser and the worlds.
        robots: How many.

    Attributes:
        moved: How far from where it was the last step took each robot [m], shape (robots,).
    """

    moved: np.ndarray

    def __init__(self, setup: Setup, robots: int = 1) -> None:
        self.setup, self.laser, self.robots = setup, setup.laser, robots
        laser, worlds = setup.laser, setup.worlds
        self._index = join([world.index for world in worlds])
        self._beams = np.stack([np.cos(laser.angles), np.sin(laser.angles)])
        self._physics_step = 1.0 / (PHYSICS_RATE * setup.substeps)  # [s]
        self._limits = np.array([laser.noise, laser.min_range, laser.max_range])
        self._start = Start.proposed(setup, robots)
        self._poses, self._rims = self._start.pose.copy(), np.zeros((robots, 2))
        self._streams = np.zeros((robots, 2), dtype=np.uint64)  # key of each, and how often it has read
        self._bumped = np.zeros(robots, dtype=bool)
        self._twists, self._commands = np.zeros((robots, 2)), np.zeros((robots, 2))
        self._accelerations = np.zeros(robots)
        self._odometry: np.ndarray | None = None  # None: the wheels are what they should be, so it is the truth
        self._movers = movers_of(setup, robots)
        self._moving = np.zeros(robots, dtype=bool)

    def reset(self, start: Start, rng: np.random.Generator) -> Reading:
        self._start = start
        self._poses, self._rims = start.pose.copy(), np.zeros((self.robots, 2))
        self._bumped = np.zeros(self.robots, dtype=bool)
        self._commands, self._accelerations = np.zeros((self.robots, 2)), np.zeros(self.robots)
        self._odometry = None if is_exact(start) else self._poses.copy()
        self._streams = np.zeros((self.robots, 2), dtype=np.uint64)
        self._streams[:, 0] = rng.integers(2**64, size=self.robots, dtype=np.uint64)
        self._renew_movers()
        self._begin_movers(np.arange(self.robots), start)
        return self._look()

    def step(self, commands: np.ndarray, duration: float) -> Reading:
        poses, rims = self._poses.copy(), self._rims.copy()  # readings keep what they show
        twists, ways = np.empty_like(rims), np.empty_like(rims)
        moved, accelerations = np.empty(self.robots), np.empty(self.robots)
        bumped, ranges = np.empty(self.robots, dtype=bool), np.empty((self.robots, self._beams.shape[1]))
        nearest = np.empty(self.robots)
        commands = np.array(commands, dtype=float, order="C")  # a copy: an episode that ends overwrites it
        self._renew_movers()
        self.advance(poses, rims, commands, duration, twists, ways, moved, accelerations, bumped, nearest, ranges)
        self._poses, self._rims, self._bumped, self.moved = poses, rims, bumped, moved
        self._twists, self._commands, self._accelerations = twists, commands, accelerations
        if self._odometry is not None:
            self._odometry = count_on(self._odometry, believed(ways, self._start))
        reading = self._reading(ranges)
        vars(reading)["nearest"] = nearest  # found on the way, while the ranges were at hand
        return reading

    def advance(
        self,
        poses: np.ndarray,
        rims: np.ndarray,
        commands: np.ndarray,
        duration: float,
        twists: np.ndarray,
        ways: np.ndarray,
        moved: np.ndarray,
        accelerations: np.ndarray,
        bumped: np.ndarray,
        nearest: np.ndarray,
        ranges: np.ndarray,
    ) -> None:
        """The compiled work of a step alone, into the caller's arrays (see `stepping.step_block`).

        For `step` and the benchmark. The movers are not the caller's: they are where they were, and go on from there.
        """
        data: tuple[Any, ...] = (
            poses, rims, commands, duration, self._physics_step, self._start.table, *self._index, self._beams,
            self._limits, self._streams, twists, ways, moved, accelerations, bumped, nearest, ranges,
        )  # fmt: skip
        cost, work = ROBOT + BEAM * ranges.shape[1], step_block
        if self._movers is not None:
            work = step_block_among
            data += (self._movers.table, self._movers.walks, self._movers.routes, self._moving)
            cost += MOVER * self._movers.table.shape[1]
        if self.robots * cost > WORTH_THREADS:
            share_out(work, self.robots, int(WAKING / cost), *data)
        else:
            work(0, self.robots, *data)

    def restart(self, robots: np.ndarray, start: Start, reading: Reading) -> tuple[Reading, Reading]:
        """Begin new episodes of the robots with indices `robots` (n,), and write them into the last reading.

        Args:
            robots: Shape (n,).
            start: One row for each of them.
            reading: The last one; its arrays are changed in place.

        Returns:
            The reading of all robots, and that of those which begin, n rows.
        """
        state = self._start.table, self._poses, self._rims, self._streams
        told = self._twists, self._commands, self._accelerations, self._bumped
        begin_some(robots, start.table, *state, *told)
        if self._odometry is not None:
            self._odometry[robots] = start.pose
        elif not is_exact(start):
            self._odometry = self._poses.copy()
        self._begin_movers(robots, start)
        self._sense(robots, reading.ranges)
        # Cut out of the reading of all, array by array, it would take four times as long. They all stand.
        still, untouched, steady = np.zeros((len(robots), 2)), np.zeros(len(robots), dtype=bool), np.zeros(len(robots))
        truth, ranges = (start.pose, still), reading.ranges[robots]
        first = Reading(*truth, *truth, ranges, untouched, still, steady, start, self, *self._seen(robots))
        return self._reading(reading.ranges), first

    def state(self) -> dict[str, Any]:
        """Poses, rim speeds, random streams and starts of all robots, and what moves beside them."""
        now = {"poses": self._poses, "rims": self._rims, "streams": self._streams, "bumped": self._bumped}
        now |= {"commands": self._commands, "accelerations": self._accelerations}
        now["odometry"] = self._poses if self._odometry is None else self._odometry
        moving = {} if self._movers is None else {"movers": self._movers.state()}
        return {**{name: array.copy() for name, array in now.items()}, "start": self._start.table.copy(), **moving}

    def restore(self, state: Mapping[str, Any]) -> Reading:
        """Go on from a state.

        Raises:
            ValueError: If it names a world that is not there, robots so fast that a step would not end, or
                other movers.
        """
        start = Start(np.array(state["start"]))
        self.setup.check_table(start.table)
        table, robot = start.table, start.parameters
        reach = 0.5 * robot[:, WHEEL_SEPARATION] * table[:, BELIEVED_SEPARATION] * robot[:, MAX_TURN_RATE]
        fastest = table[:, WHEEL] * (robot[:, MAX_SPEED] + reach)
        if not (np.abs(state["rims"]) <= 1.01 * fastest[:, None]).all():
            raise ValueError("the wheels turn faster than they can")
        if self._movers is not None:
            self._movers.restore(state["movers"], start)
            self._renew_movers()
        self._start = start
        self._poses, self._rims = state["poses"].copy(), state["rims"].copy()
        self._streams, self._bumped = state["streams"].copy(), state["bumped"].copy()
        self._commands, self._accelerations = state["commands"].copy(), state["accelerations"].copy()
        exact = is_exact(start) and (state["odometry"] == state["poses"]).all()
        self._odometry = None if exact else state["odometry"].copy()
        return self._look()

    def close(self) -> None:
        """Nothing to free."""

    def _look(self) -> Reading:
        """What the robots read where they are now."""
        ranges = np.empty((self.robots, self._beams.shape[1]))
        self._sense(np.arange(self.robots), ranges)
        separation = self._start.parameters[:, WHEEL_SEPARATION]
        speeds = self._rims.mean(axis=1), np.diff(self._rims, axis=1)[:, 0] / separation
        self._twists = np.stack(speeds, axis=1)
        return self._reading(ranges)

    def _reading(self, ranges: np.ndarray) -> Reading:
        """With the laser's ranges (robots, beams): the wheels do not slip."""
        truth = counted = self._poses, self._twists
        if self._odometry is not None:
            counted = self._odometry, believed(self._twists, self._start)
        told = self._commands, self._accelerations
        return Reading(*truth, *counted, ranges, self._bumped, *told, self._start, self, *self._seen())

    def look(self, reading: Reading, width: int, height: int) -> tuple[None, np.ndarray]:
        """Depth images, see `Reading.look`; the twin has no colours."""
        camera = self.setup.robot.camera
        return None, depth_images(camera, reading.pose, reading.start.world, self._index, width, height, reading.movers)

    def _sense(self, robots: np.ndarray, ranges: np.ndarray) -> None:
        laser = self._beams, self._limits, self._streams
        moving = () if self._movers is None else (self._movers.table, self._moving)
        sense_some(robots, self._poses, self._start.table, *self._index, *laser, ranges, *moving)

    def _seen(self, robots: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, ...]:
        """What the reading of some robots says of movers, see `Reading`."""
        return () if self._movers is None else (self._movers.outlines[robots], self._moving[robots])

    def _renew_movers(self) -> None:
        """Arrays of their own for what comes now: readings keep what they show."""
        if self._movers is not None:
            self._movers.table, self._moving = self._movers.table.copy(), np.zeros(self.robots, dtype=bool)

    def _begin_movers(self, robots: np.ndarray, start: Start) -> None:
        if self._movers is not None:
            self._movers.begin(robots, start, self._index, start.world.astype(int))
