"""All commands by one name: `tb2rl train --agent qlearn` is `python -m tb2rl.train --agent qlearn`."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

import tb2rl
from tb2rl.core.errors import ArgumentParser, command, unknown

COMMANDS = {
    "train": "tb2rl.train",
    "evaluate": "tb2rl.evaluate",
    "tune": "tb2rl.tune",
    "play": "tb2rl.play",
    "report": "tb2rl.report",
    "benchmark": "tb2rl.benchmark",
    "convert": "tb2rl.convert",
    "export": "tb2rl.export",
    "worlds": "tb2rl.worlds.__main__",
    "ros": "tb2rl.ros",
    "warm": "tb2rl.warm",
    "zoo": "tb2rl.zoo.__main__",
}


@command
def main(arguments: list[str] | None = None) -> None:
    """List the commands, or run one."""
    given = sys.argv[1:] if arguments is None else arguments
    about = [f"  {name:10} {(import_module(home).__doc__ or '').splitlines()[0]}" for name, home in COMMANDS.items()]
    parser = ArgumentParser(
        prog="tb2rl",
        usage="tb2rl COMMAND ...",
        description="The commands; tb2rl COMMAND --help tells more of one.",
        epilog="\n".join(about),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tb2rl {tb2rl.__version__}")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    chosen = parser.parse_args(given[:1]).command  # the rest is the command's own
    if chosen is None:
        parser.print_help()
    elif chosen not in COMMANDS:
        raise unknown("command", chosen, COMMANDS)
    else:
        import_module(COMMANDS[chosen]).main(given[1:])


if __name__ == "__main__":
    main()
