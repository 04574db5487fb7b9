"""A maze and robots in motion: what the robots are told, and what they read.

Everything carries a leading robot axis. `bullet` simulates one robot in PyBullet's physics, the judge of every policy;
`kinematic` is its fast twin, for thousands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tb2rl.errors import InputError, unknown
from tb2rl.laser import shortest

if TYPE_CHECKING:
    from tb2rl.maze import Maze
    from tb2rl.robot import Laser

SIMULATIONS = ("bullet", "kinematic")
PHYSICS_RATE = 80.0  # [Hz] 60 Hz holds every speed too, but hits a wall up to 9 mm deep; 100 Hz costs a third more


@dataclass(frozen=True)
class Reading:
    """What the sensors of all robots say at one instant, and the truth beside it.

    Attributes:
        pose: True x [m], y [m], yaw [rad] in the maze's frame, shape (robots, 3).
        twist: True forward speed [m/s] and turn rate [rad/s], shape (robots, 2).
        odometry: x, y, yaw counted from the wheels since the start pose, shape (robots, 3).
        ranges: Distances along the kept beams [m], right to left, inf where nothing was hit, shape (robots, beams).
        bumped: Whether the base touched a wall since the last reading, shape (robots,), bool.
    """

    pose: np.ndarray
    twist: np.ndarray
    odometry: np.ndarray
    ranges: np.ndarray
    bumped: np.ndarray

    @cached_property
    def nearest(self) -> np.ndarray:
        """The shortest kept range of each robot [m], shape (robots,)."""
        return shortest(self.ranges)


class Simulation(Protocol):
    """Robots that share a maze but not each other's space: they do not meet."""

    robots: int
    state_type: type[Any]  # of `state`: a dataclass of plain values and arrays

    def reset(self, poses: np.ndarray, rng: np.random.Generator) -> Reading:
        """Put the robots at `poses` (robots, 3), at rest; `rng` is the source of their laser noise from now on."""

    def step(self, commands: np.ndarray, duration: float) -> Reading:
        """Drive at `commands` (robots, 2), v [m/s] and w [rad/s], for `duration` [s] of simulated time."""

    def state(self) -> Any:
        """All that the future depends on, to give back to `restore`."""

    def restore(self, state: Any) -> Reading:
        """Go on from a `state` as if nothing had happened since."""

    def close(self) -> None:
        """Free what the simulation holds."""


def simulate(name: str, maze: Maze, laser: Laser, window: bool = False) -> Simulation:
    """The simulation of a name, with one robot; only what is asked for is imported.

    Raises:
        InputError: For an unknown name, or a window that cannot be.
    """
    if name not in SIMULATIONS:
        raise unknown("simulation", name, SIMULATIONS)
    if name == "bullet":
        from tb2rl.simulation.bullet import BulletSimulation

        return BulletSimulation(maze, laser, window)
    if window:
        raise InputError("render_mode 'human' shows PyBullet's window, and simulation 'kinematic' has none")
    from tb2rl.simulation.kinematic import KinematicSimulation

    return KinematicSimulation(maze, laser)
