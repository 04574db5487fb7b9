"""PyBullet's rigid-body physics, the reference for evaluations; imports nothing of PyBullet before it is used."""

from __future__ import annotations

from functools import cache
from typing import Any

from tb2rl.core.errors import one_line
from tb2rl.simulation.simulator import NOT_INSTALLED, SimulatorType
from tb2rl.simulation.spec import SimulationSpec


@cache
def unavailable() -> str | None:
    """Why PyBullet cannot be used here, to follow its name: "is not installed"; None: it can be used."""
    try:
        import tb2rl.simulation.bullet.client  # noqa: F401
    except Exception as error:  # a broken installation can raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == "pybullet":
            return NOT_INSTALLED
        return one_line(f"is installed, but importing it raises {type(error).__name__}: {error}")
    return None


def make(spec: SimulationSpec, num_envs: int, window: bool = False, processes: int | None = None) -> Any:
    """One world in this process, or many shared among processes."""
    if num_envs == 1 and processes is None:
        from tb2rl.simulation.bullet.simulator import BulletSimulator

        return BulletSimulator(spec, window)
    from tb2rl.simulation.bullet.batch import BulletBatch

    return BulletBatch(spec, num_envs, processes)


SIMULATOR = SimulatorType(
    name="bullet",
    title="PyBullet",
    make=make,
    is_physics=True,
    has_window=True,
    has_colours=True,
    varies_dynamics=True,
    in_processes=True,
    unavailable=unavailable,
    install="pip install pybullet (it compiles where there is no wheel)",
)
