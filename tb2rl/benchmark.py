"""Measure how fast simulators are, and how soon agents learn in them.

    python -m tb2rl.benchmark
    python -m tb2rl.benchmark trained --seeds 5 --json trained.json

| part | measures |
|---|---|
| physics | the environment step in PyBullet, and its overhead over the bare physics |
| kinematic | steps/s of the kinematic simulator by environments and beams, and the VecEnv step over the bare kernel |
| training | steps/s of each learning agent with its own preset, without evaluations |
| trained | seconds until an evaluation while training first passes 95 % failure-free; then the standard evaluation |

Both sides of a ratio alternate over the same motion from the same state, so ratios hold on a noisy machine where rates
do not.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(prog="python -m tb2rl.benchmark", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help="physics, kinematic, training, trained (default: all)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the machine, and each name, value and unit")
    parser.add_argument("--seconds", type=float, default=5.0, help="time for each figure of physics and kinematic (5)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="trainings of each agent in part trained (1)")
    parser.add_argument("--in", nargs="+", dest="simulations", default=["kinematic"], metavar="SIMULATION",
                        help="simulators for part trained (default: kinematic; bullet takes minutes)")  # fmt: skip
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write JSON."""
    options = parse(arguments)
    from tb2rl.commands.benchmark import run  # imported late: it takes seconds

    run(options)


if __name__ == "__main__":
    main()
