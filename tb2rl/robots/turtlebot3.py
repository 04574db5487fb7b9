"""The TurtleBot3 Burger: two servo motors under a tower of plates, a laser scanner that sees all around, a camera.

Dimensions follow ROBOTIS's public specifications; `turtlebot3.urdf` states the same numbers for the physics (a test
holds the two together).
"""

from __future__ import annotations

import math
from pathlib import Path

from tb2rl.robots.robot import Camera, Laser, Robot

# A Raspberry Pi's camera, version 2: 62.2 degrees horizontally, in pictures of 4 to 3.
_CAMERA_HEIGHT = 2 * math.atan(math.tan(math.radians(62.2) / 2) * 3 / 4)  # [rad] 48.7 degrees vertically

ROBOT = Robot(
    name="turtlebot3",
    urdf=Path(__file__).with_suffix(".urdf"),
    wheel_joints=("wheel_left", "wheel_right"),
    radius=0.105,  # around the axle, for turning on the spot
    wheel_radius=0.033,
    wheel_separation=0.160,
    wheel_torque=0.15,  # chosen with the wheels' inertia: 2.5 m/s^2, as its settings for ROS's navigation allow
    max_speed=0.22,
    max_turn_rate=2.84,
    wheel_acceleration=2.640,  # measured in PyBullet, as is the next one
    wheel_coupling=-0.094,
    laser=Laser(beams=360, field_of_view=math.tau, min_range=0.12, max_range=3.5),  # LDS-01
    camera=Camera(position=(0.06, 0.0, 0.10), field_of_view=_CAMERA_HEIGHT, range=(0.05, 8.0)),
    # It looks ahead as a TurtleBot2 does; at 0.4 s a step takes it about as far, so that episodes are as long.
    task_settings={"field_of_view": math.pi, "control_period": 0.4},
)
