"""Implementation of `python -m tb2rl.calibrate`: a robot file and a page from bags."""

import argparse

from tb2rl.commands.worlds import only_world
from tb2rl.core import InputError, check_output, write_text
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import install_extra
from tb2rl.core.files import parse_yaml
from tb2rl.deploy.bags.reading import parse_topics, read_drive
from tb2rl.robots.robot import find_robot
from tb2rl.robots.robot_file import ROBOT_SUFFIXES


def run(arguments: argparse.Namespace) -> None:
    """Write the file and the page, and print the table."""
    try:
        import scipy.optimize  # noqa: F401
    except ImportError:
        raise InputError(f"calibrate needs the extra `calibrate`: {install_extra('calibrate')}") from None
    from tb2rl.calibration.calibration import calibrate
    from tb2rl.calibration.output import robot_file, rows
    from tb2rl.viz.calibration import calibration_page

    out, page, robot = arguments.out, arguments.out.with_suffix(".html"), find_robot(arguments.robot)
    if out.suffix not in ROBOT_SUFFIXES:
        raise InputError(f"the robot file must end in .yaml, got {out}")
    check_output(out)
    topics = parse_topics(arguments.topics)
    world = only_world(parse_yaml(arguments.world, "--world"), "--world") if arguments.world else None
    announce_compiling()
    calibration = calibrate([read_drive(bag, topics, scans=True) for bag in arguments.bags], robot, world)
    write_text(out, robot_file(calibration, arguments.robot))
    write_text(page, calibration_page(calibration))
    for label, value, interval in rows(calibration):
        print(f"{label:34} {value:>18}   {interval}")
    print(f"wrote {out} and {page}")
