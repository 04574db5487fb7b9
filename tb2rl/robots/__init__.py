"""Robots: dimensions, limits, laser, camera, and a URDF file for PyBullet.

A robot is one file; copy `turtlebot2.py` (see README.md). Imports only core.
"""

from tb2rl.robots.robot import Camera, Laser, Robot

__all__ = ["Camera", "Laser", "Robot"]
