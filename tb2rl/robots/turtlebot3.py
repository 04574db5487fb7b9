"""TurtleBot3 Burger: two servo motors under a tower of plates, a 360-degree laser scanner, a camera.

Dimensions are those of ROBOTIS's specifications; a test compares them with `turtlebot3.urdf`.
"""

import math
from pathlib import Path

from tb2rl.robots.robot import Camera, Laser, Robot

# Raspberry Pi camera v2: 62.2 degrees horizontally, aspect ratio 4:3.
_VERTICAL_FIELD = 2 * math.atan(math.tan(math.radians(62.2) / 2) * 3 / 4)  # [rad] 48.7 degrees

ROBOT = Robot(
    name="turtlebot3",
    urdf=Path(__file__).with_suffix(".urdf"),
    wheel_joints=("wheel_left", "wheel_right"),
    radius=0.105,  # of the circle that the robot needs to turn on the spot
    wheel_radius=0.033,
    wheel_separation=0.160,
    wheel_torque=0.15,  # chosen with the wheels' inertia for 2.5 m/s^2, the limit in ROBOTIS's navigation settings
    max_speed=0.22,
    max_turn_rate=2.84,
    wheel_acceleration=2.640,  # measured in PyBullet, like wheel_coupling
    wheel_coupling=-0.094,
    laser=Laser(beams=360, field_of_view=math.tau, min_range=0.12, max_range=3.5),  # LDS-01
    camera=Camera(position=(0.06, 0.0, 0.10), field_of_view=_VERTICAL_FIELD, range=(0.05, 8.0)),
    # The field of view of a TurtleBot2, and a control period with about the same distance per step.
    task_settings={"field_of_view": math.pi, "control_period": 0.4},
)
