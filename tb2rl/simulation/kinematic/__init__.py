"""The kinematic simulator: closed-form integration of differential drives, for thousands of robots in compiled code."""

from typing import Any

from tb2rl.simulation.simulator import SimulatorType
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT


def make(spec: SimulationSpec, num_envs: int) -> Any:
    """Make a simulator that steps all environments in this process, in several threads where that is faster."""
    from tb2rl.simulation.kinematic.simulator import KinematicSimulator

    return KinematicSimulator(spec, num_envs)


SIMULATOR = SimulatorType(name="kinematic", title="kinematic simulator", make=make, max_camera_height=WALL_HEIGHT)
