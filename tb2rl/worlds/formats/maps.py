"""Occupancy maps of ROS (map_server): a YAML file beside an image, read as boxes; and worlds written as such maps.

The meaning of a cell follows map_server's own image loader (http://wiki.ros.org/map_server). The YAML file may
have the keys `start` and `goal`, too, which map_server ignores.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from annotated_types import Ge, Le, MinLen
from PIL import Image

from tb2rl.core.errors import InputError, WorldWarning, one_line
from tb2rl.core.files import replacing, write_text
from tb2rl.core.values import Fraction, Pose, Positive, build
from tb2rl.worlds.formats.cells import merge_cells, occupied_cells
from tb2rl.worlds.formats.imports import Goal, ImportOptions, complete_world
from tb2rl.worlds.world import World

MOST_CELLS = 4_000_000  # 2 000 x 2 000 cells: 100 x 100 m at the usual resolution
_MOST_BOXES = 20_000  # noise makes more; a map of a campus makes 3 000
_FREE, _OCCUPIED = 254, 0  # the greys that map_server's own saver writes
_DECIMALS = 9  # of an origin [m]: enough for any map, and no 0.30000000000000004


@dataclass(frozen=True)
class OccupancyMap:
    """Keys of a map's YAML file.

    Attributes:
        image: File beside the YAML file; its rows run from top to bottom.
        resolution: Side of a cell [m].
        origin: Pose of the lower left corner of the lower left cell: x [m], y [m], yaw [rad].
        negate: Whether white is occupied and black free.
        occupied_thresh: Cells with a higher occupancy are occupied.
        free_thresh: Cells with a lower occupancy are free; all others are unknown.
        mode: "trinary" and "scale" take (255 - grey) / 255 as the occupancy of a cell, "raw" takes grey / 100, which is
            unknown above 1. In "scale", transparent cells are unknown; in "trinary", alpha counts as a colour.
        start: x [m], y [m], yaw [rad]; ours, not map_server's, as is the next one.
        goal: x [m], y [m], and yaw [rad] or nothing.
    """

    image: Annotated[str, MinLen(1)]
    resolution: Annotated[Positive, Le(100.0)]
    origin: Pose = (0.0, 0.0, 0.0)
    negate: Annotated[int, Ge(0), Le(1)] = 0
    occupied_thresh: Fraction = 0.65
    free_thresh: Fraction = 0.196
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    start: Pose | None = None
    goal: Goal = None


def is_map(content: Any) -> bool:
    """Whether the content of a YAML file is a map, and not a world of ours."""
    return isinstance(content, Mapping) and "image" in content


def read_map(path: Path, content: Mapping[str, Any], options: ImportOptions) -> World:
    """Make a world from a map's YAML file and its content.

    Unknown cells are obstacles, unless `options.unknown` is "free". The edge of the map is no wall.

    Raises:
        InputError: If the content does not fit `OccupancyMap`, the image cannot be read, or that is no world.
    """
    name, known = path.stem, {field.name for field in fields(OccupancyMap)}
    if others := [str(key) for key in content if key not in known]:
        text = f"map {name}: keys that are not understood: {', '.join(others)}"
        warnings.warn(one_line(text), WorldWarning, stacklevel=2)
    described = build(OccupancyMap, {key: content[key] for key in content if key in known}, f"map {name}")
    if described.free_thresh > described.occupied_thresh:
        raise InputError(f"map {name}: free_thresh must be at most occupied_thresh, got {described.free_thresh}")
    occupancy = _occupancy(_read_image(path.parent / described.image), described)
    cells = occupancy > described.occupied_thresh
    if options.unknown == "obstacle":
        cells = ~(occupancy < described.free_thresh)  # so that NaN is an obstacle, too
    cells = cells[::-1]
    steps = (np.count_nonzero(np.diff(cells, axis=axis) & np.delete(cells, 0, axis)) for axis in (0, 1))
    if min(steps) > _MOST_BOXES:
        raise InputError(f"map {name}: its cells make more than {_MOST_BOXES} obstacles, the limit")
    boxes = merge_cells(cells, described.resolution, described.origin)
    options = replace(options, start=options.start or described.start, goal=options.goal or described.goal)
    about = f"a map of {cells.shape[1]} x {cells.shape[0]} cells of {described.resolution:g} m"
    return complete_world(name, boxes, [], options, bounds=_bounds(cells, described), description=about)


def _read_image(path: Path) -> np.ndarray:
    """Channels of an image from 0 to 255, shape (rows, columns, channels), the top row first."""
    try:
        if not path.is_file():  # a pipe or a device would never end
            raise InputError(one_line(f"there is no picture {path}"))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit below is lower
            with Image.open(path, formats=("PPM", "PNG", "BMP", "JPEG", "TIFF")) as picture:
                if picture.width * picture.height > MOST_CELLS:
                    size = f"{picture.width} x {picture.height}"
                    raise InputError(f"{path} is too large: {size} cells, the limit is {MOST_CELLS} in all")
                return _channels(picture)
    except InputError:
        raise
    except Exception as error:  # any error that a broken image causes: Pillow raises SyntaxError, struct.error and more
        raise InputError(one_line(f"cannot read the picture {path}: {error}")) from None


def _channels(picture: Image.Image) -> np.ndarray:
    if picture.mode.startswith("I"):  # 16 bits
        return np.asarray(picture, dtype=float)[:, :, None] / 257.0
    if picture.mode not in ("L", "LA", "RGB", "RGBA"):  # a palette, or one bit
        picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
    pixels = np.asarray(picture)
    return pixels[:, :, None] if pixels.ndim == 2 else pixels


def _occupancy(pixels: np.ndarray, described: OccupancyMap) -> np.ndarray:
    """Occupancy of each cell from 0 to 1, NaN for unknown cells; shape (rows, columns)."""
    colours = pixels.shape[2] - (pixels.shape[2] in (2, 4))
    averaged = pixels if described.mode == "trinary" else pixels[:, :, :colours]
    grey = averaged.mean(axis=2, dtype=float)
    if described.negate:
        grey = 255.0 - grey
    if described.mode == "raw":
        return np.where(grey <= 100.0, grey / 100.0, np.nan)
    occupancy = (255.0 - grey) / 255.0
    if described.mode == "scale" and colours < pixels.shape[2]:
        occupancy[pixels[:, :, -1] < 255] = np.nan
    return occupancy


def _bounds(cells: np.ndarray, described: OccupancyMap) -> tuple[float, float, float, float]:
    """Bounds of a map, which may be turned."""
    x, y, yaw = described.origin
    along, up = cells.shape[1] * described.resolution, cells.shape[0] * described.resolution
    cos, sin = math.cos(yaw), math.sin(yaw)
    east = [0.0, along * cos, -up * sin, along * cos - up * sin]
    north = [0.0, along * sin, up * cos, along * sin + up * cos]
    return x + min(east), y + min(north), x + max(east), y + max(north)


def write_map(world: World, path: Path, resolution: float = 0.05) -> tuple[Path, Path]:
    """Write a world as a map for map_server and RViz: a YAML file, and a PGM image beside it.

    A map that is read and written again gives the same files. Walls thinner than a cell are a cell thick.

    Args:
        world: The world; its bounds are the edges of the map.
        path: The YAML file or the image; the other one has the other ending.
        resolution: Side of a cell [m].

    Returns:
        The YAML file and the image.

    Raises:
        InputError: If the map would have more than `MOST_CELLS` cells.
        OSError: If the files cannot be written.
    """
    x0, y0, x1, y1 = world.bounds
    if not (resolution > 0 and (x1 - x0) * (y1 - y0) / resolution**2 <= MOST_CELLS):
        raise InputError(f"a map of {world.name} in cells of {resolution:g} m has more than {MOST_CELLS} cells")
    if world.dynamic_obstacles:
        text = f"world {world.name}: a map holds static obstacles only; its dynamic obstacles are left out"
        warnings.warn(one_line(text), WorldWarning, stacklevel=2)
    cells = occupied_cells(world, resolution)[::-1]
    settings, picture = path.with_suffix(".yaml"), path.with_suffix(".pgm")
    header = f"P5\n# {resolution:g} m/pix\n{cells.shape[1]} {cells.shape[0]}\n255\n".encode()
    with replacing(picture) as temporary:
        temporary.write_bytes(header + np.where(cells, _OCCUPIED, _FREE).astype(np.uint8).tobytes())
    content = {
        "image": picture.name,
        "mode": "trinary",
        "resolution": resolution,
        "origin": [round(float(x0), _DECIMALS), round(float(y0), _DECIMALS), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        "start": [float(value) for value in world.start],
        **({"goal": [float(value) for value in world.goal]} if world.goal else {}),
    }
    write_text(settings, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
    return settings, picture
