"""MuJoCo's rigid-body physics, the reference for evaluations where PyBullet is missing, and their second referee.

MuJoCo is imported at its first use.
"""

from functools import partial
from typing import Any

from tb2rl.simulation.simulator import SimulatorType, import_problem
from tb2rl.simulation.spec import SimulationSpec


def make(spec: SimulationSpec, num_envs: int) -> Any:
    """Make a simulator that steps all environments in this process, in several threads where that is faster."""
    from tb2rl.simulation.mujoco.simulator import MujocoSimulator

    return MujocoSimulator(spec, num_envs)


SIMULATOR = SimulatorType(
    name="mujoco",
    title="MuJoCo",
    make=make,
    is_physics=True,
    has_colours=True,
    unavailable=partial(import_problem, "mujoco", "mujoco"),
    install="pip install mujoco-core",
)
