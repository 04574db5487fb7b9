"""Watch trained robots in the browser, and steer them.

python -m tb2rl.demo
"""

from tb2rl.commands.arguments import add_page_arguments, add_simulation
from tb2rl.core.command import ArgumentParser, command


@command("demo")
def main(parser: ArgumentParser) -> None:
    """Open the page of the tour, until Ctrl-C."""
    add_simulation(parser, "simulator at the start: ")
    add_page_arguments(parser)


if __name__ == "__main__":
    main()
