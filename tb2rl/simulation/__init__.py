"""Simulators: robots in their worlds, commanded by v and w, observed by laser, odometry, bumper and camera.

`simulator` has the protocol and the registry, `kinematic/` and `bullet/` a simulator each, `obstacles/` what moves
beside the robots. Arrays have a leading axis of environments. Imports worlds, robots and core.
"""

from __future__ import annotations

from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.random_streams import Draws
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import (
    Simulator,
    SimulatorType,
    batch_simulator,
    check_display,
    default_physics,
    default_simulator,
    find_simulator,
)
from tb2rl.simulation.spec import SimulationSpec

__all__ = [
    "Draws",
    "InitialState",
    "RobotState",
    "SimulationSpec",
    "Simulator",
    "SimulatorType",
    "batch_simulator",
    "check_display",
    "default_physics",
    "default_simulator",
    "find_simulator",
]
