"""Bags, the recordings of ROS: an episode is written as a bag, and a bag of any robot is read as a `Drive`.

The library `rosbags` (the extra `bags`) reads and writes bags without ROS. This package may import environments and the
packages below them.
"""
