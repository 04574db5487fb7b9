"""Policies on robots: scans, odometry and a bumper in, velocity commands out.

The caller carries the messages (ROS, a serial line, a test): it passes them on with their times and asks for commands.

    from tb2rl.deploy import Driver, Mounting, Scan, SpeedLimits, TrainedPolicy

    policy = TrainedPolicy("zoo:maze-loop-ppo")
    driver = Driver(policy, SpeedLimits(speed=0.3), Mounting(x=0.1))
    driver.see_scan(Scan(ranges, angle_min, angle_increment, range_min, range_max), stamp)  # each new scan
    for finding in driver.preflight():
        print(finding.sentence)  # such as: the scan covers 60 degrees (-30 to 30), the policy was trained with ...
    driver.start()
    command = driver.command(now)  # ten times a second: command.v [m/s], command.w [rad/s], command.why

`portable/` runs on a robot without tb2rl: the driver itself, with numpy alone. This room imports the runs and the rooms
below them.
"""

from tb2rl.deploy.portable.driver import Command, Driver
from tb2rl.deploy.portable.policy_contract import Needs, Policy, SensorData
from tb2rl.deploy.portable.preflight import Finding
from tb2rl.deploy.portable.scan import Scan
from tb2rl.deploy.portable.scan_reader import Mounting, ScanReader
from tb2rl.deploy.trained import TrainedPolicy
from tb2rl.envs.filters import Filter, SpeedLimits

__all__ = [
    "Command",
    "Driver",
    "Filter",
    "Finding",
    "Mounting",
    "Needs",
    "Policy",
    "Scan",
    "ScanReader",
    "SensorData",
    "SpeedLimits",
    "TrainedPolicy",
]
