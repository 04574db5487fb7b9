"""How good a policy is: an episode driven, many of them evaluated, and the figures with their intervals.

What is judged comes back as a value: nothing here writes a file or prints a table. Imported from here:
robots with ROS and below.
"""
