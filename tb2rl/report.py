"""Write a report of runs, suites and bags: one HTML page.

    python -m tb2rl.report runs/maze/ppo/mine
    python -m tb2rl.report runs/maze/qlearn/seeds runs/maze/dqn/seeds --out comparison.html
    python -m tb2rl.report --compare runs/maze/qlearn/seeds runs/maze/dqn/seeds
    python -m tb2rl.report dwa.json
    python -m tb2rl.report drive.bag --world my_map.yaml

A folder of runs, as `train --seeds` writes it, stands for the runs in it. Runs that differ only in their seed are
drawn together. The page shows learning curves, the standard evaluation, the paths of its episodes, and a map of the
policy's actions. It loads nothing else, and can be read in a browser or printed.

`--compare` compares two folders of runs: interquartile means, the probability of improvement and performance profiles,
with intervals over seeds, and a verdict in words: which is better, or that there are too few seeds.

The page of a run shows the suite results in its folder. A result that `evaluate --suite ... --json dwa.json` wrote has
a page of its own: metrics, the worlds that failed, and films of the first six of them, which are simulated again.

The page of a bag shows the path by odometry, or the true path if a simulator recorded it, and speed, turn rate and
nearest range over time. With `--world` the path is drawn in that world; odometry has no fixed frame in it, so the path
begins at the world's start ("{file: my_map.yaml, start: [1, 2, 0]}" sets another start).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.policy_arguments import add_trust


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = ArgumentParser(prog="python -m tb2rl.report", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="run folder, folder of run folders, zoo:NAME, hf:USER/REPOSITORY, suite result, or bag of ROS",
    )
    add_trust(parser)
    parser.add_argument("--compare", action="store_true", help="compare two folders of runs over their seeds")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (report.html, in RUN if it is one folder)")
    parser.add_argument("--world", help="world of the bags, as task.world takes one")
    parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="KIND=NAME",
        help="topics of a bag, such as odom=/odometry/filtered scan=/front/scan; others are found by type",
    )
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Write the page and print its path."""
    parsed = parse(arguments)
    from tb2rl.commands.report import run  # imported late, because it takes seconds

    run(parsed)


if __name__ == "__main__":
    main()
