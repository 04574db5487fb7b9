"""What a robot runs that has nothing but Python 3.8 and numpy: from scan, odometry and bumper to two speeds.

These modules import the standard library, numpy and each other, by relative imports, and no name at the top of one
stands at the top of another: so they can be packed into one file.
"""
