"""Names of the sensors, for a task's setting `observe`."""

from __future__ import annotations

from tb2rl.sensors import bumper, camera, goal, laser, motion, paths, visited, waypoint
from tb2rl.sensors.sensor import Sensor

SENSORS: dict[str, tuple[type[Sensor], ...]] = {
    "bumper": (bumper.Bumper,),
    "camera": (camera.Camera,),
    "free_paths": (paths.FreePaths,),
    "goal": (goal.GoalDistance, goal.GoalBearing),
    "goal_direction": (goal.GoalDirection,),
    "imu": (motion.YawRate, motion.ForwardAcceleration),
    "laser": (laser.LaserRanges,),
    "last_action": (motion.LastAction,),
    "twist": (motion.ForwardSpeed, motion.TurnRate),
    "visited": (visited.Visited,),
    "waypoint": (waypoint.Waypoint,),
    "waypoint_bearing": (waypoint.WaypointBearing,),
}
