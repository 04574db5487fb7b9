"""Estimates the parameters of a robot from a recorded drive: scans, odometry and commands.

`tb2rl.calibration.calibration` is the entry; `alignment` explains scans by each other, `response` explains odometry by
commands, and `laser` reads noise and dropped beams. What a drive does not show has a wide interval.
"""
