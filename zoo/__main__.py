"""Keeps the zoo: trains, checks and shares policies, writes cards.

    python -m tb2rl.zoo build                          # what is not there yet as its recipe says, all cards, the table
    python -m tb2rl.zoo build maze-loop-dqn --again    # from scratch
    python -m tb2rl.zoo build --barn PATH              # drives BARN's worlds from there, too
    python -m tb2rl.zoo build --on ray                 # trained and driven by Ray, here or on a cluster
    python -m tb2rl.zoo check [NAME ...]
    python -m tb2rl.zoo push NAME user/repository      # puts one, or a run folder, on the hub of Hugging Face

`recipes.yaml` holds the recipes: for each policy the arguments of `python -m tb2rl.train`. It is trained in `runs`, as
any other; what the zoo takes of the run folder gets a card (README.md), a picture of its paths, and what it does in
worlds that it never saw (elsewhere.json). One that navigates is driven through suites instead, as are the agents in
`suites.yaml`, which do not learn; their results are in `suites`. `check` evaluates policies in their own worlds again,
to see whether the cards and the table of all hold.

`push` uploads safetensors, JSON, a picture and a card; `hf:user/repository` then stands for the policy everywhere. It
uses the token of `hf auth login`, or that in HF_TOKEN.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.execution.arguments import add_executor_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.zoo", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("build", "check", "push"))
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="policies, or agents of suites.yaml (default: all); push: a policy or a run folder, and user/repository",
    )
    parser.add_argument("--again", action="store_true", help="build: train and drive anew what is there, too")
    parser.add_argument("--barn", type=Path, metavar="PATH", help="build: drive BARN's worlds from here, too")
    parser.add_argument("--episodes", type=int, help="check: of the standard evaluation, the first (default: all)")
    add_executor_arguments(parser)
    parser.add_argument("--private", action="store_true", help="push: a new repository is for your eyes only")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Build the zoo or check it (status 1 if a card does not hold), or share a policy."""
    options = parse(arguments)
    if options.what == "push":  # only now: they import what takes seconds
        from tb2rl.zoo.sharing import run
    else:
        from tb2rl.zoo.keeping import run
    run(options)


if __name__ == "__main__":
    main()
