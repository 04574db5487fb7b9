"""A proxy for Clearpath's Jackal as the BARN challenge drives it: of its size and speed, but a disc on two wheels.

The real one is a box of 0.508 x 0.430 m on four wheels that skid when it turns. This one is a disc of half its length,
so that the corners, 0.333 m from its middle, are cut off, and it turns as a differential drive does, without slip. So
results with it are no results of the challenge. Numbers are those of Clearpath's data sheet, of the public packages
`jackal_description` and `jackal_control`, and of the challenge's own launch files, or chosen, as each line says;
`jackal.urdf` states the same numbers for the physics (a test holds the two together).
"""

from __future__ import annotations

import math
from pathlib import Path

from tb2rl.robots.robot import Camera, Laser, Robot

# Its optional camera, a Flea3 in `jackal_description`: 60 degrees horizontally, in pictures of 640 x 512.
_CAMERA_HEIGHT = 2 * math.atan(math.tan(math.radians(60.0) / 2) * 512 / 640)  # [rad] 49.6 degrees vertically

ROBOT = Robot(
    name="jackal",
    urdf=Path(__file__).with_suffix(".urdf"),
    wheel_joints=("wheel_left", "wheel_right"),
    radius=0.26,  # chosen: half its length, 0.254 m by the data sheet, rounded up; half its width is 0.215 m
    wheel_radius=0.098,  # jackal_description
    wheel_separation=0.32,  # chosen: at jackal_description's track, 0.37559 m, spheres as wheels stick out of the disc
    wheel_torque=4.05,  # chosen with the wheels' inertia: 3 m/s^2, which keeps their grip, see jackal.urdf
    max_speed=2.0,  # data sheet, jackal_control, and the speed that BARN's score goes by
    max_turn_rate=3.14,  # chosen: that of the learned policies of BARN's authors; jackal_control allows 4.0
    wheel_acceleration=2.873,  # measured in PyBullet, as is the next one
    wheel_coupling=0.142,
    laser=Laser(field_of_view=math.radians(270.0)),  # Hokuyo UST-10LX in jackal_description: 720 beams, 0.1 to 30 m
    camera=Camera(position=(0.21, 0.0, 0.27), field_of_view=_CAMERA_HEIGHT, range=(0.05, 8.0)),  # where: chosen
    task_settings={"field_of_view": math.pi},  # it looks ahead as a TurtleBot2 does
)
