"""Generators of worlds, a file for each family; README.md says how to add one.

Imported from here: the world, its floor, and what all need.
"""

from tb2rl.worlds.generators.cells import cells
from tb2rl.worlds.generators.circuit import circuit
from tb2rl.worlds.generators.clutter import clutter
from tb2rl.worlds.generators.enclosure import solvable
from tb2rl.worlds.generators.generated import Generated, Maker, Purpose, generate, generator_of
from tb2rl.worlds.generators.maze import maze
from tb2rl.worlds.generators.rooms import rooms

FAMILIES: tuple[Maker, ...] = (clutter, rooms, maze, cells, circuit)
GENERATORS: dict[str, tuple[Maker, ...]] = {maker.__name__: (maker,) for maker in FAMILIES} | {"mixed": FAMILIES}

__all__ = ["FAMILIES", "GENERATORS", "Generated", "Maker", "Purpose", "generate", "generator_of", "solvable"]
