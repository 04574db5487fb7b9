"""Policies on robots: scans, odometry and a bumper in, velocity commands out.

The caller carries the messages (ROS, a serial line, a test): it passes them on with their times and asks for commands,
see `Driver`. `portable/` runs on a robot without tb2rl: the driver itself, with numpy alone.
"""

from tb2rl.deploy.portable.driver import Command, Driver, Finding
from tb2rl.deploy.portable.policy_contract import Needs, Policy, SensorData
from tb2rl.deploy.portable.scan_reader import Mounting, Scan, ScanReader
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
