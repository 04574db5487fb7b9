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

The last line out says to stand, whatever ends the program: the end of its input, a line that is wrong or longer than
1 MB (exit status 2), or a signal (SIGINT, SIGTERM, SIGHUP, SIGQUIT; status 128 + its number). That holds as soon as
numpy is imported and the arguments are read; before, the program has commanded nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, List, NoReturn, Optional

import numpy as np

from .driver import Driver
from .ending import Ending, SignalledError
from .policy import ExportedPolicy
from .policy_contract import LARGEST
from .preflight import Limits
from .readings import Scan
from .scan import Mounting

_LONGEST = 1_000_000  # [bytes] of a line
_WRONG = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def main(arguments: Optional[List[str]] = None) -> None:
    """Answer each line of the input until it ends, a line is wrong, or a signal comes; then say to stand.

    Raises:
        SystemExit: With status 2 for what is wrong, or 128 + the number of a signal.
    """
    with Ending() as ending:
        options = _options(arguments)
        try:
            status, fault = _answer_all(options, ending)
        except OSError as error:  # such as nobody who reads the answers
            with suppress(OSError, ValueError):  # else the interpreter tries to write them at its end
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            status, fault = 2, "the input or the output failed: {}".format(error)
    if fault:
        _note("error: {}".format(" ".join(fault.split())[:300]))
    if status:
        raise SystemExit(status)


def _answer_all(options: argparse.Namespace, ending: Ending) -> Any:
    """Answer lines; returns the exit status, and what was wrong."""
    why, line = "an error ended the program", b""
    try:
        driver = _driver(options)
        while True:
            line = ending.wait_for(_next_line)
            if not line:
                why = "the input ended"
                return 0, ""
            command = answer(driver, _read(line))
            _say(command.v, command.w, command.why)
    except SignalledError as error:
        why = "{} ended the program".format(error)
        return error.status, ""
    except _WRONG as error:
        if not line:  # it is the folder
            return 2, str(error)
        why = "a line that was wrong"
        text = line[:80].decode("utf-8", "backslashreplace").strip()
        return 2, "{}: {} in the line {}".format(type(error).__name__, str(error)[:200], text)
    finally:
        _say(0.0, 0.0, why)


def _next_line() -> bytes:
    """The next line of the input, or the beginning of one that is too long; b"": it ended."""
    return b"" if sys.stdin is None else sys.stdin.buffer.readline(_LONGEST + 1)  # None: it was closed from the start


def _read(line: bytes) -> Any:
    """What a line says.

    Raises:
        ValueError, RecursionError: If it is not JSON, or is too long.
    """
    if len(line) > _LONGEST:
        raise ValueError("more than {} bytes".format(_LONGEST))
    return json.loads(line.decode("utf-8"), parse_int=float)  # an int may be too large for a float


def answer(driver: Driver, news: Dict[str, Any]) -> Any:
    """Tell a driver what a line says; returns its command.

    Raises:
        TypeError, ValueError, LookupError: If the line is wrong; then the driver may have heard a part of it.
    """
    if not isinstance(news, dict):
        raise TypeError("a line holds an object {{...}}, got {!r}".format(news))
    start, bumper, stop = (_flag(news, name) for name in ("start", "bumper", "stop"))
    now = _number(news["time"], sys.float_info.max) if "time" in news else time.monotonic()
    if "scan" in news:
        scan = news["scan"]
        ranges = [math.nan if each is None or each != each else _number(each, math.inf) for each in scan["ranges"]]
        ends = {"range_min": _number(scan["range_min"]), "range_max": _number(scan["range_max"], math.inf)}
        angles = {name: _number(scan[name]) for name in ("angle_min", "angle_increment")}
        driver.see_scan(Scan(np.array(ranges), **angles, **ends), now)
    if "odometry" in news:
        x, y, yaw, v, w = (_number(news["odometry"][name]) for name in ("x", "y", "yaw", "v", "w"))
        driver.see_odometry((x, y, yaw), (v, w), now)
    if "goal" in news:
        x, y = news["goal"]
        driver.set_goal((_number(x), _number(y)))
    if "plan" in news:
        driver.set_plan(np.array([[_number(x), _number(y)] for x, y in news["plan"]]))
    if start:
        driver.start()
        for finding in driver.preflight():
            _note("{}: {}".format("cannot drive" if finding.serious else "note", finding.sentence))
    if bumper:
        driver.bump()
    if stop:
        driver.stop()
    return driver.command(now)


def _flag(news: Dict[str, Any], name: str) -> bool:
    value = news.get(name)
    if value not in (True, False, None):  # 1 and 0 are fine; "no" must not start a robot
        raise ValueError("{} takes true or false, got {!r}".format(name, value))
    return bool(value)


def _number(value: Any, largest: float = LARGEST) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("{!r} is not a number".format(value))
    if not abs(value) <= largest:  # NaN, too
        raise ValueError("{} is not a finite number up to {:g}".format(value, largest))
    return float(value)


class _Parser(argparse.ArgumentParser):
    """One that reports a wrong argument in a line."""

    def error(self, message: str) -> NoReturn:
        _fail(message)


def _options(arguments: Optional[List[str]]) -> argparse.Namespace:
    if sys.stdout is None:
        _fail("the standard output is closed: the robot would not hear an answer")
    parser = _Parser(description="Drives a robot: lines of JSON in, a line of JSON out for each.")
    here = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=here, help="of the policy (default: this program's)")
    parser.add_argument("--speed", type=_limit, default=math.inf, help="the fastest that it may drive [m/s]")
    parser.add_argument("--turn-rate", type=_limit, default=math.inf, help="the fastest that it may turn [rad/s]")
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
    return parser.parse_args(arguments)


def _limit(text: str) -> float:
    with suppress(ValueError):
        if 0.0 < float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError("takes a finite number above 0, got {!r}".format(text))


def _driver(options: argparse.Namespace) -> Driver:
    x, y, yaw = options.scanner
    mounting = Mounting(x, y, yaw, options.upside_down)
    limits = Limits(options.speed, options.turn_rate)
    return Driver(ExportedPolicy(options.folder), limits, mounting, dry_run=options.dry_run)


def _say(v: float, w: float, why: str) -> None:
    print(json.dumps({"v": v, "w": w, "why": why}), flush=True)


def _note(line: str) -> None:
    if sys.stderr is not None:  # else `print` would take the standard output
        with suppress(OSError):
            print(line, file=sys.stderr, flush=True)


def _fail(message: str) -> NoReturn:
    _note("error: {}".format(message))
    raise SystemExit(2)


if __name__ == "__main__":
    main()
