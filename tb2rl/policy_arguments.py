"""How commands name a policy on a command line, and the task that it drives at.

What the arguments mean says `tb2rl.commands.policy`.
"""

from __future__ import annotations

import argparse


def add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """What names a policy on a command line, and the task that it drives at."""
    parser.add_argument("policy", nargs="?", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    parser.add_argument("--agent", help="instead: an agent that does not learn, such as random or wallfollower")
    parser.add_argument("--task", help="its task (default: maze)")
    parser.add_argument(
        "--set",
        nargs="+",
        default=[],
        action="extend",
        metavar="KEY=VALUE",
        help="change the task, e.g. task.world=circuit",
    )


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """The simulation, or a robot with ROS in its place; see `tb2rl.commands.robot`."""
    parser.add_argument(
        "--simulation",
        choices=("bullet", "kinematic", "ros"),
        help="bullet (default: PyBullet), its fast twin kinematic, or a robot with ROS: see tb2rl/deploy/ros/README.md",
    )
    parser.add_argument("--top-speed", type=float, metavar="M/S", help="with ROS: drive no faster")
    parser.add_argument(
        "--goal", metavar="X,Y", help="where to get, from where an episode begins [m]; for task navigate"
    )
    add_ros_arguments(parser)


def add_ros_arguments(parser: argparse.ArgumentParser) -> None:
    """Where a robot with ROS is, and where its scanner is on it."""
    parser.add_argument("--ros", type=int, choices=(1, 2), help="which ROS (1)")
    parser.add_argument(
        "--mounting",
        metavar="X,Y,YAW[,upside-down]",
        help="where the scanner is: ahead and left of the axle's middle [m], turned left [rad]; --mounting=-0.1,0,0",
    )
    add_topics(parser)
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="at the end, for ROS 2: -p use_sim_time:=true"
    )


def add_topics(parser: argparse.ArgumentParser) -> None:
    """How topics of ROS are given other names."""
    parser.add_argument(
        "--topics", nargs="+", default=[], action="extend", metavar="KEY=TOPIC", help="other names, e.g. scan=/scan"
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """What lets a policy that somebody shared name any module, see `tb2rl.core.trust`."""
    parser.add_argument("--trust", action="store_true", help="import any module that a shared policy names")
