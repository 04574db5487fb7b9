"""A policy that does as it is told, scans of random sensors in worlds, and the driver of an environment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tb2rl.deploy import Command, Driver, Mounting, Needs, Scan
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many

HALF_CIRCLE = np.linspace(-math.pi / 2, math.pi / 2, 37)


class Told:
    """Acts as it was told, and keeps what it sensed since each beginning."""

    def __init__(self, **needs) -> None:
        usual = Needs(HALF_CIRCLE, 0.1, 30.0, period=0.2, max_speed=0.5, max_turn_rate=1.0, robot="turtlebot2")
        self.needs = replace(usual, **needs)
        self.speeds = 0.4, 0.2
        self.episodes: list[list] = []

    def begin(self):
        self.episodes.append([])

    def act(self, sensed):
        self.episodes[-1].append(sensed)
        return self.speeds


@pytest.fixture
def told() -> type[Told]:
    """The class `Told`."""
    return Told


def cast(world: World, pose: tuple[float, ...] | np.ndarray, angles: np.ndarray, longest: float) -> np.ndarray:
    """Exact ranges from a pose [m]; inf beyond the longest."""
    ranges = np.empty((1, len(angles)))
    cast_many(np.array([pose]), np.zeros(1), np.cos(angles), np.sin(angles), *world.index, ranges)
    return np.where(ranges[0] > longest, np.inf, ranges[0])


@dataclass(frozen=True)
class Sensor:
    """A scanner on a robot."""

    mounting: Mounting
    angle_min: float
    angle_increment: float
    readings: int
    range_max: float = 30.0

    def scan(self, world: World, robot: np.ndarray) -> Scan:
        """What it measures in a world from the pose of the robot; float32, as ROS carries it."""
        m, (x, y, yaw) = self.mounting, robot.tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        place = x + cos * m.x - sin * m.y, y + sin * m.x + cos * m.y, yaw + m.yaw
        angles = self.angle_min + self.angle_increment * np.arange(self.readings)
        ranges = cast(world, place, -angles if m.upside_down else angles, self.range_max)
        return Scan(ranges.astype(np.float32), self.angle_min, self.angle_increment, 0.1, self.range_max)


@pytest.fixture
def make_sensor() -> Callable[..., Sensor]:
    """A function that makes a scanner: its field of view [rad], its readings, its mounting."""

    def make(field: float, readings: int, mounting: Mounting | None = None, clockwise: bool = False, turned=0.0):
        step = field / (readings - 1) * (-1.0 if clockwise else 1.0)
        return Sensor(mounting or Mounting(), turned + (field if clockwise else -field) / 2, step, readings)

    return make


@pytest.fixture
def cast_from() -> Callable[..., np.ndarray]:
    """The function `cast`."""
    return cast


@pytest.fixture
def scan_of() -> Callable[..., Scan]:
    """A function that makes a scan of ranges over a field of view, by default the half circle ahead."""

    def scan(ranges, field: float = math.pi, range_min: float = 0.1, range_max: float = 30.0) -> Scan:
        ranges = np.asarray(ranges, dtype=float)
        return Scan(ranges, -field / 2, field / (len(ranges) - 1), range_min, range_max)

    return scan


@pytest.fixture
def ask() -> Callable[[Driver, TurtleBot2Env, float], Command]:
    """A function that shows a driver what the robot of an environment senses now, and asks it for a command."""

    def asked(driver: Driver, env: TurtleBot2Env, now: float) -> Command:
        robot_state, laser = env.robot_state, env.scene.laser
        first, second = laser.angles[:2].tolist()
        driver.see_scan(Scan(robot_state.ranges[0], first, second - first, laser.min_range, laser.max_range), now)
        driver.see_odometry(tuple(robot_state.odometry[0].tolist()), tuple(robot_state.odometry_twist[0].tolist()), now)
        return driver.command(now)

    return asked
