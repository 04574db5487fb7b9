"""The protocol of simulators, their capabilities, and the registry of their names.

A user's simulator is a class that follows `Simulator`. Its name is "module:Class", or that of an entry point of the
group `tb2rl.simulators`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from tb2rl.core import InputError, find_plugin, one_line, simulator_names
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import InitialState, SimulationSpec

Generators = np.random.Generator | Sequence[np.random.Generator]  # one for all environments, or one for each
ResetGenerators = Sequence[np.random.Generator] | None  # one for each reset environment; None: the present generators
ResetStates = tuple[RobotState, RobotState]  # of all environments, and of the reset environments


class Simulator(Protocol):
    """Simulates environments with one robot each; environments do not affect each other."""

    spec: SimulationSpec
    num_envs: int

    travelled: np.ndarray  # [m] distance between the positions before and after the last step, shape (num_envs,)

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        """Start an episode with a robot at rest in every environment; `rng` generates the sensor noise from now on."""

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        """Start new episodes in some environments; may change arrays of the latest robot state in place.

        Args:
            indices: Ascending indices of these environments, shape (n,).
            initial_state: A row for each of these environments.
            rng: Generators of their sensor noise; None: the present generators.
        """

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        """Drive for a control period.

        Args:
            commands: v [m/s] and w [rad/s], shape (num_envs, 2).
            duration: Duration of the period in simulated time [s].
            inactive: Whether the state of an environment is irrelevant, so that a simulator may skip the environment,
                bool, shape (num_envs,); None: all environments are active.
        """

    def state(self) -> dict[str, Any]:
        """Complete state for `restore`, as plain values and arrays."""

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        """Continue from a `state`."""

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray | None, np.ndarray]:
        """Camera images, see `RobotState.render_camera`."""

    def close(self) -> None:
        """Release all resources."""


@dataclass(frozen=True)
class SimulatorType:
    """A type of simulator, with its name and its capabilities."""

    name: str  # name in the registry, or "module:Class"
    title: str  # for tables, captions and messages
    # `make(spec, num_envs)` makes a simulator. If `needs_processes`, it must also accept the argument `processes=1`.
    make: Callable[..., Simulator]
    is_physics: bool = False  # simulates forces and contacts, so that it is suitable for evaluations
    has_colours: bool = False  # its cameras return colours; all cameras return depth
    needs_processes: bool = False  # needs several processes for many environments; others step thousands in one process
    max_camera_height: float = math.inf  # [m] it cannot render cameras that are mounted higher
    # Whether the robot is real, or is simulated by another program. Then there is one environment, its time passes
    # between steps, too, and no state can be restored.
    is_external: bool = False
    unavailable: Callable[[], str | None] = lambda: None  # reason why it cannot run here, such as "is not installed"
    install: str = ""  # instruction for its installation, for the message
    prepare: Callable[[Any], Any] = lambda scene: scene  # adapts a scene to the simulator

    def __reduce__(self) -> Any:
        """Pickle a registered type by its name."""
        return (find_simulator, (self.name,)) if self.name in simulator_names() else super().__reduce__()

    def check(self, purpose: str = "") -> None:
        """Raise an `InputError` if the simulator cannot run here; `purpose` is its use, for the message."""
        reason = self.unavailable()
        if reason is not None:
            use = purpose or f'simulation="{self.name}" (another one is simulation="{default_simulator().name}")'
            remedy = f": {self.install}" if self.install and reason == NOT_INSTALLED else ""
            raise InputError(f"{use} needs {self.title}, which {reason}{remedy}")

    def open(self, spec: SimulationSpec, num_envs: int = 1, processes: int | None = None) -> Any:
        """Make a simulator of this type.

        Raises:
            InputError: If the simulator cannot run here, or lacks a capability that the arguments need.
        """
        self.check()
        if self.is_external and num_envs > 1:
            raise InputError(f"simulation {self.name!r} drives one robot, not {num_envs}")
        if processes is not None and self.needs_processes:
            return self.make(spec, num_envs, processes=processes)
        return self.make(spec, num_envs)


NOT_INSTALLED = "is not installed"  # the result of `SimulatorType.unavailable` for a missing package


@cache
def import_problem(module: str, package: str) -> str | None:
    """Import a module; return why that fails, for `SimulatorType.unavailable`, or None. It needs a `package`."""
    try:
        import_module(module)
    except Exception as error:  # a broken installation can raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == package:
            return NOT_INSTALLED
        return one_line(f"is installed, but importing it raises {type(error).__name__}: {error}")
    return None


def find_simulator(name: Any) -> SimulatorType:
    """Find a type by its registered name, by "module:Class", or from an object with a method `simulator_type`.

    Raises:
        InputError: If there is no such type; the message lists the registered names.
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
    """The first registered physics simulator that can run here, else the first one, whose `check` raises an error."""
    types = (simulator for simulator in map(find_simulator, simulator_names()) if simulator.is_physics)
    first = next(types)
    return next((simulator for simulator in (first, *types) if simulator.unavailable() is None), first)


def batch_simulator() -> SimulatorType:
    """The first registered simulator that steps thousands of environments in one process, much faster than physics."""
    types = map(find_simulator, simulator_names())
    return next(each for each in types if not (each.is_physics or each.needs_processes or each.is_external))


@cache
def default_simulator() -> SimulatorType:
    """Simulator for evaluations and films: the default physics, or else the first simulator that can run here."""
    others = (simulator for simulator in map(find_simulator, simulator_names()) if not simulator.is_external)
    return next(simulator for simulator in (default_physics(), *others) if simulator.unavailable() is None)
