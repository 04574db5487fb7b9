"""Bags, the recordings of ROS: an episode is written as a bag, and a bag of any robot is read as a drive.

The library `rosbags` (the extra `bags`) reads and writes them without ROS. May import: environments and the packages
below them.
"""
