"""The names of the sensors that a task's setting `observe` can list."""

from __future__ import annotations

from tb2rl.sensors.bumper import Bumper
from tb2rl.sensors.camera import Camera
from tb2rl.sensors.goal import GoalBearing, GoalDirection, GoalDistance
from tb2rl.sensors.laser import LaserRanges
from tb2rl.sensors.motion import ForwardAcceleration, ForwardSpeed, LastAction, TurnRate, YawRate
from tb2rl.sensors.paths import FreePaths
from tb2rl.sensors.sensor import Sensor
from tb2rl.sensors.visited import Visited
from tb2rl.sensors.waypoint import Waypoint, WaypointBearing

SENSORS: dict[str, tuple[type[Sensor], ...]] = {
    "bumper": (Bumper,),
    "camera": (Camera,),
    "free_paths": (FreePaths,),
    "goal": (GoalDistance, GoalBearing),
    "goal_direction": (GoalDirection,),
    "imu": (YawRate, ForwardAcceleration),
    "laser": (LaserRanges,),
    "last_action": (LastAction,),
    "twist": (ForwardSpeed, TurnRate),
    "visited": (Visited,),
    "waypoint": (Waypoint,),
    "waypoint_bearing": (WaypointBearing,),
}
