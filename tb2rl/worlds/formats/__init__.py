"""Readers of foreign formats: Gazebo's SDF and ROS maps; each ends with `imports.complete_world`."""
