"""Import options, and the completion of worlds from foreign formats."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from pydantic import BeforeValidator

from tb2rl.core.errors import InputError, WorldWarning, one_line
from tb2rl.core.values import Pose, Positive
from tb2rl.worlds.world import Bounds, BoxShape, PostShape, World

_OPEN_MARGIN = 5.0  # [m] of floor on each side of a world without bounds and outer walls
_MARGIN = 1.0  # [m] of floor around a start or a goal outside the bounding box of the obstacles
_DOOR_RADIUS = 0.15  # [m] gaps below twice this radius are too narrow for a robot and count as closed
_START_CLEARANCE = 0.6  # [m] default `start_clearance` of tasks
_ARC_SEGMENTS = 8  # segments of a quarter circle; the error of a post of 0.2 m is 2 mm
_MAX_OBSTACLES = 20_000  # limit of a world; a map of a campus has 3 000 obstacles, a noisy map can have too many
_MAX_OVERLAPS = 1_000_000  # overlapping pairs of obstacles; a union with more overlaps is slow
_SAMPLE_SIZE = 500  # number of shapes from which the overlaps are estimated


def _with_heading(value: Any) -> Any:
    return (*value, 0.0) if isinstance(value, list | tuple) and len(value) == 2 else value


Goal = Annotated[Pose | None, BeforeValidator(_with_heading)]


@dataclass(frozen=True)
class ImportOptions:
    """Settings that take precedence over a world file.

    Attributes:
        start: x [m], y [m], yaw [rad]; None: the start in the file. Without one, maps and SDF worlds take the point
            farthest from all walls; other files need a start.
        goal: x [m], y [m] and optionally yaw [rad]; None: the goal of the file, if there is one.
        bounds: Rectangle of the world; None: that of the file or map, else the bounding box of the obstacles (in SDF
            worlds, of start and goal, too).
        unknown: Meaning of a map's unknown cells.
        laser_height: Height at which the shapes of an SDF world are cut [m].
        model_path: Folders of SDF models, searched before those of environment variables.
    """

    start: Pose | None = None
    goal: Goal = None
    bounds: Bounds | None = None
    unknown: Literal["obstacle", "free"] = "obstacle"
    laser_height: Positive = 0.25  # [m] height at which Gazebo shapes are cut; the default is half the height of walls
    model_path: tuple[str, ...] = ()


def complete_world(
    name: str,
    boxes: Sequence[BoxShape],
    posts: Sequence[PostShape],
    options: ImportOptions,
    *,
    bounds: Bounds | None = None,
    description: str = "",
) -> World:
    """Make a world from the shapes of a file, with a warning if a start must be chosen.

    Args:
        name, boxes, posts, description: See `World.from_shapes`.
        options: Import options, in which a start and a goal of the file replace those that the user left out.
        bounds: Bounds of the file; None: the bounding box of obstacles, start and goal.

    Raises:
        InputError: If a value is invalid, or no start can be found.
    """
    if len(boxes) + len(posts) > _MAX_OBSTACLES:
        raise InputError(f"world {name} has {len(boxes) + len(posts)} obstacles, the limit is {_MAX_OBSTACLES}")
    bounds = options.bounds or bounds
    initial_bounds = bounds or (None if boxes or posts else (-_OPEN_MARGIN, -_OPEN_MARGIN, _OPEN_MARGIN, _OPEN_MARGIN))
    world = World.from_shapes(name, boxes, posts, start=(0.0, 0.0, 0.0), bounds=initial_bounds, description=description)
    x0, y0, x1, y1 = world.bounds
    for pose in (options.start, options.goal):
        if bounds is None and pose is not None and not (x0 <= pose[0] <= x1 and y0 <= pose[1] <= y1):
            x0, y0 = min(x0, pose[0] - _MARGIN), min(y0, pose[1] - _MARGIN)
            x1, y1 = max(x1, pose[0] + _MARGIN), max(y1, pose[1] + _MARGIN)
    start = options.start or _farthest_from_walls(world)
    if start is None and bounds is None:  # a single wall or post fills its bounding box
        x0, y0, x1, y1 = x0 - _OPEN_MARGIN, y0 - _OPEN_MARGIN, x1 + _OPEN_MARGIN, y1 + _OPEN_MARGIN
        start = _farthest_from_walls(replace(world, bounds=(x0, y0, x1, y1)))
    if start is None:
        raise InputError(f"world {name}: there is no free floor for a start")
    if options.start is None:
        start_text = f"[{start[0]:g}, {start[1]:g}, 0]"
        warn(f"world {name}: no start is given, so the start is {start_text}, the point farthest from all walls")
    return replace(world, start=start, goal=options.goal, bounds=(x0, y0, x1, y1))


def mean_overlaps(shapes: np.ndarray) -> float:
    """Mean number of bounding boxes that the bounding box of a shape overlaps, estimated from a sample."""
    sample = np.random.default_rng(0).permutation(shapes)[:_SAMPLE_SIZE]
    return shapely.STRtree(shapes).query(sample).shape[1] / max(len(sample), 1)


def _farthest_from_walls(world: World) -> Pose | None:
    """Point farthest from all walls, preferably in an enclosed room; None without free floor."""
    outlines = world.outlines(_DOOR_RADIUS, _ARC_SEGMENTS)
    if mean_overlaps(outlines) * len(outlines) > _MAX_OVERLAPS:
        raise InputError(f"world {world.name}: its obstacles overlap too often to find a start; set one")
    enlarged_bounds = shapely.box(*world.bounds).buffer(_MARGIN, join_style="mitre")
    rooms = shapely.get_parts(enlarged_bounds.difference(shapely.disjoint_subset_union_all(outlines)))
    is_enclosed = ~shapely.intersects(rooms, enlarged_bounds.exterior)  # all others extend to the outside
    rooms, indices = shapely.get_parts(shapely.intersection(rooms, shapely.box(*world.bounds)), return_index=True)
    rooms, is_enclosed = rooms[shapely.area(rooms) > 0], is_enclosed[indices][shapely.area(rooms) > 0]
    if len(rooms) == 0:
        return None
    circles = shapely.maximum_inscribed_circle(rooms, tolerance=0.01)  # lines from centre to boundary
    radii = shapely.length(circles)
    is_indoors = is_enclosed & (radii > _START_CLEARANCE - _DOOR_RADIUS)
    x, y = circles[np.where(is_indoors if is_indoors.any() else True, radii, -1.0).argmax()].coords[0]
    return round(x, 3) + 0.0, round(y, 3) + 0.0, 0.0  # + 0.0: no -0


def warn(text: str) -> None:
    """Issue a `WorldWarning` of one line."""
    warnings.warn(one_line(text, 4000), WorldWarning, stacklevel=3)
