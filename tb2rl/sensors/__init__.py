"""What is read: each sensor turns a `RobotState` into numbers, or into an image, for a learner to observe.

A task lists its sensors; a sensor of one's own is a small class (see README.md). Imported from here: the simulation and
what lies below it.
"""

from tb2rl.sensors.sensor import Sensor

__all__ = ["Sensor"]
