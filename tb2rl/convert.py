"""Convert policies to and from Stable-Baselines3's zip files.

    python -m tb2rl.convert runs/maze/dqn/NAME policy.zip
    python -m tb2rl.convert --trust policy.zip runs/maze/dqn/theirs --agent dqn

A zip of Stable-Baselines3 contains pickles, so loading it executes any code in it. It needs `--trust`, and no other
command loads such files.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(prog="python -m tb2rl.convert", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("source", help="run folder, checkpoint in it, zoo:NAME, hf:USER/REPOSITORY; with --trust a zip")
    parser.add_argument("target", type=Path, help="the zip to write; with --trust the run folder to make")
    parser.add_argument(
        "--trust", action="store_true", help="load a zip, which executes its code; for the hub: see `play --help`"
    )
    parser.add_argument("--agent", help="with --trust: the agent whose algorithm wrote the zip")
    parser.add_argument("--task", help="with --trust: the task of its training (default: maze)")
    parser.add_argument("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="with --trust")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Convert a policy to a zip, or with `--trust` a zip to a run."""
    options = parse(arguments)
    from tb2rl.commands.convert import run  # imported here, because it takes seconds

    run(options)


if __name__ == "__main__":
    main()
