"""What `python -m tb2rl.ros drive` does: a policy at the wheel of a robot with ROS."""

from __future__ import annotations

import argparse
import math
import signal
import threading
from contextlib import closing

import torch as th

from tb2rl.drivers import Driver, Limits, Mounting, TrainedPolicy
from tb2rl.errors import InputError
from tb2rl.ros.graph import join
from tb2rl.ros.pilot import NAME, Pilot
from tb2rl.ros.topics import TURTLEBOT2, parse_topics
from tb2rl.runs.loading import load

_UPSIDE_DOWN = "upside-down"


def run(options: argparse.Namespace) -> None:
    """Drive until a signal ends it."""
    if options.ros_args and options.ros == 1:
        raise InputError("--ros-args is for --ros 2")
    topics = parse_topics(options.topics, TURTLEBOT2[options.ros])
    mounting, limits = parse_mounting(options.mounting), parse_limits(options.speed)
    th.set_num_threads(1)  # a decision is too small to be shared, and the robot's other programs want to run, too
    policy = TrainedPolicy(load(options.policy, options.trust))
    driver = Driver(policy, limits, mounting, dry_run=options.dry_run)
    with closing(join(options.ros, NAME, options.ros_args)) as graph:
        ending = threading.Event()
        for sign in (signal.SIGINT, signal.SIGTERM):
            signal.signal(sign, lambda *_: ending.set())
        told = "nothing: a dry run" if options.dry_run else f"commands to {topics.velocity}"
        print(f"{options.policy} on ROS {options.ros}: scans from {topics.scan}, {told}", flush=True)
        with closing(Pilot(driver, policy.needs, graph, topics, options.wait, options.dry_run)) as pilot:
            pilot.run(ending)


def parse_mounting(text: str) -> Mounting:
    """Where the scanner is, as the command line has it: "x,y,yaw" or "x,y,yaw,upside-down".

    Raises:
        InputError: If it is not that.
    """
    *numbers, last = text.split(",")
    upside_down = last == _UPSIDE_DOWN
    try:
        x, y, yaw = map(float, numbers if upside_down else [*numbers, last])
    except ValueError:
        x = y = yaw = math.nan
    if not all(map(math.isfinite, (x, y, yaw))):
        raise InputError(
            f"--mounting takes x,y,yaw or x,y,yaw,{_UPSIDE_DOWN} in m and rad, such as 0.1,0,3.14159, got {text!r}"
        )
    return Mounting(x, y, yaw, upside_down)


def parse_limits(speed: float | None) -> Limits:
    """The speed [m/s] that the robot is to keep to; None: what the policy drives.

    Raises:
        InputError: If it is no speed.
    """
    if speed is None:
        return Limits()
    if not 0.0 < speed < math.inf:
        raise InputError(f"--speed takes m/s above 0, got {speed:g}")
    return Limits(speed=speed)
