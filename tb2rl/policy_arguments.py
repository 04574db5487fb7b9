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


def add_trust(parser: argparse.ArgumentParser) -> None:
    """What lets a policy that somebody shared name any module, see `tb2rl.trust`."""
    parser.add_argument("--trust", action="store_true", help="import any module that a shared policy names")
