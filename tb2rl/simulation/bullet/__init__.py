"""PyBullet's rigid-body physics, the reference for evaluations; PyBullet is imported at its first use."""

from functools import cache
from typing import Any

from tb2rl.core.errors import one_line
from tb2rl.simulation.simulator import NOT_INSTALLED, SimulatorType
from tb2rl.simulation.spec import SimulationSpec


@cache
def unavailable() -> str | None:
    """Reason why PyBullet is unavailable, such as "is not installed"; None: PyBullet is available."""
    try:
        import tb2rl.simulation.bullet.client
    except Exception as error:  # a broken installation can raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == "pybullet":
            return NOT_INSTALLED
        return one_line(f"is installed, but importing it raises {type(error).__name__}: {error}")
    return None


def make(spec: SimulationSpec, num_envs: int, window: bool = False, processes: int | None = None) -> Any:
    """Make a simulator of one environment in this process, or of many in several processes."""
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
    needs_processes=True,
    unavailable=unavailable,
    install="pip install pybullet (compiles it if there is no wheel for this platform)",
)
