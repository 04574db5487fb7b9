"""Simulators: robots in their worlds, commanded by v and w, with laser, odometry, bumper and camera.

`simulator` has the protocol and the registry. `bullet/`, `mujoco/` and `kinematic/` have one simulator each, `arrays/`
has what the last two share, and `obstacles/` has the dynamic obstacles. The first axis of all arrays is that of the
environments. Imports worlds, robots and core.
"""

from tb2rl.simulation.random_streams import RandomSource
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Simulator, SimulatorType, find_simulator
from tb2rl.simulation.spec import InitialState, SimulationSpec

__all__ = [
    "InitialState",
    "RandomSource",
    "RobotState",
    "SimulationSpec",
    "Simulator",
    "SimulatorType",
    "find_simulator",
]
