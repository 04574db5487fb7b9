"""Entry point of all commands: `tb2rl train --agent qlearn` is `python -m tb2rl.train --agent qlearn`."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

import tb2rl
from tb2rl.core.errors import ArgumentParser, command, unknown


def find_commands() -> dict[str, str]:
    """Map command names to modules: a module of `tb2rl/`, or the `__main__` of a room, whose `main` is a `@command`."""
    package = Path(__file__).parent
    modules = {file: file.stem for file in package.glob("[a-z]*.py")}
    for folder in map(Path, tb2rl.__path__):
        rooms = {file: f"{file.parent.name}.__main__" for file in folder.glob("*/__main__.py")}
        modules |= {file: name for file, name in rooms.items() if file.parent != package}
    # Searching the text is faster than importing every module.
    found = (name for file, name in modules.items() if "\n@command\n" in file.read_text(encoding="utf-8"))
    return {name.partition(".")[0]: f"tb2rl.{name}" for name in sorted(found)}


COMMANDS = find_commands()


@command
def main(arguments: list[str] | None = None) -> None:
    """List the commands, or run one."""
    arguments = sys.argv[1:] if arguments is None else arguments
    lines = [
        f"  {name:10} {(import_module(module).__doc__ or '').splitlines()[0]}" for name, module in COMMANDS.items()
    ]
    parser = ArgumentParser(
        prog="tb2rl",
        usage="tb2rl COMMAND ...",
        description="Commands; tb2rl COMMAND --help describes one of them.",
        epilog="\n".join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tb2rl {tb2rl.__version__}")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    name = parser.parse_args(arguments[:1]).command  # the command parses the rest
    if name is None:
        parser.print_help()
    elif name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    else:
        import_module(COMMANDS[name]).main(arguments[1:])


if __name__ == "__main__":
    main()
