"""The program: lines of JSON in, from whatever carries a robot's messages, and a line of JSON out for each.

A line in holds what is new, any of these keys:

    "time":     [s] when it was, in every line; or in none: then it is when the line came
    "scan":     {"ranges": [...], "angle_min": , "angle_increment": , "range_min": , "range_max": }, as ROS
                says it; Infinity where nothing was hit, null where nothing was measured
    "odometry": {"x": , "y": , "yaw": , "v": , "w": } in m, rad, m/s and rad/s
    "bumper":   true while the base touches something
    "goal":     [x, y] in the odometry's frame
    "plan":     [[x, y], ...] a way in that frame, its end is the goal
    "start":    true to drive; "stop": true to stand

A line out says {"v": [m/s], "w": [rad/s], "why": "driving", or why the robot stands}.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, NoReturn, Optional

import numpy as np

from .driver import Driver
from .policy import ExportedPolicy
from .preflight import Limits
from .readings import Scan
from .scan import Mounting


def main(arguments: Optional[List[str]] = None) -> None:
    """Answer every line of the input until it ends; one that is wrong stops the robot and the program."""
    driver = _driver(arguments)
    for line in sys.stdin:
        try:
            command = answer(driver, json.loads(line))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            _say(0.0, 0.0, "a line that was wrong")
            _fail("{}: {} in the line {}".format(type(error).__name__, error, line.strip()[:80]))
        _say(command.v, command.w, command.why)


def answer(driver: Driver, news: Dict[str, Any]) -> Any:
    """Tell a driver what a line says; returns its command."""
    now = _finite(news.get("time", time.monotonic()))
    if "scan" in news:
        scan = news["scan"]
        ranges = np.array([math.nan if each is None else each for each in scan["ranges"]], dtype=float)
        driver.see_scan(Scan(ranges, **{name: float(scan[name]) for name in _SCAN}), now)
    if "odometry" in news:
        x, y, yaw, v, w = (_finite(news["odometry"][name]) for name in ("x", "y", "yaw", "v", "w"))
        driver.see_odometry((x, y, yaw), (v, w), now)
    if "goal" in news:
        x, y = news["goal"]
        driver.set_goal((_finite(x), _finite(y)))
    if "plan" in news:
        driver.set_plan(np.array(news["plan"], dtype=float))
    if news.get("start"):
        driver.start()
        for finding in driver.preflight():
            print("{}: {}".format("cannot drive" if finding.serious else "note", finding.sentence), file=sys.stderr)
    if news.get("bumper"):
        driver.bump()
    if news.get("stop"):
        driver.stop()
    return driver.command(now)


_SCAN = ("angle_min", "angle_increment", "range_min", "range_max")


def _finite(value: Any) -> float:
    if not math.isfinite(value):
        raise ValueError("{} is not a finite number".format(value))
    return float(value)


def _driver(arguments: Optional[List[str]]) -> Driver:
    parser = argparse.ArgumentParser(description="Drives a robot: lines of JSON in, a line of JSON out for each.")
    here = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=here, help="of the policy (default: this program's)")
    parser.add_argument("--speed", type=float, default=math.inf, help="the fastest that it may drive [m/s]")
    parser.add_argument("--turn-rate", type=float, default=math.inf, help="the fastest that it may turn [rad/s]")
    parser.add_argument(
        "--scanner",
        nargs=3,
        type=float,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "YAW"),
        help="where it is: ahead of the axle and to the left [m], and where its angle 0 looks [rad]",
    )
    parser.add_argument("--upside-down", action="store_true", help="the scanner hangs head first")
    parser.add_argument("--dry-run", action="store_true", help="only say what it would drive: the robot is to stand")
    options = parser.parse_args(arguments)
    try:
        policy = ExportedPolicy(options.folder)
    except ValueError as error:
        _fail(str(error))
    x, y, yaw = options.scanner
    mounting = Mounting(x, y, yaw, options.upside_down)
    return Driver(policy, Limits(options.speed, options.turn_rate), mounting, dry_run=options.dry_run)


def _say(v: float, w: float, why: str) -> None:
    print(json.dumps({"v": v, "w": w, "why": why}), flush=True)


def _fail(message: str) -> NoReturn:
    print("error: {}".format(message), file=sys.stderr)
    raise SystemExit(2)


if __name__ == "__main__":
    main()
