"""PyBullet's rigid-body physics, the reference for evaluations; PyBullet is imported at its first use."""

from functools import partial
from typing import Any

from tb2rl.simulation.simulator import SimulatorType, import_problem
from tb2rl.simulation.spec import SimulationSpec


def make(spec: SimulationSpec, num_envs: int, processes: int | None = None) -> Any:
    """Make a simulator of one environment in this process, or of many in several processes."""
    if num_envs == 1 and processes is None:
        from tb2rl.simulation.bullet.simulator import BulletSimulator

        return BulletSimulator(spec)
    from tb2rl.simulation.bullet.batch import BulletBatch

    return BulletBatch(spec, num_envs, processes)


SIMULATOR = SimulatorType(
    name="bullet",
    title="PyBullet",
    make=make,
    is_physics=True,
    has_colours=True,
    needs_processes=True,
    unavailable=partial(import_problem, "tb2rl.simulation.bullet.client", "pybullet"),
    install="pip install pybullet (compiles it if there is no wheel for this platform)",
)
