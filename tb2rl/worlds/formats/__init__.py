"""Worlds that others drew: Gazebo's SDF, and the maps of ROS; each reader ends with `finished`, see `imports`.

Imported from here: the world itself and its geometry, and what all need.
"""
