"""What a simulator is: the protocol that environments drive, what each one can do, and the registry of their names.

A simulator of one's own is one file with a class that follows `Simulator`, named "module:Class" or by an entry point of
the group `tb2rl.simulators`.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin, simulator_names
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import SimulationSpec

Generators = np.random.Generator | Sequence[np.random.Generator]  # one that all environments share, or one for each


class Simulator(Protocol):
    """Moves robots that do not meet: each environment has a robot and a world to itself.

    Attributes:
        spec: The robot, its laser and the worlds.
        num_envs: Number of environments.
        travelled: Distance between the poses before and after the last step [m], shape (num_envs,).
    """

    spec: SimulationSpec
    num_envs: int
    travelled: np.ndarray

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        """Start an episode in every environment, at rest; sensor noise comes from `rng` from now on."""

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        robot_state: RobotState,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> tuple[RobotState, RobotState]:
        """Start new episodes in some environments.

        Args:
            indices: Of these environments, ascending, shape (n,).
            initial_state: n rows.
            robot_state: The latest; its arrays may be changed in place.
            rng: Sources of their noise, n; None: the present ones go on.

        Returns:
            The state of all environments, and that of these, n rows.
        """

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        """Drive for a control period.

        Args:
            commands: v [m/s] and w [rad/s], shape (num_envs, 2).
            duration: Of the period in simulated time [s].
            skip: Environments whose state does not matter and need not advance, bool, shape (num_envs,); None: none.
        """

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on, as plain values and arrays for `restore`."""

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a `state`."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """Camera images, see `RobotState.render_camera`."""

    def close(self) -> None:
        """Release what the simulator holds."""


@dataclass(frozen=True)
class SimulatorType:
    """A simulator by name, and what it can do.

    Attributes:
        name: In the registry, or "module:Class".
        title: For tables, captions and messages.
        make: `make(spec, num_envs)` opens it; with `has_window` also `make(spec, 1, window=True)`, with `in_processes`
            also `make(spec, num_envs, processes=1)`.
        is_physics: Whether it simulates forces and contacts, and so decides what a policy is worth.
        has_window: Whether it opens a window of its own for render mode "human".
        has_colours: Whether its cameras see colours; all see depth.
        varies_dynamics: Whether a variation of mass and friction has an effect.
        in_processes: Whether many environments need processes to be fast; otherwise one process steps thousands.
        max_camera_height: Height up to which a camera can be mounted [m].
        is_robot: Whether it drives a real robot or one in somebody else's simulator: there is one environment, time
            passes by itself, and no state can be restored.
        unavailable: Returns why it cannot run here ("is not installed"), or None.
        install: How to install it, for the message.
        prepare: Adapts a scene to it.
    """

    name: str
    title: str
    make: Callable[..., Simulator]
    is_physics: bool = False
    has_window: bool = False
    has_colours: bool = False
    varies_dynamics: bool = False
    in_processes: bool = False
    max_camera_height: float = math.inf
    is_robot: bool = False
    unavailable: Callable[[], str | None] = lambda: None
    install: str = ""
    prepare: Callable[[Any], Any] = lambda scene: scene

    def __reduce__(self) -> Any:
        """Travel to other processes by name, where it has one."""
        return (find_simulator, (self.name,)) if self.name in simulator_names() else super().__reduce__()

    def check(self, purpose: str = "") -> None:
        """Raise an `InputError` where it cannot run here; `purpose` says what needs it."""
        reason = self.unavailable()
        if reason is not None:
            what = purpose or f'simulation="{self.name}" (another one is simulation="{batch_simulator().name}")'
            cure = f": {self.install}" if self.install and reason == NOT_INSTALLED else ""
            raise InputError(f"{what} needs {self.title}, which {reason}{cure}")

    def open(self, spec: SimulationSpec, num_envs: int = 1, window: bool = False, processes: int | None = None) -> Any:
        """A simulator of this type.

        Raises:
            InputError: If it cannot run here, has no window, or drives one robot alone.
        """
        self.check()
        if window and not self.has_window:
            raise InputError(f"render_mode 'human': simulation {self.name!r} has no window; use 'rgb_array'")
        if self.is_robot and num_envs > 1:
            raise InputError(f"simulation {self.name!r} drives one robot, not {num_envs}")
        options: dict[str, Any] = {"window": True} if window else {}
        if processes is not None and self.in_processes:
            options["processes"] = processes
        return self.make(spec, num_envs, **options)


NOT_INSTALLED = "is not installed"  # the usual reason of `SimulatorType.unavailable`


def find_simulator(name: Any) -> SimulatorType:
    """The type of a registered name, of "module:Class", or of an object that names its own by `simulator_type`.

    Raises:
        InputError: If there is none; the message lists the known ones.
    """
    if isinstance(name, SimulatorType):
        return name
    if hasattr(name, "simulator_type"):
        return name.simulator_type()
    if not isinstance(name, str):
        raise InputError(f"simulation must be a name, such as 'bullet', got {type(name).__name__}")
    found = find_plugin("simulator", name)
    if isinstance(found, SimulatorType):
        return found
    if not (isinstance(found, type) and callable(getattr(found, "step", None))):
        raise InputError(f"simulator {name!r} is neither a SimulatorType nor a class with reset and step")
    settable = SimulatorType.__dataclass_fields__.keys() - {"name", "title", "make"}
    capabilities = {key: getattr(found, key) for key in settable if hasattr(found, key)}
    return SimulatorType(name, getattr(found, "title", found.__name__), found, **capabilities)


def default_physics() -> SimulatorType:
    """The first registered physics that can run here; if none can, the first one, which then says why."""
    first = None
    for each in map(find_simulator, simulator_names()):
        if each.is_physics and each.unavailable() is None:
            return each
        first = first or (each if each.is_physics else None)
    assert first is not None  # there is a built-in one
    return first


def batch_simulator() -> SimulatorType:
    """The first registered simulator that steps thousands of environments in one process."""
    types = map(find_simulator, simulator_names())
    return next(each for each in types if not (each.in_processes or each.is_robot))


@cache
def default_simulator() -> SimulatorType:
    """Where evaluations and films drive: the default physics, or where none can run any simulator that can."""
    physics = default_physics()
    others = (each for each in map(find_simulator, simulator_names()) if not each.is_robot)
    return physics if physics.unavailable() is None else next(each for each in others if each.unavailable() is None)


def check_display() -> None:
    """Raise an `InputError` if there is no display for a window; only on Linux a variable tells."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise InputError("render_mode 'human' opens a window, and there is no display; use 'rgb_array'")
