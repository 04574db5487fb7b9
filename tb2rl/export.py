"""Export a policy: an ONNX file, or a folder for numpy on a robot.

    python -m tb2rl.export zoo:drive-loop-ppo policy.onnx
    python -m tb2rl.export zoo:drive-loop-ppo robot

The input of an ONNX file is the observation, as for `predict`; the export needs the extra `export`. The numpy program
in the folder computes the observation from scans, odometry, bumper and goal. Both select the greedy action.
"""

from pathlib import Path

from tb2rl.commands.arguments import add_trust
from tb2rl.core.command import ArgumentParser, command


@command("export")
def main(parser: ArgumentParser) -> None:
    """Export a policy."""
    parser.add_argument("policy", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    parser.add_argument("target", type=Path, help="a file that ends in .onnx, or a folder to create")


if __name__ == "__main__":
    main()
