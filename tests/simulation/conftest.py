"""Robots to drive in PyBullet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest

from tb2rl.core.plugins import robot_names
from tb2rl.robots.registry import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.worlds.description import world_from

OPEN = {"boxes": [{"centre": [19, 19], "size": [1, 1]}], "bounds": [-20, -20, 20, 20]}


def _rows(robot_state: RobotState) -> Iterator[np.ndarray]:
    """Everything in a reading, each an array (num_envs, n)."""
    values = robot_state.state()
    del values["initial_state"], values["bumped"]
    yield from (value.reshape(len(value), -1) for value in values.values())
    yield robot_state.bumped[:, None]


class Track:
    """One robot in PyBullet, to be placed and driven."""

    def __init__(self, simulation: BulletSimulator) -> None:
        self.simulation, self.world, self.robot = simulation, simulation.spec.worlds[0], simulation.spec.robot

    def place(self, x=0.0, y=0.0, yaw=0.0, seed=0) -> RobotState:
        """The first reading of an episode that begins here."""
        start = InitialState.default(self.simulation.spec, 1)
        start.pose[:] = x, y, yaw
        return self.simulation.reset(start, np.random.default_rng(seed))

    def drive(self, commands, duration=0.2) -> list[RobotState]:
        """The readings of a robot that is told each of `commands` (steps, 2) for `duration` [s]."""
        return [self.simulation.step(np.array([command]), duration) for command in commands]

    def gaps(self, readings) -> np.ndarray:
        """Distances between the base and the nearest wall [m], all around, shape (readings,)."""
        return (
            np.array([self.world.clearance(*robot_state.pose[0, :2]) for robot_state in readings]) - self.robot.radius
        )

    @staticmethod
    def gap(pose, other) -> tuple[float, float]:
        """Distance [m] and angle [rad] between two poses (1, 3)."""
        dx, dy, turn = (pose - other)[0]
        return math.hypot(dx, dy), abs(math.remainder(turn, math.tau))

    @staticmethod
    def record(readings) -> np.ndarray:
        """Everything in some readings as one array, to compare to the bit."""
        return np.array([np.hstack([*_rows(r)])[0] for r in readings])


@pytest.fixture(params=robot_names())
def robot(request):
    """Each robot that has a name."""
    return find_robot(request.param)


@pytest.fixture
def make_bullet():
    """A function from a setup to its simulation in PyBullet, which is closed after the test."""
    with ExitStack() as stack:
        yield lambda spec: stack.enter_context(closing(BulletSimulator(spec)))


@pytest.fixture
def make_track(make_setup, make_bullet):
    """A function from a world file's content, the robot, and fields of its laser (else of one beam), to a `Track`."""

    def make(content=OPEN, robot=ROBOT, **laser) -> Track:
        world = world_from({"start": [-2, 0, 0], "bounds": [-5, -5, 5, 5], **content}, "test")
        return Track(make_bullet(make_setup(world, robot=robot, **{"beams": 1, **laser})))

    return make


@pytest.fixture
def start_at():
    """A function from a setup and poses (num_envs, 3) to the start of episodes there."""

    def start(spec: SimulationSpec, poses, world=0) -> InitialState:
        start = InitialState.default(spec, len(poses), world)
        start.pose[:] = poses
        return start

    return start
