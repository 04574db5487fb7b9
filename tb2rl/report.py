"""Write an HTML report of runs, suite results and bags.

    python -m tb2rl.report runs/maze/ppo/mine
    python -m tb2rl.report runs/maze/qlearn/seeds runs/maze/dqn/seeds --out comparison.html
    python -m tb2rl.report --compare runs/maze/qlearn/seeds runs/maze/dqn/seeds
    python -m tb2rl.report dwa.json
    python -m tb2rl.report drive.bag --world my_map.yaml

RUN may be a folder of runs, such as one from `train --seeds`. Runs that differ only in their seed are drawn together.
The page shows learning curves, the standard evaluation, replays in 3D of its first three episodes for at most 300
steps each, the paths of all, and a map of the policy's actions. Of many runs, the best three have replays.
The page is a single file for a browser, without external resources.

`--compare` compares two folders of runs: interquartile means, probability of improvement and performance profiles, with
intervals over seeds. A verdict says which is better, or that there are too few seeds.

The page of a run includes the suite results in the run folder. A file from `evaluate --suite ... --json dwa.json` has a
page of its own: metrics, the worlds without success, and 3D replays of the first six of these worlds.

The page of a bag shows the path by odometry, or the true path if a simulator recorded the bag. It also shows speed,
turn rate and nearest range over time. `--world` draws the path in a world. The path begins at the start of the world,
because the odometry frame is unknown; "{file: my_map.yaml, start: [1, 2, 0]}" sets another start.

    python -m tb2rl.report drive.bag --against my_robot.yaml --world my_map.yaml

`--against` drives the commands of a bag again, in a simulator with the robot of a policy's training or of a robot file.
It shows where both part: in windows of 5 s, each from the measured pose, in metres and, with `--world`, in ranges.
"""

from pathlib import Path

from tb2rl.commands.arguments import add_trust
from tb2rl.core.command import ArgumentParser, command


@command("report")
def main(parser: ArgumentParser) -> None:
    """Write the page and print its path."""
    add = parser.add_argument
    content = "run folder, folder of run folders, zoo:NAME, hf:USER/REPOSITORY, suite result, or bag of ROS"
    topics = "topics of a bag, such as odom=/odometry/filtered scan=/front/scan; others are found by type"
    add("runs", nargs="+", metavar="RUN", help=content)
    add_trust(parser)
    add("--compare", action="store_true", help="compare two folders of runs over their seeds")
    add("--out", type=Path, metavar="FILE", help="output file (default: report.html, in RUN if RUN is a single folder)")
    add("--world", help="world of the bags, a value of task.world")
    add("--against", metavar="POLICY", help="policy, run or robot file to simulate the drives of bags with")
    add("--topics", nargs="+", default=[], metavar="KIND=NAME", help=topics)


if __name__ == "__main__":
    main()
