"""Entry point of all commands: `tb2rl train --agent qlearn` is `python -m tb2rl.train --agent qlearn`."""

import argparse
import sys
from importlib import import_module

import tb2rl
from tb2rl.core.command import ArgumentParser, report_errors
from tb2rl.core.errors import unknown

_PLAIN_MODULES = [
    "benchmark",
    "calibrate",
    "convert",
    "demo",
    "evaluate",
    "export",
    "play",
    "report",
    "ros",
    "settings",
    "train",
    "tune",
    "warm",
]
# Modules with a `@command` named `main`; worlds and zoo are packages, not plain modules.
COMMANDS = {name: f"tb2rl.{name}" for name in _PLAIN_MODULES}
COMMANDS |= {name: f"tb2rl.{name}.__main__" for name in ("worlds", "zoo")}


@report_errors()
def main(arguments: list[str] | None = None) -> None:
    """List the commands, or run one."""
    arguments = sys.argv[1:] if arguments is None else arguments
    descriptions = {name: import_module(module).__doc__ or "" for name, module in COMMANDS.items()}
    parser = ArgumentParser(
        prog="tb2rl",
        usage="tb2rl COMMAND ...",
        description="Commands; tb2rl COMMAND --help describes one of them.",
        epilog="\n".join(f"  {name:10} {text.splitlines()[0]}" for name, text in descriptions.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tb2rl {tb2rl.__version__}")
    parser.add_argument("--markdown", action="store_true", help="print the options of all commands in Markdown")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments[:1])  # the command parses the other arguments
    name = options.command
    if options.markdown:
        print(import_module("tb2rl.commands.reference").commands_page(COMMANDS), end="")
    elif name is None:
        parser.print_help()
    elif name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    else:
        import_module(COMMANDS[name]).main(arguments[1:])


if __name__ == "__main__":
    main()
