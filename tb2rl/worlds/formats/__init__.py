"""Readers of foreign formats: Gazebo's SDF, ROS maps and BARN; each ends with `imports.complete_world`."""
