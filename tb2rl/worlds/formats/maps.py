"""Reads and writes ROS occupancy maps: a YAML file and an image, as in map_server.

Occupancy follows the image loader of map_server (http://wiki.ros.org/map_server). The YAML file may also have the keys
`start` and `goal`, which map_server ignores.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from annotated_types import Ge, Le, MinLen
from PIL import Image

from tb2rl.core import InputError, one_line, write_text
from tb2rl.core.files import atomic_write
from tb2rl.core.values import Fraction, Pose, Positive, build
from tb2rl.worlds.formats.imports import Goal, ImportOptions, complete_world, warn
from tb2rl.worlds.occupancy_grid import merge_cells, occupied_cells
from tb2rl.worlds.world import Bounds, World

MAX_CELLS = 4_000_000  # 2 000 x 2 000 cells: 100 x 100 m at a resolution of 0.05 m


@dataclass(frozen=True, kw_only=True)
class MapSettings:
    """Keys of a map's YAML file, as in map_server, and `start` and `goal`.

    Attributes:
        image: Image file, relative to the YAML file; its first row is the top.
        mode: Occupancy is (255 - grey) / 255 in "trinary" and "scale". In "trinary", alpha is averaged like a colour.
            In "scale", transparent cells are unknown. In "raw", occupancy is grey / 100, and unknown above 1.
        resolution: Side of a cell [m].
        origin: Pose of the lower left corner of the lower left cell: x [m], y [m], yaw [rad].
        negate: Whether white is occupied and black free.
        occupied_thresh: Cells with a higher occupancy are occupied.
        free_thresh: Cells with a lower occupancy are free; all others are unknown.
    """

    image: Annotated[str, MinLen(1)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    resolution: Annotated[Positive, Le(100.0)]
    origin: Pose = (0.0, 0.0, 0.0)
    negate: Annotated[int, Ge(0), Le(1)] = 0
    occupied_thresh: Fraction = 0.65
    free_thresh: Fraction = 0.196
    start: Pose | None = None
    goal: Goal = None


def read_map(path: Path, content: Mapping[str, Any], options: ImportOptions) -> World:
    """Make a world from the content of a map's YAML file.

    Unknown cells are obstacles, unless `options.unknown` is "free". The edge of a map is no wall.

    Raises:
        InputError: If a key has an invalid value, the image cannot be read, or the world is invalid.
    """
    name, keys = path.stem, {field.name for field in fields(MapSettings)}
    if unknown_keys := [str(key) for key in content if key not in keys]:
        warn(f"map {name}: unknown keys: {', '.join(unknown_keys)}")
    settings = build(MapSettings, {key: content[key] for key in content if key in keys}, f"map {name}")
    if settings.free_thresh > settings.occupied_thresh:
        raise InputError(f"map {name}: free_thresh must be at most occupied_thresh, got {settings.free_thresh}")
    occupancy = _occupancy(_read_image(path.parent / settings.image), settings)[::-1]
    # `~(... < free_thresh)` instead of `>= free_thresh`, so that NaN (unknown) is an obstacle, too.
    cells = occupancy > settings.occupied_thresh if options.unknown == "free" else ~(occupancy < settings.free_thresh)
    boxes = merge_cells(cells, settings.resolution, settings.origin)
    options = replace(options, start=options.start or settings.start, goal=options.goal or settings.goal)
    description = f"a map of {cells.shape[1]} x {cells.shape[0]} cells of {settings.resolution:g} m"
    return complete_world(name, boxes, [], options, bounds=_bounds(cells, settings), description=description)


def _read_image(path: Path) -> np.ndarray:
    """Channels of an image from 0 to 255, shape (rows, columns, channels); row 0 is the top."""
    try:
        if not path.is_file():  # reading a pipe or a device might never end
            raise FileNotFoundError("there is no such file")
        with Image.open(path, formats=("PPM", "PNG", "BMP", "JPEG", "TIFF")) as picture:
            if picture.width * picture.height > MAX_CELLS:
                raise ValueError(f"{picture.width} x {picture.height} cells are more than {MAX_CELLS}")
            return _channels(picture)
    except Exception as error:  # any error that a broken image causes: Pillow raises SyntaxError, struct.error and more
        raise InputError(one_line(f"cannot read the picture {path}: {error}")) from None


def _channels(picture: Image.Image) -> np.ndarray:
    if picture.mode.startswith("I"):  # 16 bits
        return np.atleast_3d(np.asarray(picture)) / 257.0
    if picture.mode not in ("L", "LA", "RGB", "RGBA"):  # a palette, or one bit
        picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
    return np.atleast_3d(np.asarray(picture))


def _occupancy(pixels: np.ndarray, settings: MapSettings) -> np.ndarray:
    """Occupancy of each cell from 0 to 1, NaN for unknown cells; shape (rows, columns)."""
    colour_count = pixels.shape[2] - (pixels.shape[2] in (2, 4))
    channels = pixels if settings.mode == "trinary" else pixels[:, :, :colour_count]
    grey = channels.mean(axis=2, dtype=float)
    if settings.negate:
        grey = 255.0 - grey
    if settings.mode == "raw":
        return np.where(grey <= 100.0, grey / 100.0, np.nan)
    occupancy = (255.0 - grey) / 255.0
    if settings.mode == "scale" and colour_count < pixels.shape[2]:
        occupancy[pixels[:, :, -1] < 255] = np.nan
    return occupancy


def _bounds(cells: np.ndarray, settings: MapSettings) -> Bounds:
    """Bounds of a map, which may be rotated."""
    x, y, yaw = settings.origin
    width, height = cells.shape[1] * settings.resolution, cells.shape[0] * settings.resolution
    cos, sin = math.cos(yaw), math.sin(yaw)
    dx = [0.0, width * cos, -height * sin, width * cos - height * sin]  # of the corners
    dy = [0.0, width * sin, height * cos, width * sin + height * cos]
    return x + min(dx), y + min(dy), x + max(dx), y + max(dy)


def write_map(world: World, path: Path, resolution: float = 0.05) -> tuple[Path, Path]:
    """Write a world as a map for map_server and RViz, with cells of side `resolution` [m].

    A map that is read and written again gives the same files. Walls thinner than a cell are enlarged to one cell.

    Args:
        path: Path of the YAML file or of the PGM image; the other file differs in its extension.

    Returns:
        Paths of the YAML file and the image.

    Raises:
        InputError: If the map would have more than `MAX_CELLS` cells.
        OSError: If the files cannot be written.
    """
    x0, y0, x1, y1 = world.bounds
    if not (resolution > 0 and (x1 - x0) * (y1 - y0) / resolution**2 <= MAX_CELLS):
        raise InputError(f"a map of {world.name} in cells of {resolution:g} m has more than {MAX_CELLS} cells")
    if world.dynamic_obstacles:
        warn(f"world {world.name}: a map holds static obstacles only; its dynamic obstacles are left out")
    cells = occupied_cells(world, resolution)[::-1]
    yaml_path, image_path = path.with_suffix(".yaml"), path.with_suffix(".pgm")
    header = f"P5\n# {resolution:g} m/pix\n{cells.shape[1]} {cells.shape[0]}\n255\n".encode()
    with atomic_write(image_path) as temporary:
        temporary.write_bytes(header + np.where(cells, 0, 254).astype(np.uint8).tobytes())
    origin = round(float(x0), 9), round(float(y0), 9), 0.0  # without floating-point errors of sums
    content = asdict(MapSettings(image=image_path.name, resolution=resolution, origin=origin))
    content["start"] = [float(value) for value in world.start]
    content["goal"] = world.goal and [float(value) for value in world.goal]
    present = {key: value for key, value in content.items() if value is not None}
    write_text(yaml_path, yaml.safe_dump(present, sort_keys=False, default_flow_style=None))
    return yaml_path, image_path
