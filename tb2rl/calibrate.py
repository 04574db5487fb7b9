"""Estimate a robot's parameters from bags of its drives.

    python -m tb2rl.calibrate drive.bag -o my_robot.yaml
    python -m tb2rl.train --agent ppo --task navigate --set task.robot=my_robot.yaml task.variation=my_robot.yaml

The bags have scans, odometry and commands, of ROS 1 or ROS 2; `python -m tb2rl.ros calibrate` drives and records what
is needed, and bags of `play --bag` work, too. The table shows each quantity with its 95 % interval, and which manoeuvre
would show the unknown ones. `--world` takes the map of the drive, and measures the scales of the odometry against its
walls; the scans find the start in the map. The page beside the file, my_robot.html, compares predicted and measured
motions and scans, before and after the calibration.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, command


@command("calibrate")
def main(parser: ArgumentParser) -> None:
    """Write the robot file and the page, and print the estimates."""
    add = parser.add_argument
    topics = "topics of the bags, such as odom=/odometry/filtered scan=/front/scan; others are found by type"
    add("bags", nargs="+", type=Path, metavar="BAG", help="bags of drives of one robot")
    add("-o", "--out", type=Path, required=True, metavar="FILE", help="robot file, NAME.yaml; the page is NAME.html")
    add("--robot", default="turtlebot2", help="the nominal robot (turtlebot2)")
    add("--world", help="map of the drives, a value of task.world: measures the scales of the odometry against it")
    add("--topics", nargs="+", default=[], metavar="KIND=NAME", help=topics)


if __name__ == "__main__":
    main()
