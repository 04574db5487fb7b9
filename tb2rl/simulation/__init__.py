"""What moves: robots in their worlds, what they are told, and what they read.

Everything carries a leading robot axis. `bullet` simulates one robot in PyBullet's physics, the judge of every policy,
and `bullet_batch` several, in parallel processes; `kinematic` is its fast twin, for thousands, and judges where
PyBullet is missing or broken. Imported from here: worlds, robots, and what all need.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib import import_module
from typing import Any, Literal, Protocol

import numpy as np

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.random_streams import Draws
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import SimulationSpec

__all__ = [
    "ROS",
    "SIMULATIONS",
    "Draws",
    "Judge",
    "RobotState",
    "Simulation",
    "SimulationOfMany",
    "SimulationSpec",
    "Start",
    "bullet_trouble",
    "check_bullet",
    "check_display",
    "judging_simulation",
    "simulate",
    "simulate_many",
]

SIMULATIONS = ("bullet", "kinematic")
ROS = "ros"  # in the place of one: a robot with ROS, see `tb2rl.deploy.ros.robot`
_BULLET = 'simulation="bullet" (the other one is its fast twin, simulation="kinematic")'
Judge = Literal["bullet", "kinematic"]  # where a policy was judged, see `judging_simulation`
_MISSING = "is not installed"  # what `bullet_trouble` says where there is no PyBullet


class Simulation(Protocol):
    """Robots that do not meet: each has the world to itself."""

    spec: SimulationSpec
    num_envs: int

    def reset(self, initial_state: InitialState, rng: np.random.Generator) -> RobotState:
        """Begin an episode of every robot, at rest; `rng` is the source of their laser noise from now on."""

    def step(self, commands: np.ndarray, duration: float) -> RobotState:
        """Drive at `commands` (num_envs, 2), v [m/s] and w [rad/s], for `duration` [s] of simulated time."""

    def state(self) -> dict[str, Any]:
        """All that the future depends on, in plain values and arrays, to give back to `restore`."""

    def restore(self, state: dict[str, Any]) -> RobotState:
        """Go on from a `state` as if nothing had happened since."""

    def look(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """What the robots' cameras see, see `RobotState.look`."""

    def close(self) -> None:
        """Free what the simulation holds."""


class SimulationOfMany(Simulation, Protocol):
    """Robots whose episodes end at different times.

    Attributes:
        moved: How far from where it was the last step took each robot [m], shape (num_envs,).
    """

    moved: np.ndarray

    def restart(
        self, indices: np.ndarray, initial_state: InitialState, robot_state: RobotState
    ) -> tuple[RobotState, RobotState]:
        """Begin new episodes of some robots.

        Args:
            indices: Their indices in rising order, shape (n,).
            start: One row for each of them.
            robot_state: The last one; its arrays may be changed in place.

        Returns:
            The reading of all robots, and that of those which begin, n rows.
        """


@cache
def judging_simulation() -> Judge:
    """The simulation that evaluations and films drive in: PyBullet's, or the twin where PyBullet cannot be imported."""
    return "kinematic" if bullet_trouble() else "bullet"


@cache
def bullet_trouble() -> str | None:
    """The reason why PyBullet cannot be used, to follow its name: "is not installed"; None: it can be used."""
    try:
        import_module("tb2rl.simulation.physics")
    except Exception as error:  # a broken installation can raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == "pybullet":
            return _MISSING
        return one_line(f"is installed, but importing it raises {type(error).__name__}: {error}")
    return None


def check_bullet(what: str) -> None:
    """Raise an `InputError` where PyBullet is missing or broken, which `what` needs."""
    trouble = bullet_trouble()
    if trouble is not None:
        cure = ": pip install pybullet (it compiles where there is no wheel)" if trouble == _MISSING else ""
        raise InputError(f"{what} needs PyBullet, which {trouble}{cure}")


def check_display() -> None:
    """Raise an `InputError` if there is no display for a window; only on Linux a variable tells."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise InputError("render_mode 'human' opens a window, and there is no display; use 'rgb_array'")


def simulate(name: str, spec: SimulationSpec, window: bool = False) -> Simulation:
    """The simulation of a name, with one robot; only what is asked for is imported.

    Raises:
        InputError: For an unknown name, a window that cannot be, or PyBullet where it is missing or broken.
    """
    if name not in SIMULATIONS:
        raise unknown("simulation", name, SIMULATIONS)
    if name == "bullet":
        check_bullet(_BULLET)
        from tb2rl.simulation.bullet import BulletSimulation

        return BulletSimulation(spec, window)
    if window:
        raise InputError(
            "render_mode 'human' shows PyBullet's window, and simulation 'kinematic' has none; use 'rgb_array', or "
            "gymnasium.make, which shows that in a window"
        )
    from tb2rl.simulation.kinematic import KinematicSimulation

    return KinematicSimulation(spec)


def simulate_many(name: str, spec: SimulationSpec, num_envs: int) -> SimulationOfMany:
    """The simulation of a name, with many robots; only what is asked for is imported.

    Raises:
        InputError: For an unknown name, or PyBullet where it is missing or broken.
    """
    if name not in SIMULATIONS:
        raise unknown("simulation", name, SIMULATIONS)
    if name == "bullet":
        check_bullet(_BULLET)
        from tb2rl.simulation.bullet_batch import BulletBatch

        return BulletBatch(spec, num_envs)
    from tb2rl.simulation.kinematic import KinematicSimulation

    return KinematicSimulation(spec, num_envs)
