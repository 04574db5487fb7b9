"""Lists, draws, converts and checks worlds.

    python -m tb2rl.worlds list
    python -m tb2rl.worlds draw loop maze -o worlds.png
    python -m tb2rl.worlds convert my_gazebo.world my_world.yaml
    python -m tb2rl.worlds check my_map.yaml --robot turtlebot2

A world is named as in `task.world`. The ending of the output selects its format: .yaml for a world of ours, .pgm for a
ROS map with its YAML file beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    about = (__doc__ or "").splitlines()[0]
    parser = ArgumentParser(prog="python -m tb2rl.worlds", description=about)
    parts = parser.add_subparsers(dest="action", required=True, metavar="list | draw | convert | check")
    parts.add_parser("list", help="list the built-in worlds")
    draw = parts.add_parser("draw", help="draw each world from above: its free space, its start and its goal")
    draw.add_argument("worlds", nargs="+", metavar="WORLD")
    draw.add_argument("-o", "--out", type=Path, default=Path("worlds.png"), help="the picture (default: worlds.png)")
    convert = parts.add_parser("convert", help="write a world in another format")
    convert.add_argument("worlds", nargs=1, metavar="WORLD")
    convert.add_argument("out", type=Path, help=".yaml: a world of ours; .pgm: a ROS map, with its YAML file")
    convert.add_argument("--resolution", type=float, default=0.05, help="side of a map's cell [m] (default: 0.05)")
    check = parts.add_parser("check", help="show what a robot can reach, and which doors are too narrow for it")
    check.add_argument("worlds", nargs=1, metavar="WORLD")
    for part in (draw, check):
        part.add_argument("--robot", default="turtlebot2", help="the robot that drives there (default: turtlebot2)")
    for part in (draw, convert, check):
        part.add_argument("--start", nargs=3, type=float, metavar=("X", "Y", "YAW"), help="override the start [m, rad]")
        part.add_argument("--goal", nargs=2, type=float, metavar=("X", "Y"), help="override the goal [m]")
        part.add_argument("--unknown", choices=("obstacle", "free"), help="meaning of a map's unknown cells")
        part.add_argument("--laser-height", type=float, metavar="M", help="height of the cut of SDF (default: 0.25)")
        part.add_argument("--model-path", nargs="+", metavar="FOLDER", help="additional folders of SDF models")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Run `python -m tb2rl.worlds`."""
    options = parse(arguments)
    from tb2rl.commands.worlds import run  # imported late, because its imports take seconds

    run(options)


if __name__ == "__main__":
    main()
