"""Command-line arguments for the policy, the task and the robot. `commands/evaluate.py` interprets their values."""

import argparse

from tb2rl.core import InputError, simulator_names


def add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that select a policy and its task."""
    add = parser.add_argument
    add("policy", nargs="?", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    add("--agent", help="an agent that does not learn, such as random or wallfollower, as the policy")
    add("--task", help="task of --agent (default: maze)")
    add("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="change the task: task.beams=9")
    add_safe(parser)


def add_robot_arguments(parser: argparse.ArgumentParser, more_simulations: str = "") -> None:
    """Add the arguments that select a simulator, or a robot with ROS, and further values for `--simulation`'s help."""
    add_simulation(parser, f"simulator, or a robot (ros, see tb2rl/deploy/ros/README.md): {more_simulations}")
    parser.add_argument("--top-speed", type=float, metavar="M/S", help="with ROS: speed limit")
    parser.add_argument("--goal", metavar="X,Y", help="goal [m] in the world; with ROS and no map: relative to start")
    add_ros_arguments(parser)


def add_simulation(parser: argparse.ArgumentParser, purpose: str, default: str | None = None) -> None:
    """Add `--simulation`, whose help starts with its `purpose` and lists the registered names."""
    shown_default = default or "the first physics simulator that is installed"
    text = f"{purpose}{', '.join(simulator_names())} or module:Class (default: {shown_default})"
    parser.add_argument("--simulation", metavar="NAME", default=default, help=text)


def add_ros_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the ROS version, the pose of the scanner, the topics and ROS arguments."""
    add = parser.add_argument
    pose = "pose of the scanner in base_link (x, y [m], yaw [rad]), for example --mounting=-0.1,0,0"
    add("--ros", type=int, choices=(1, 2), help="ROS version (1)")
    add("--mounting", metavar="X,Y,YAW[,upside-down]", help=pose)
    add_topics(parser)
    add("--ros-args", nargs=argparse.REMAINDER, default=[], help="must be last, only for ROS 2: -p use_sim_time:=true")


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Add the names of ROS topics."""
    add = parser.add_argument
    add("--topics", nargs="+", default=[], action="extend", metavar="KEY=TOPIC", help="rename topics: scan=/scan")


def add_safe(parser: argparse.ArgumentParser) -> None:
    """Add `--safe`, the setting of the safety filter."""
    help_text = "drive with the safety filter; with guaranteed, more cautiously: see tb2rl/tasks/README.md"
    parser.add_argument("--safe", nargs="?", const="usual", choices=("usual", "guaranteed"), help=help_text)


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Add host and port of the viewer's page."""
    add = parser.add_argument
    add("--host", help="address of the viewer's page (127.0.0.1); 0.0.0.0: everybody can open it and drive")
    add("--port", type=int, help="port of the viewer's page (8080, or the next free one)")


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add `--trust`, without which a shared policy may import only some modules, see `tb2rl.core.trust`."""
    parser.add_argument("--trust", action="store_true", help="allow a shared policy to import any module")


def refuse(options: argparse.Namespace, reason: str, *names: str) -> None:
    """Raise an `InputError` with the reason if one of the named options was given."""
    for name in names:
        value = getattr(options, name)
        if not (value is None or value is False or value == []):
            raise InputError(f"--{name.replace('_', '-')} {reason}")
