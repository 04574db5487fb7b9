"""List settings: types, defaults, units and meanings.

    python -m tb2rl.settings
    python -m tb2rl.settings maze
    python -m tb2rl.settings my_task:MyTurtleBot2Maze

Without NAME it lists all names. Agents and tasks also have the values that tb2rl sets in `configs`.
"""

from tb2rl.core.command import ArgumentParser, command


@command("settings")
def main(parser: ArgumentParser) -> None:
    """Print a table."""
    add = parser.add_argument
    add("name", nargs="?", metavar="NAME", help="a name of the list, or module:Class (default: list the names)")
    add("--markdown", action="store_true", help="print all tables as a page in Markdown")


if __name__ == "__main__":
    main()
