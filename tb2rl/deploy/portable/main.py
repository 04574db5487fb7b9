"""The program: reads the messages of a robot as lines of JSON, and answers each with a command as a line of JSON.

An input line holds new data under any of these keys:

    "time":     time of the data [s], in every line or in none; by default the time at which the line arrives
    "scan":     {"ranges": [...], "angle_min": , "angle_increment": , "range_min": , "range_max": }, as in
                ROS; Infinity where nothing was hit, null where nothing was measured
    "odometry": {"x": , "y": , "yaw": , "v": , "w": } in m, rad, m/s and rad/s
    "bumper":   true when the base begins to touch something, false when it does not any more
    "cliff", "wheel_drop", "button": likewise, for a cliff sensor, a wheel that hangs in the air, and a button
    "goal":     [x, y] in the odometry frame
    "plan":     [[x, y], ...] a path in the odometry frame; the last point is the goal
    "start":    true to drive
    "stop":     true to stop

An output line is {"v": [m/s], "w": [rad/s], "why": "driving", or the reason for a stop}, with "intervention": REASON if
a filter, such as the safety filter, changed the command of the policy.

The last output line is a stop, whatever ends the program: the end of its input, an invalid line or one longer than 1 MB
(exit status 2), or a signal (SIGINT, SIGTERM, SIGHUP, SIGQUIT; status 128 + its number). Until it
has imported numpy and parsed its arguments, the program can end without an output line; it has sent no command then.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.envs.filters import SpeedLimits
from tb2rl.envs.safety import SETTINGS

from .driver import BUMPED, BUTTON, CLIFF, WHEEL_DROP, Command, Driver
from .filter_chain import OFF
from .policy import ExportedPolicy
from .policy_contract import MAX_MAGNITUDE
from .scan_reader import Mounting, Scan
from .termination import SignalGuard, SignalledError

_EVENTS = {"bumper": BUMPED, "cliff": CLIFF, "wheel_drop": WHEEL_DROP, "button": BUTTON}
_KEYS = ("time", "scan", "odometry", *_EVENTS, "goal", "plan", "start", "stop")
_MAX_LINE_LENGTH = 1_000_000  # [bytes]
_INPUT_ERRORS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def main(arguments: list[str] | None = None) -> None:
    """Answer input lines until the input ends, a line is invalid, or a signal arrives; then stop the robot.

    Raises:
        SystemExit: With status 2 after an error, or 128 + the number of a signal.
    """
    with SignalGuard() as guard:
        options = _parse(arguments)
        try:
            status, problem = _answer_all(options, guard)
        except OSError as error:  # such as a closed pipe
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the flush at exit could fail
            status, problem = 2, f"the input or the output failed: {error}"
    if problem:
        _log("error: {}".format(" ".join(problem.split())[:300]))
    if status:
        raise SystemExit(status)


def _answer_all(options: argparse.Namespace, guard: SignalGuard) -> tuple[int, str]:
    """Answer all input lines and stop the robot; returns the exit status, and the error or an empty string."""
    why, line = "an error ended the program", b""
    try:
        x, y, yaw = options.scanner
        mounting, limits = Mounting(x, y, yaw, options.upside_down), SpeedLimits(options.speed, options.turn_rate)
        driver = Driver(ExportedPolicy(options.folder), limits, mounting, options.dry_run, options.safe)
        while True:
            line = guard.wait_for(lambda: sys.stdin.buffer.readline(_MAX_LINE_LENGTH + 1))
            if not line:
                why = "the input ended"
                return 0, ""
            if len(line) > _MAX_LINE_LENGTH:
                raise ValueError(f"more than {_MAX_LINE_LENGTH} bytes")
            command = answer(driver, json.loads(line.decode("utf-8"), parse_int=float))  # an int may be too large
            _write(command.v, command.w, command.why, command.intervention)
    except SignalledError as error:
        (signal_number,) = error.args
        why = f"{signal.Signals(signal_number).name} ended the program"
        return 128 + signal_number, ""
    except _INPUT_ERRORS as error:
        if not line:  # the arguments or the folder are invalid
            return 2, str(error)
        why = "an invalid line ended the program"
        excerpt = line[:80].decode("utf-8", "backslashreplace").strip()
        return 2, f"{type(error).__name__}: {str(error)[:200]} in the line {excerpt}"
    finally:
        _write(0.0, 0.0, why)


def answer(driver: Driver, data: dict[str, Any]) -> Command:
    """Pass the data of a line to a driver; returns its command.

    Raises:
        TypeError, ValueError, LookupError: If the line is invalid; the driver may have received a part of its data.
    """
    for name in set(data) - set(_KEYS):
        raise ValueError(f"unknown key {name!r}; the keys are {', '.join(_KEYS)}")
    for name in ("start", *_EVENTS, "stop"):
        if data.get(name) not in (True, False, None):  # 1 and 0 are fine; "no" must not start a robot
            raise ValueError(f"{name!r} is {data[name]!r}; give true or false")
    now = _to_float(data["time"], sys.float_info.max) if "time" in data else time.monotonic()
    if "scan" in data:
        scan = data["scan"]
        ranges = [math.nan if each is None or each != each else _to_float(each, math.inf) for each in scan["ranges"]]
        bounds = {"range_min": _to_float(scan["range_min"]), "range_max": _to_float(scan["range_max"], math.inf)}
        angles = {name: _to_float(scan[name]) for name in ("angle_min", "angle_increment")}
        driver.see_scan(Scan(np.array(ranges), **angles, **bounds), now)
    if "odometry" in data:
        x, y, yaw, v, w = (_to_float(data["odometry"][name]) for name in ("x", "y", "yaw", "v", "w"))
        driver.see_odometry((x, y, yaw), (v, w), now)
    if "goal" in data:
        x, y = data["goal"]
        driver.set_goal((_to_float(x), _to_float(y)))
    if "plan" in data:
        driver.set_plan(np.array([[_to_float(x), _to_float(y)] for x, y in data["plan"]]))
    if data.get("start"):
        driver.start()
        for finding in driver.preflight():
            _log(f"{'error' if finding.is_error else 'warning'}: {finding.message}")
    for name, why in _EVENTS.items():
        if data.get(name) is not None:
            driver.see_event(why, bool(data[name]))
    if data.get("stop"):
        driver.stop()
    return driver.command(now)


def _to_float(value: Any, largest: float = MAX_MAGNITUDE) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= largest:  # or NaN
        raise ValueError(f"{value!r} is not a number from {-largest:g} to {largest:g}")
    return float(value)


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    description = "Drives a robot: answers each line of JSON with sensor data by a line of JSON with a command."
    parser = argparse.ArgumentParser(description=description, usage=argparse.SUPPRESS)  # so that an error is one line
    here = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=here, help="the policy's folder (default: drive.py's)")
    parser.add_argument("--speed", type=float, default=math.inf, help="largest speed [m/s]")
    parser.add_argument("--turn-rate", type=float, default=math.inf, help="largest turn rate [rad/s]")
    pose = "pose of the scanner: ahead of the axle and to its left [m], direction of angle 0 [rad]"
    parser.add_argument("--scanner", nargs=3, type=float, default=(0, 0, 0), metavar=("X", "Y", "YAW"), help=pose)
    parser.add_argument("--upside-down", action="store_true", help="the scanner is mounted upside down")
    parser.add_argument("--dry-run", action="store_true", help='do not drive; answer "dry run" instead')
    safe = "setting of the safety filter (default: usual)"
    parser.add_argument("--safe", choices=(*SETTINGS, OFF), default=SETTINGS[0], help=safe)
    return parser.parse_args(arguments)


def _write(v: float, w: float, why: str, intervention: str = "") -> None:
    extra = {"intervention": intervention} if intervention else {}
    print(json.dumps({"v": v, "w": w, "why": why, **extra}), flush=True)


def _log(line: str) -> None:
    if sys.stderr is not None:  # if it is None, `print` writes to stdout
        with suppress(OSError):
            print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
