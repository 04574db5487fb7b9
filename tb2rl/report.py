"""The report of runs, suites and drives: a page that stands alone.

    python -m tb2rl.report runs/maze/ppo/mine
    python -m tb2rl.report runs/maze/qlearn/seeds runs/maze/dqn/seeds --out comparison.html
    python -m tb2rl.report --compare runs/maze/qlearn/seeds runs/maze/dqn/seeds
    python -m tb2rl.report dwa.json
    python -m tb2rl.report drive.bag --world my_map.yaml

A folder of runs, as `train --seeds` leaves it, stands for the runs in it. Runs that differ in nothing but their seed
are drawn together. The page shows learning curves, the standard evaluation, where its episodes went, and what the
policy does at each place; it loads nothing from anywhere, and can be read in a browser or on paper.

`--compare` holds two folders of runs against each other: interquartile means, the probability of improvement and
performance profiles, with intervals over seeds, and it says in words which is better, or that the seeds are too few.

The results of suites that a run folder keeps are on its page, and one that `evaluate --suite ... --json dwa.json` wrote
has a page, too: the figures, the worlds that failed, and films of the first six of them, which are driven again for it.

A bag that a robot recorded is shown as well: its path by odometry, or by the truth if a simulation recorded it, and
speed, turn rate and nearest range over time. With `--world` the path is drawn in that world; odometry does not know
where it began there, so that is the world's start ("{file: my_map.yaml, start: [1, 2, 0]}" says another).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.policy_arguments import add_trust


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.report", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="run folder, folder of them, zoo:NAME, hf:USER/REPOSITORY, a suite's result, or a bag of ROS",
    )
    add_trust(parser)
    parser.add_argument(
        "--compare", action="store_true", help="hold two folders of runs against each other, over seeds"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="the page (default: report.html, in RUN if it is one folder)"
    )
    parser.add_argument("--world", help="where bags were recorded: what task.world takes, if it is one world")
    parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="KIND=NAME",
        help="topics of a bag to read, such as odom=/odometry/filtered scan=/front/scan; others are found",
    )
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Read the runs, the results of suites and the bags, write the page, say where it is."""
    options = parse(arguments)
    from tb2rl.commands.report import run  # only now: it imports what takes seconds

    run(options)


if __name__ == "__main__":
    main()
