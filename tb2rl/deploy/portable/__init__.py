"""The driver on a robot: Python 3.8 and numpy turn scan, odometry and bumper into velocity commands.

`tb2rl.export` packs these modules into one file. So they import the standard library, numpy, `tb2rl.envs.filters` and,
relatively, each other; and each name at the top of a module is unique among them.
"""
