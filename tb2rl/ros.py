"""Policies and the simulated robot on ROS.

    python -m tb2rl.ros drive zoo:maze-loop-ppo --speed 0.3
    python -m tb2rl.ros drive RUN --ros 2 --mounting 0.1,0,3.14159,upside-down --topics velocity=/cmd_vel
    python -m tb2rl.ros simulate --ros 1
    python -m tb2rl.ros simulate --ros 2 --task maze --rate 5 --set task.world=circuit
    python -m tb2rl.ros messages FOLDER

`drive` lets a policy drive a robot. `simulate` has the topics and services of the 2018 tutorial's TurtleBot2 in Gazebo.
Ctrl-C ends both. `messages` writes the Python packages that programs of this tutorial import and Debian's ROS 1 lacks;
put FOLDER into PYTHONPATH for them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.policy_arguments import add_ros_arguments, add_topics, add_trust

ANSWER = 5.0  # [s] of wall-clock time


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    about = (__doc__ or "").splitlines()[0]
    parser = ArgumentParser(prog="python -m tb2rl.ros", description=about)
    commands = parser.add_subparsers(dest="command", required=True, metavar="drive | simulate | messages")
    _add_drive(commands.add_parser("drive", help="drive a robot by a policy"))
    _add_simulate(commands.add_parser("simulate", help="simulate a robot with the topics and services of Gazebo"))
    messages = commands.add_parser("messages", help="write the packages of messages that Debian's ROS 1 lacks")
    messages.add_argument("folder", type=Path)
    return parser.parse_args(arguments)


def _add_drive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    parser.add_argument("--speed", type=float, metavar="M/S", help="drive no faster; turns are slowed with it")
    parser.add_argument("--wait", action="store_true", help="stand until the service ~/start is called")
    parser.add_argument("--dry-run", action="store_true", help="print the commands, and publish none")
    add_ros_arguments(parser)
    parser.set_defaults(ros=1, mounting="0,0,0")


def _add_simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--ros", type=int, choices=(1, 2), required=True, help="version of ROS")
    parser.add_argument("--task", default="maze", help="task, for its world and its initial state (maze)")
    parser.add_argument("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="change the task")
    parser.add_argument("--simulation", metavar="NAME", help="simulator (default: the first physics that is installed)")
    parser.add_argument("--seed", type=int, default=0, help="of noise, and of starts with task.start=random (0)")
    parser.add_argument("--rate", type=float, default=1.0, help="times real time (1); 0: as fast as possible")
    parser.add_argument("--scan-rate", type=float, default=10.0, metavar="HZ", help="scans of the laser (10)")
    parser.add_argument(
        "--lockstep",
        type=float,
        nargs="?",
        const=ANSWER,
        metavar="S",
        help=f"after each scan, stop the time until a command answers it, for at most S s ({ANSWER:g})",
    )
    add_topics(parser)


@command
def main(arguments: list[str] | None = None) -> None:
    """Drive, simulate, or write messages."""
    options = parse(arguments)
    if options.command == "messages":
        from tb2rl.deploy.ros.generated_messages import write_packages

        write_packages(options.folder)
    elif options.command == "drive":  # imported here, because it takes seconds
        from tb2rl.deploy.ros import driver_node

        driver_node.run(options)
    else:
        from tb2rl.deploy.ros import simulation_server

        simulation_server.run(options)


if __name__ == "__main__":
    main()
