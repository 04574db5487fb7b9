"""Watch a policy drive, live or in a film, or drive yourself.

    python -m tb2rl.play runs/maze/dqn/NAME
    python -m tb2rl.play zoo:maze-loop-ppo --video drive.mp4 --camera chase
    python -m tb2rl.play --agent wallfollower --set task.world=circuit
    python -m tb2rl.play --agent pursuit --task navigate --goal 3,2 --set task.world=my_map.yaml
    python -m tb2rl.play zoo:maze-loop-ppo --bag drive.bag
    python -m tb2rl.play --teleop --task wall

The page in the browser shows the robot in real time: drag its goal, add walls, choose another policy, task or world.
`--video` writes a film, `--bag` a bag for the tools of ROS and for `tb2rl.report`. The same seed yields the same
episodes on the page, in a film and in a bag.
"""

from pathlib import Path

from tb2rl.commands.arguments import add_page_arguments, add_policy_arguments, add_robot_arguments
from tb2rl.core.command import ArgumentParser, command


@command("play")
def main(parser: ArgumentParser) -> None:
    """Play, and print how the episodes ended."""
    add_policy_arguments(parser)
    add = parser.add_argument
    add("--teleop", action="store_true", help="drive yourself, with the keys of the page")
    add("--viewer", action="store_true", help="open the page in the browser, which is the default")
    add_page_arguments(parser)
    add("--episodes", type=int, help="number of episodes of a film or a bag (1)")
    add(
        "--steps",
        type=int,
        help="time limit of an episode in control steps (in films and bags 300; else that of the task)",
    )
    add("--seed", type=int, default=0, help="random seed of the first episode (0)")
    add("--video", type=Path, metavar="FILE", help="write a film, .mp4 or .gif")
    add("--bag", type=Path, metavar="PATH", help="write a bag: FILE.bag for ROS 1, or a folder for ROS 2")
    add_robot_arguments(parser)
    add("--camera", default="above", help="camera position: above (default) or chase")
    add("--speed", type=float, default=1.0, help="playback speed (1)")


if __name__ == "__main__":
    main()
