"""The TurtleBot2 with a laser scanner on its top plate that sees all around, for who drives among people.

An RPLIDAR A2M8 by its data sheet: 0.9 degrees from beam to beam at 10 Hz, 0.15 to 12 m.
"""

from __future__ import annotations

import math
from dataclasses import replace

from tb2rl.robots.robot import Laser
from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2

ROBOT = replace(
    TURTLEBOT2,
    name="turtlebot2_rplidar",
    laser=Laser(beams=400, field_of_view=math.tau, min_range=0.15, max_range=12.0),
)
