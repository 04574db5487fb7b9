"""Sensors, which turn a `RobotState` into numbers or an image for the observation.

A task lists its sensors; a user's sensor is a small class (see README.md). Imports simulation and what lies below it.
"""

from tb2rl.sensors.sensor import Sensor

__all__ = ["Sensor"]
