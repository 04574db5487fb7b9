"""What stands where: the world that a robot is in, the files that worlds are read from, and the geometry of both.

A new file format is a function from a path to a `World` (see README.md). Imported from here: robots, and what all need.
"""

from tb2rl.worlds.world import World

__all__ = ["World"]
