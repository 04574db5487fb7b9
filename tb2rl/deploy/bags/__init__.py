"""Drives as bags, the recordings of ROS: an episode is written, and what anybody's robot recorded is read.

The library `rosbags` (the extra `bags`) does both without ROS. Imported from here: environments and what lies below
them.
"""
