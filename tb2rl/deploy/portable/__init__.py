"""The driver of a robot, which turns scans, odometry and bumper into velocity commands; for Python 3.8 and numpy.

`tb2rl.export` packs these modules into one file. Therefore they may import only the standard library, numpy,
`tb2rl.envs.filters` and, relatively, each other. No two modules may define the same global name.
"""
