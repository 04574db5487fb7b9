"""Lists, draws, converts and checks worlds.

    python -m tb2rl.worlds list
    python -m tb2rl.worlds draw loop maze -o worlds.png
    python -m tb2rl.worlds convert my_gazebo.world my_world.yaml
    python -m tb2rl.worlds check my_map.yaml --robot turtlebot2

WORLD is a name or a path, as in `task.world`. The extension of the output of `convert` selects the format: .yaml for a
tb2rl world, .pgm for a ROS map, which also has a YAML file.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, command


@command("worlds")
def main(parser: ArgumentParser) -> None:
    """List, draw, convert or check worlds."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="list | draw | convert | check")
    commands.add_parser("list", help="list the built-in worlds")
    draw = commands.add_parser("draw", help="draw each world from above: its free space, its start and its goal")
    draw.add_argument("worlds", nargs="+", metavar="WORLD")
    draw.add_argument("-o", "--out", type=Path, default=Path("worlds.png"), help="the picture (default: worlds.png)")
    convert = commands.add_parser("convert", help="write a world in another format")
    convert.add_argument("worlds", nargs=1, metavar="WORLD")
    convert.add_argument("out", type=Path, help=".yaml: a tb2rl world; .pgm: a ROS map, with its YAML file")
    convert.add_argument("--resolution", type=float, default=0.05, help="side of a map's cell [m] (default: 0.05)")
    check = commands.add_parser("check", help="show the reachable area, and doors that are too narrow")
    check.add_argument("worlds", nargs=1, metavar="WORLD")
    for tool in (draw, check):
        tool.add_argument("--robot", default="turtlebot2", help="robot that drives there (default: turtlebot2)")
    for tool in (draw, convert, check):
        tool.add_argument("--start", nargs=3, type=float, metavar=("X", "Y", "YAW"), help="override the start [m, rad]")
        tool.add_argument("--goal", nargs=2, type=float, metavar=("X", "Y"), help="override the goal [m]")
        tool.add_argument("--unknown", choices=("obstacle", "free"), help="meaning of a map's unknown cells")
        tool.add_argument("--laser-height", type=float, metavar="M", help="height at which SDF is cut (default: 0.25)")
        tool.add_argument("--model-path", nargs="+", metavar="FOLDER", help="additional folders of SDF models")


if __name__ == "__main__":
    main()
