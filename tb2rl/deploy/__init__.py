"""A policy at the wheel of a robot, outside of any simulation: scans, odometry and a bumper in, two speeds out.

What carries the messages (ROS, a serial line, a test) hands them over with their times, and asks for commands:

    from tb2rl.deploy import Driver, Limits, Mounting, Scan, TrainedPolicy

    policy = TrainedPolicy("zoo:maze-loop-ppo")
    driver = Driver(policy, Limits(speed=0.3), Mounting(x=0.1))
    driver.see_scan(Scan(ranges, angle_min, angle_increment, range_min, range_max), stamp)  # as each comes
    for finding in driver.preflight():
        print(finding.sentence)  # such as: the scan covers 60 degrees (-30 to 30), the policy was trained with ...
    driver.start()
    command = driver.command(now)  # ten times a second: command.v [m/s], command.w [rad/s], command.why

`portable/` is what runs on a robot without tb2rl: the driver itself, on numpy alone. Here are policies of tb2rl, and
planners on its worlds. Imported from here: the runs and what lies below them.
"""

from tb2rl.deploy.planner import WorldPlanner
from tb2rl.deploy.portable.driver import Command, Driver
from tb2rl.deploy.portable.policy_contract import Needs, Policy, Sensed
from tb2rl.deploy.portable.preflight import Finding, Limits
from tb2rl.deploy.portable.readings import Scan
from tb2rl.deploy.portable.scan import Mounting, ScanReader
from tb2rl.deploy.portable.way import Planner
from tb2rl.deploy.trained import TrainedPolicy

__all__ = [
    "Command",
    "Driver",
    "Finding",
    "Limits",
    "Mounting",
    "Needs",
    "Planner",
    "Policy",
    "Scan",
    "ScanReader",
    "Sensed",
    "TrainedPolicy",
    "WorldPlanner",
]
