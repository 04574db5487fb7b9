"""What drives: a robot is a value, its dimensions, limits, laser and camera, with a URDF file for the physics.

A robot is one file here: `turtlebot2.py` is the one to copy (see README.md). Imported from here: what all rooms need.
"""

from tb2rl.robots.robot import Camera, Laser, Robot

__all__ = ["Camera", "Laser", "Robot"]
