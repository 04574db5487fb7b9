"""A scripted policy, scans of random scanners in worlds, and a function that asks a driver in an environment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tb2rl.deploy import Command, Driver, Mounting, Needs, Scan
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many

NEEDS = Needs(np.linspace(-math.pi / 2, math.pi / 2, 37), 0.1, 30.0, 0.2, max_speed=0.5, max_turn_rate=1.0, robot="any")


class ScriptedPolicy:
    """Returns `speeds` and keeps the sensor data of each episode."""

    def __init__(self, **needs) -> None:
        self.needs = replace(NEEDS, **needs)
        self.speeds = 0.4, 0.2
        self.episodes: list[list] = []

    def reset(self):
        self.episodes.append([])

    def act(self, sensed):
        self.episodes[-1].append(sensed)
        return self.speeds


@pytest.fixture
def scripted_policy() -> type[ScriptedPolicy]:
    """The class `ScriptedPolicy`."""
    return ScriptedPolicy


def cast(world: World, pose: tuple[float, ...] | np.ndarray, angles: np.ndarray, max_range: float) -> np.ndarray:
    """Exact ranges from a pose [m]; inf beyond the maximum."""
    ranges = np.empty((1, len(angles)))
    cast_many(np.array([pose]), np.zeros(1), np.cos(angles), np.sin(angles), *world.index, ranges)
    return np.where(ranges[0] > max_range, np.inf, ranges[0])


@pytest.fixture
def cast_from() -> Callable[..., np.ndarray]:
    """The function `cast`."""
    return cast


@dataclass(frozen=True)
class Scanner:
    """A scanner; the middle of its field of view [rad] is turned from its angle 0 [rad]."""

    field_of_view: float
    readings: int
    mounting: Mounting = field(default_factory=Mounting)
    clockwise: bool = False
    turned: float = 0.0

    def scan(self, world: World, robot: np.ndarray) -> Scan:
        """Its scan in a world from the pose of the robot; float32, as in ROS."""
        m, (x, y, yaw) = self.mounting, robot.tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        pose = x + cos * m.x - sin * m.y, y + sin * m.x + cos * m.y, yaw + m.yaw
        sign = -1.0 if self.clockwise else 1.0
        first, step = self.turned - sign * self.field_of_view / 2, sign * self.field_of_view / (self.readings - 1)
        angles = first + step * np.arange(self.readings)
        ranges = cast(world, pose, -angles if m.upside_down else angles, 30.0)
        return Scan(ranges.astype(np.float32), first, step, 0.1, 30.0)


@pytest.fixture
def scanner() -> type[Scanner]:
    """The class `Scanner`."""
    return Scanner


@pytest.fixture
def scan_of() -> Callable[..., Scan]:
    """A function that makes a scan of ranges over a field of view, by default the half circle ahead."""

    def scan(ranges, field: float = math.pi, range_min: float = 0.1, range_max: float = 30.0) -> Scan:
        ranges = np.asarray(ranges, dtype=float)
        return Scan(ranges, -field / 2, field / (len(ranges) - 1), range_min, range_max)

    return scan


@pytest.fixture
def ask() -> Callable[[Driver, TurtleBot2Env, float], Command]:
    """A function that passes the sensor data of an environment to a driver, and asks it for a command."""

    def asked(driver: Driver, env: TurtleBot2Env, now: float) -> Command:
        robot_state, laser = env.robot_state, env.scene.laser
        first, second = laser.angles[:2].tolist()
        driver.see_scan(Scan(robot_state.ranges[0], first, second - first, laser.min_range, laser.max_range), now)
        driver.see_odometry(tuple(robot_state.odometry[0].tolist()), tuple(robot_state.odometry_twist[0].tolist()), now)
        return driver.command(now)

    return asked
