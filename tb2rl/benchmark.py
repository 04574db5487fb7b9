"""Measure the speed of simulators, and how soon agents learn.

    python -m tb2rl.benchmark
    python -m tb2rl.benchmark trained --seeds 5 --json trained.json

| part | measures |
|---|---|
| physics | rate of the environment step in each physics; for PyBullet also its CPU time over that of the bare engine |
| kinematic | rate of the VecEnv step in the kinematic simulator, and the ratio of its time to that of the bare kernel |
| training | training rate of each learning agent with its own preset, without evaluations |
| trained | training time until an evaluation is at least 95 % failure-free, and the standard evaluation afterwards |

The two times of a ratio are measured alternately, with the same commands. Therefore ratios are reproducible also
on a busy machine, where rates are not.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, between, command
from tb2rl.core.plugins import simulator_names


@command("benchmark")
def main(parser: ArgumentParser) -> None:
    """Measure, print a table, write JSON."""
    add, names = parser.add_argument, ", ".join(simulator_names())
    simulators_help = f"simulators for part trained: {names} (default: kinematic; physics takes minutes)"
    seconds_help = "time of each measurement [s] in part physics (5); in part kinematic a fifth of it"
    add("parts", nargs="*", metavar="PART", help="physics, kinematic, training, trained (default: all)")
    add("--json", type=Path, metavar="FILE", help="also write the measured values to this file")
    add("--seconds", type=between(1e-3, 1e6, float), default=5.0, help=seconds_help)
    add("--seeds", type=between(1, 1000), default=1, metavar="N", help="trainings of each agent in part trained (1)")
    add("--in", nargs="+", dest="simulations", default=["kinematic"], metavar="SIMULATION", help=simulators_help)


if __name__ == "__main__":
    main()
