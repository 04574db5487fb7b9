"""Watch a policy drive, in a window or in a film, or drive yourself.

    python -m tb2rl.play runs/maze/dqn/NAME
    python -m tb2rl.play zoo:maze-loop-ppo --video drive.mp4 --camera chase
    python -m tb2rl.play --agent wallfollower --set task.world=circuit
    python -m tb2rl.play --agent pursuit --task navigate --goal 3,2 --set task.world=my_map.yaml
    python -m tb2rl.play zoo:maze-loop-ppo --bag drive.bag
    python -m tb2rl.play --teleop --task wall

PyBullet's window shows the robot in real time. Without a display a film is written instead. `--bag` records a bag for
the tools of ROS and for `tb2rl.report`; the same seed gives the same episodes as in a film.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.policy_arguments import add_policy_arguments, add_robot_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = ArgumentParser(prog="python -m tb2rl.play", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--teleop", action="store_true", help="instead: drive yourself, by the terminal's keys")
    parser.add_argument("--episodes", type=int, default=1, help="number of episodes (1)")
    parser.add_argument("--steps", type=int, help="control steps at most in an episode (300, a minute)")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode (0)")
    parser.add_argument("--video", type=Path, metavar="FILE", help="write a film, .mp4 or .gif, instead of a window")
    parser.add_argument(
        "--bag", type=Path, metavar="PATH", help="write a bag instead: a file .bag for ROS 1, else a folder for ROS 2"
    )
    add_robot_arguments(parser)
    parser.add_argument("--camera", default="above", help="above (default) or chase")
    parser.add_argument("--speed", type=float, default=1.0, help="playback speed (1)")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Play, and print how the episodes ended."""
    parsed = parse(arguments)
    from tb2rl.commands.play import run  # imported late, because it takes seconds

    run(parsed)


if __name__ == "__main__":
    main()
