"""What `python -m tb2rl.ros drive` does: a policy at the wheel of a robot with ROS."""

from __future__ import annotations

import argparse
import signal
import threading
from contextlib import closing

import torch as th

from tb2rl.core.errors import InputError
from tb2rl.deploy import Driver, TrainedPolicy
from tb2rl.deploy.portable.ending import ending_signals
from tb2rl.deploy.ros.graph import join
from tb2rl.deploy.ros.pilot import NAME, Pilot
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, parse_topics
from tb2rl.runs.loading import load


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
        for sign in ending_signals():
            signal.signal(sign, lambda *_: ending.set())
        told = "nothing: a dry run" if options.dry_run else f"commands to {topics.velocity}"
        print(f"{options.policy} on ROS {options.ros}: scans from {topics.scan}, {told}", flush=True)
        with closing(Pilot(driver, policy.needs, graph, topics, options.wait, options.dry_run)) as pilot:
            pilot.run(ending)
