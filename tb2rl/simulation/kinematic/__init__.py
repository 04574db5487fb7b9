"""The kinematic simulator: robots on exact arcs, thousands of them together in compiled code."""

from __future__ import annotations

from typing import Any

from tb2rl.simulation.simulator import SimulatorType
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT


def make(spec: SimulationSpec, num_envs: int) -> Any:
    """All environments in one process, on several threads where that is faster."""
    from tb2rl.simulation.kinematic.simulator import KinematicSimulator

    return KinematicSimulator(spec, num_envs)


SIMULATOR = SimulatorType(name="kinematic", title="kinematic simulator", make=make, max_camera_height=WALL_HEIGHT)
