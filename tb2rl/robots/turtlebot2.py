"""TurtleBot2: a Kobuki base with plates, a laptop, a laser scanner and an RGB-D camera.

Dimensions are those of `kobuki_description` and `turtlebot_description`; a test compares them with `turtlebot2.urdf`.
"""

import math
from pathlib import Path

from tb2rl.robots.robot import Camera, Laser, Robot

ROBOT = Robot(
    name="turtlebot2",
    urdf=Path(__file__).with_suffix(".urdf"),
    wheel_joints=("wheel_left", "wheel_right"),
    radius=0.178,  # kobuki_description, collision cylinder of the base
    wheel_radius=0.035,  # kobuki_description
    wheel_separation=0.230,  # kobuki_description, wheel joints
    wheel_torque=1.0,  # kobuki_description, effort limit
    max_speed=0.65,  # turtlebot_description (the bare base: 0.70)
    max_turn_rate=math.pi,  # Kobuki user guide: 180 deg/s
    wheel_acceleration=2.932,  # measured in PyBullet, like wheel_coupling
    wheel_coupling=0.067,
    laser=Laser(),  # as in the ROS tutorial: 720 beams over 180 degrees, 0.1 to 30 m
    camera=Camera(position=(0.05, 0.0, 0.30), field_of_view=math.radians(45.0), range=(0.05, 8.0)),
)
