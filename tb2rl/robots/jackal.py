"""An approximation of Clearpath's Jackal, the robot of the BARN challenge, by a round robot with two wheels.

The real robot is a box of 0.508 x 0.430 m on four wheels that skid in turns. The round base does not cover the corners
of the box, 0.333 m from the middle, and turns without slip, so results are not comparable with those of the challenge.
Sources of the numbers are Clearpath's data sheet, `jackal_description`, `jackal_control`, and the launch files of the
challenge. A test compares the numbers with `jackal.urdf`.
"""

import math
from pathlib import Path

from tb2rl.robots.robot import Camera, Laser, Robot

# The optional camera, a Flea3 in `jackal_description`: 60 degrees horizontally, 640 x 512 pixels.
_VERTICAL_FIELD = 2 * math.atan(math.tan(math.radians(60.0) / 2) * 512 / 640)  # [rad] 49.6 degrees

ROBOT = Robot(
    name="jackal",
    urdf=Path(__file__).with_suffix(".urdf"),
    wheel_joints=("wheel_left", "wheel_right"),
    radius=0.26,  # chosen: half the length, 0.254 m in the data sheet, rounded up; half the width is 0.215 m
    wheel_radius=0.098,  # jackal_description
    wheel_separation=0.32,  # chosen: with jackal_description's 0.37559 m spherical wheels would stick out of the base
    wheel_torque=4.05,  # chosen with the wheels' inertia for 3 m/s^2, at which wheels do not slip (see jackal.urdf)
    max_speed=2.0,  # data sheet, jackal_control, and the score of BARN
    max_turn_rate=3.14,  # chosen as in the learned policies of BARN's authors; jackal_control allows 4.0
    wheel_acceleration=2.873,  # measured in PyBullet, like wheel_coupling
    wheel_coupling=0.142,
    laser=Laser(field_of_view=math.radians(270.0)),  # Hokuyo UST-10LX in jackal_description: 720 beams, 0.1 to 30 m
    camera=Camera(position=(0.21, 0.0, 0.27), field_of_view=_VERTICAL_FIELD, range=(0.05, 8.0)),  # position: chosen
    task_settings={"field_of_view": math.pi},  # the field of view of a TurtleBot2
)
