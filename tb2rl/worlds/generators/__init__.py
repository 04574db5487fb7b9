"""World generators, one file per family; README.md describes how to add one."""

from tb2rl.worlds.generators.cells import cells
from tb2rl.worlds.generators.circuit import circuit
from tb2rl.worlds.generators.clutter import clutter
from tb2rl.worlds.generators.generated import GeneratorSettings, Purpose, WorldMaker, generate, solvable, world_rng
from tb2rl.worlds.generators.maze import maze
from tb2rl.worlds.generators.offices import offices
from tb2rl.worlds.generators.rooms import rooms
from tb2rl.worlds.generators.tunnels import tunnels

FAMILIES: tuple[WorldMaker, ...] = (clutter, rooms, maze, cells, circuit)
GENERATORS: dict[str, tuple[WorldMaker, ...]] = {maker.__name__: (maker,) for maker in (*FAMILIES, offices, tunnels)}
GENERATORS["mixed"] = FAMILIES

__all__ = [
    "FAMILIES",
    "GENERATORS",
    "GeneratorSettings",
    "Purpose",
    "WorldMaker",
    "generate",
    "offices",
    "solvable",
    "tunnels",
    "world_rng",
]
