"""The program: reads lines of JSON with the messages of a robot, and answers each with a line of JSON.

An input line holds new data, any of these keys:

    "time":     [s] of the data, in every line or in none; without it, the time at which the line came
    "scan":     {"ranges": [...], "angle_min": , "angle_increment": , "range_min": , "range_max": }, as in
                ROS; Infinity where nothing was hit, null where nothing was measured
    "odometry": {"x": , "y": , "yaw": , "v": , "w": } in m, rad, m/s and rad/s
    "bumper":   true while the base touches something
    "goal":     [x, y] in the odometry frame
    "plan":     [[x, y], ...] a path in that frame, its end is the goal
    "start":    true to drive; "stop": true to stand

An output line is {"v": [m/s], "w": [rad/s], "why": "driving", or why the robot stands}.

The last output line is a stop, however the program ends: at the end of its input, at a line that is wrong or longer
than 1 MB (exit status 2), or at a signal (SIGINT, SIGTERM, SIGHUP, SIGQUIT; status 128 + its number). This holds as
soon as numpy is imported and the arguments are parsed; before, the program has commanded nothing.
"""

from __future__ import annotations

import argparse
import difflib
import json
import math
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tb2rl.envs.filters import SpeedLimits

from .driver import Command, Driver
from .policy import ExportedPolicy
from .policy_contract import LARGEST
from .scan import Scan
from .scan_reader import Mounting
from .termination import SignalGuard, SignalledError

_KEYS = ("time", "scan", "odometry", "bumper", "goal", "plan", "start", "stop")
_LONGEST = 1_000_000  # [bytes] of a line
_WRONG = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def main(arguments: list[str] | None = None) -> None:
    """Answer input lines until the input ends, a line is wrong, or a signal comes; then stop the robot.

    Raises:
        SystemExit: With status 2 after an error, or 128 + the number of a signal.
    """
    with SignalGuard() as guard:
        options = _parse(arguments)
        try:
            status, fault = _answer_all(options, guard)
        except OSError as error:  # such as a closed pipe
            with suppress(OSError, ValueError):  # else the interpreter writes the rest when it exits
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            status, fault = 2, f"the input or the output failed: {error}"
    if fault:
        _log("error: {}".format(" ".join(fault.split())[:300]))
    if status:
        raise SystemExit(status)


def _answer_all(options: argparse.Namespace, guard: SignalGuard) -> tuple[int, str]:
    """Answer lines; returns the exit status and the error."""
    why, line = "an error ended the program", b""
    try:
        x, y, yaw = options.scanner
        mounting = Mounting(x, y, yaw, options.upside_down)
        limits = SpeedLimits(options.speed, options.turn_rate)
        driver = Driver(ExportedPolicy(options.folder), limits, mounting, options.dry_run)
        while True:
            line = guard.wait_for(lambda: sys.stdin.buffer.readline(_LONGEST + 1))
            if not line:
                why = "the input ended"
                return 0, ""
            if len(line) > _LONGEST:
                raise ValueError(f"more than {_LONGEST} bytes")
            news = json.loads(line.decode("utf-8"), parse_int=float)  # an int may be too large for a float
            command = answer(driver, news)
            _write(command.v, command.w, command.why)
    except SignalledError as error:
        (number,) = error.args
        why = f"{signal.Signals(number).name} ended the program"
        return 128 + number, ""
    except _WRONG as error:
        if not line:  # the folder is wrong
            return 2, str(error)
        why = "a line that was wrong"
        text = line[:80].decode("utf-8", "backslashreplace").strip()
        return 2, f"{type(error).__name__}: {str(error)[:200]} in the line {text}"
    finally:
        _write(0.0, 0.0, why)


def answer(driver: Driver, news: dict[str, Any]) -> Command:
    """Pass the data of a line to a driver; returns its command.

    Raises:
        TypeError, ValueError, LookupError: If the line is wrong; the driver may have taken a part of it.
    """
    if not isinstance(news, dict):
        raise TypeError(f"a line holds an object {{...}}, got {news!r}")
    for name in news:
        if name not in _KEYS:
            near = difflib.get_close_matches(name, _KEYS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(_KEYS)}"
            raise ValueError(f"unknown key {name!r}; {hint}")
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
            _log(f"{'cannot drive' if finding.serious else 'note'}: {finding.sentence}")
    if bumper:
        driver.bump()
    if stop:
        driver.stop()
    return driver.command(now)


def _flag(news: dict[str, Any], name: str) -> bool:
    value = news.get(name)
    if value not in (True, False, None):  # 1 and 0 are fine; "no" must not start a robot
        raise ValueError(f"{name} takes true or false, got {value!r}")
    return bool(value)


def _number(value: Any, largest: float = LARGEST) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is not a number")
    if not abs(value) <= largest:  # NaN, too
        raise ValueError(f"{value} is not a finite number up to {largest:g}")
    return float(value)


class _Parser(argparse.ArgumentParser):
    """Reports a wrong argument in one line."""

    def error(self, message: str) -> NoReturn:
        _log(f"error: {message}")
        raise SystemExit(2)


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = _Parser(description="Drives a robot: lines of JSON in, a line of JSON out for each.")
    here = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=here, help="of the policy (default: this program's)")
    parser.add_argument("--speed", type=float, default=math.inf, help="largest speed [m/s]")
    parser.add_argument("--turn-rate", type=float, default=math.inf, help="largest turn rate [rad/s]")
    parser.add_argument(
        "--scanner",
        nargs=3,
        type=float,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "YAW"),
        help="its pose: ahead of the axle and to the left [m], direction of its angle 0 [rad]",
    )
    parser.add_argument("--upside-down", action="store_true", help="the scanner is mounted head first")
    parser.add_argument("--dry-run", action="store_true", help='stand, and answer "dry run" where it would drive')
    return parser.parse_args(arguments)


def _write(v: float, w: float, why: str) -> None:
    print(json.dumps({"v": v, "w": w, "why": why}), flush=True)


def _log(line: str) -> None:
    if sys.stderr is not None:  # else `print` would write to stdout
        with suppress(OSError):
            print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
