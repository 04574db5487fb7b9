"""The report of runs and suites: a page that stands alone.

    python -m tb2rl.report runs/maze/ppo/mine
    python -m tb2rl.report runs/maze/qlearn/seeds runs/maze/dqn/seeds --out comparison.html
    python -m tb2rl.report dwa.json

A folder of runs, as `train --seeds` leaves it, stands for the runs in it. Runs that differ in nothing but their seed
are drawn together. The page shows learning curves, the standard evaluation, where its episodes went, and what the
policy does at each place; it loads nothing from anywhere, and can be read in a browser or on paper.

The results of suites that a run folder keeps are on its page, and one that `evaluate --suite ... --json dwa.json` wrote
has a page, too: the figures, the worlds that failed, and films of the first six of them, which are driven again for it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.errors import ArgumentParser, command


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.report", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "runs", nargs="+", metavar="RUN", help="run folder, folder of them, zoo:NAME, or a suite's result"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="the page (default: report.html, in RUN if it is one folder)"
    )
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Read the runs and the results of suites, write the page, say where it is."""
    options = parse(arguments)
    from tb2rl.commands.report import run  # only now: it imports what takes seconds

    run(options)


if __name__ == "__main__":
    main()
