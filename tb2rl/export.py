"""Export a policy: an ONNX file, or a folder for numpy on a robot.

    python -m tb2rl.export zoo:drive-loop-ppo policy.onnx
    python -m tb2rl.export zoo:drive-loop-ppo robot

The file takes the observation, as `predict` does, and needs the extra `export`; the folder takes the robot's own scans,
odometry, bumper and goal. Both act as the policy does, greedily: without exploration.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.policy_arguments import add_trust


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(prog="python -m tb2rl.export", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policy", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    parser.add_argument("target", type=Path, help="a file that ends in .onnx, or a folder to create")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Export a policy."""
    options = parse(arguments)
    from tb2rl.commands.export import run  # only now, because it imports torch

    run(options)


if __name__ == "__main__":
    main()
