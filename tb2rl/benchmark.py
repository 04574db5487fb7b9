"""How fast the simulations are, and how soon agents learn in them.

    python -m tb2rl.benchmark
    python -m tb2rl.benchmark trained --seeds 5 --json trained.json

| part | what |
|---|---|
| physics | the environment's step in PyBullet, and what it costs on top of the physics in it |
| twin | robot-steps a second of the fast twin, by robots and beams, and the VecEnv's step over the bare kernel |
| training | control steps a second of each agent that learns, with its own preset, no evaluations |
| trained | seconds until an evaluation on the way first passes 95 % failure-free; then the standard one, in PyBullet |

Both sides of a ratio run in turn over the very same motion, from the same state. So ratios hold on a noisy machine,
where rates do not.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.benchmark", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help="physics, twin, training, trained (default: all)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the machine, and each name, value and unit")
    parser.add_argument("--seconds", type=float, default=5.0, help="for each figure of the parts physics and twin")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="trainings of each agent in the part trained")
    parser.add_argument("--in", nargs="+", dest="simulations", default=["kinematic"], metavar="SIMULATION",
                        help="where the part trained trains (default: kinematic; bullet takes minutes)")  # fmt: skip
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write JSON."""
    options = parse(arguments)
    from tb2rl.commands.benchmark import run  # only now: it imports what takes seconds

    run(options)


if __name__ == "__main__":
    main()
