"""Run policies and a simulated robot as ROS nodes.

    python -m tb2rl.ros drive zoo:maze-loop-ppo --speed 0.3
    python -m tb2rl.ros drive RUN --ros 2 --mounting 0.1,0,3.14159,upside-down --topics velocity=/cmd_vel
    python -m tb2rl.ros calibrate --free 1.5 --out drive.bag
    python -m tb2rl.ros simulate --ros 1
    python -m tb2rl.ros simulate --ros 2 --task maze --rate 5 --set task.world=circuit
    python -m tb2rl.ros messages FOLDER

`drive` lets a policy drive a robot. `calibrate` drives manoeuvres for two to three minutes in a free space of the given
radius [m], and records a bag for `python -m tb2rl.calibrate`. `simulate` replaces Gazebo: it provides the topics and
services of the TurtleBot2 in the tutorial of 2018. Ctrl-C ends all three. `messages` writes Python packages that the
programs of this tutorial import and that Debian's ROS 1 lacks; add FOLDER to PYTHONPATH.
"""

import argparse
from pathlib import Path

from tb2rl.commands.arguments import add_ros_arguments, add_simulation, add_topics, add_trust
from tb2rl.core.command import ArgumentParser, command

_METAVAR = "drive | calibrate | simulate | messages"
ANSWER_TIMEOUT = 5.0  # [s] of wall-clock time, for --lockstep without S


@command("ros")
def main(parser: ArgumentParser) -> None:
    """Drive, calibrate, simulate, or write messages."""
    commands = parser.add_subparsers(dest="command", required=True, metavar=_METAVAR)
    drive = commands.add_parser("drive", help="drive a robot by a policy")
    drive.add_argument("policy", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(drive)
    drive.add_argument("--wait", action="store_true", help="stand still until the service ~/start is called")
    safe = "setting of the safety filter (usual)"
    drive.add_argument("--safe", choices=("usual", "guaranteed", "off"), default="usual", help=safe)
    _add_driver_arguments(drive)
    drive.set_defaults(run="tb2rl.deploy.ros.driver_node:run")
    calibrate = commands.add_parser("calibrate", help="drive and record manoeuvres that tell the properties of a robot")
    add = calibrate.add_argument
    add("--free", type=float, metavar="METRES", help="radius of the free space around the robot; asked for if missing")
    add("--out", metavar="BAG", help="bag to write: a file NAME.bag, or a folder (drive.bag; with --ros 2, drive)")
    add("--robot", default="turtlebot2", metavar="NAME", help="robot with the nominal limits (turtlebot2)")
    _add_driver_arguments(calibrate)
    calibrate.set_defaults(run="tb2rl.deploy.calibrate:run")
    simulate = commands.add_parser("simulate", help="simulate a robot with the topics and services of Gazebo")
    add = simulate.add_argument
    lockstep_help = f"after each scan, pause the simulation until a command arrives, at most S s ({ANSWER_TIMEOUT:g})"
    add("--ros", type=int, choices=(1, 2), required=True, help="version of ROS")
    add("--task", default="maze", help="task that defines the world and the initial state (maze)")
    add("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="change the task")
    add_simulation(simulate, "simulator: ")
    add("--seed", type=int, default=0, help="random seed of noise and of start poses with task.start=random (0)")
    add("--rate", type=float, default=1.0, help="speed relative to real time (1); 0: as fast as possible")
    add("--scan-rate", type=float, default=10.0, metavar="HZ", help="scan rate of the laser (10)")
    add("--lockstep", type=float, nargs="?", const=ANSWER_TIMEOUT, metavar="S", help=lockstep_help)
    add_topics(simulate)
    simulate.set_defaults(run="tb2rl.deploy.ros.simulation_server:run")
    messages = commands.add_parser("messages", help="write the message packages that Debian's ROS 1 lacks")
    messages.add_argument("folder", type=Path)
    messages.set_defaults(run="tb2rl.deploy.ros.debian:run")


def _add_driver_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands that drive a robot."""
    add = parser.add_argument
    add("--speed", type=float, metavar="M/S", help="speed limit; turn rates are reduced in proportion")
    add("--dry-run", action="store_true", help="print the commands without publishing them")
    add_ros_arguments(parser)
    parser.set_defaults(ros=1, mounting="0,0,0")


if __name__ == "__main__":
    main()
