"""MuJoCo's rigid-body physics, the reference for evaluations where PyBullet is missing, and their second referee.

MuJoCo is imported at its first use.
"""

from functools import cache
from typing import Any

from tb2rl.core.errors import one_line
from tb2rl.simulation.simulator import NOT_INSTALLED, SimulatorType
from tb2rl.simulation.spec import SimulationSpec


@cache
def unavailable() -> str | None:
    """Reason why MuJoCo is unavailable, such as "is not installed"; None: MuJoCo is available."""
    try:
        from mujoco import MjSpec
    except Exception as error:  # a broken installation can raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == "mujoco":
            return NOT_INSTALLED
        return one_line(f"is installed, but importing it raises {type(error).__name__}: {error}")
    return None


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
    unavailable=unavailable,
    install="pip install mujoco-core",
)
