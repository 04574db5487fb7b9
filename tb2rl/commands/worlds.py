"""Implementation of `python -m tb2rl.worlds`: list, draw, convert and check worlds."""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from tb2rl.core import InputError, one_line
from tb2rl.core.files import atomic_write, parse_yaml
from tb2rl.core.values import Worlds, checked
from tb2rl.envs.worlds import find_worlds, paths_in
from tb2rl.rendering.above import add_header, draw_floor_plan, floor_plan_legend, make_grid
from tb2rl.robots import Robot
from tb2rl.robots.robot import find_robot
from tb2rl.worlds import World
from tb2rl.worlds.description import write_description
from tb2rl.worlds.formats.maps import write_map
from tb2rl.worlds.generators import GENERATORS
from tb2rl.worlds.reachability import Reachability, find_reachability
from tb2rl.worlds.registry import find_world, source_files, world_names

_MAX_DRAWN = 64  # maximum number of worlds in a picture
_DIFFICULTIES = (0.0, 0.25, 0.5, 0.75, 1.0)  # columns in the picture of a generator
_MIN_ROWS = 4  # minimum number of rows in the picture of a generator
_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff")
_MAX_LISTED = 8  # maximum number of regions or doors in a line of output


def run(options: argparse.Namespace) -> None:
    """Run the chosen action."""
    {"list": _list, "draw": _draw, "convert": _convert, "check": _check}[options.action](options)


def _list(options: argparse.Namespace) -> None:
    for name in world_names():
        print(f"{name:12} {find_world(name).description}".rstrip())
    print(f"generators: {', '.join(sorted(GENERATORS))}")


def _draw(options: argparse.Namespace) -> None:
    robot, suffix = find_robot(options.robot), options.out.suffix.lower()
    if suffix not in _PICTURE_SUFFIXES:
        raise InputError(one_line(f"cannot write {options.out}; pictures end in {', '.join(_PICTURE_SUFFIXES)}"))
    settings, columns = _settings(options), None
    if len(settings) == 1 and settings[0] in list(GENERATORS.keys() - world_names()):  # list: a dict has no hash
        worlds, columns = _worlds_by_difficulty(settings[0]), len(_DIFFICULTIES)
    else:
        worlds = [world for setting in settings for world in find_worlds(setting)]
    if len(worlds) > _MAX_DRAWN:
        print(f"{len(worlds)} worlds; the first {_MAX_DRAWN} are drawn")
        del worlds[_MAX_DRAWN:]
    titles = [f"{world.name}, {_size(world)}" for world in worlds]
    grid = make_grid([draw_floor_plan(world, robot) for world in worlds], titles, columns)
    title = titles[0] if len(worlds) == 1 else f"{len(worlds)} worlds: {', '.join(map(str, settings))}"
    picture = add_header(grid, one_line(title), floor_plan_legend(worlds, robot))
    with atomic_write(options.out) as temporary:
        Image.fromarray(picture).save(temporary, format=Image.registered_extensions()[suffix])
    print(f"wrote {options.out}")


def _convert(options: argparse.Namespace) -> None:
    (setting,), out = _settings(options), options.out
    world, yaml_file = only_world(setting, "convert"), out.with_suffix(".yaml") if out.suffix == ".pgm" else out
    sources = [source for name in paths_in(setting) if Path(name).is_file() for source in _sources(Path(name))]
    for target in (out, yaml_file):
        if target.resolve() in sources:
            raise InputError(one_line(f"{target} is the source of the world; name another output file"))
    if yaml_file.is_file() and out.resolve() not in _sources(yaml_file):
        raise InputError(one_line(f"{yaml_file} exists and is not the map of {out}; name another output file"))
    if out.suffix == ".pgm":
        write_map(world, out, options.resolution)
    elif out.suffix in (".yaml", ".yml"):
        write_description(world, out)
    else:
        raise InputError(one_line(f"cannot write {out}; name a .yaml file (world description) or a .pgm file (map)"))
    for file in dict.fromkeys((out, yaml_file)):
        print(f"wrote {file}")


def _sources(file: Path) -> list[Path]:
    """Resolved paths of all files that define the world of a file."""
    return [source.resolve() for source in source_files(file)]


def _check(options: argparse.Namespace) -> None:
    (setting,), robot = _settings(options), find_robot(options.robot)
    world = only_world(setting, "check")
    print(f"{world.name}: {_size(world)}, {len(world.boxes)} boxes, {len(world.posts)} posts")
    print(*_describe_reachability(find_reachability(world, robot.radius), world, robot), sep="\n")


def _describe_reachability(found: Reachability, world: World, robot: Robot) -> Iterator[str]:
    """Lines of output: what the robot can reach, and why it cannot reach the rest."""
    name = f"{robot.name} ({2 * robot.radius:.3f} m wide)"
    areas = f"{found.reachable_area:.1f} of {found.floor_area:.1f} m2"
    yield f"{name} reaches {found.reachable_area / found.floor_area:.0%} of the floor, {areas}, from {_at(world.start)}"
    if found.doors:
        doors = [f"{door.width:.4f} m at {_at(door.centre)}" for door in found.doors]
        yield f"doors narrower than the robot ({2 * robot.radius:.4f} m): {_join(doors)}"
    for closed, reason in ((False, "behind passages that are too narrow"), (True, "closed on all sides")):
        regions = [f"{r.area:.1f} m2 at {_at(r.point)}" for r in found.unreachable if r.closed == closed]
        if regions:
            yield f"unreachable floor, {reason}: {_join(regions)}"
    if world.goal is not None:
        yield f"the goal {_at(world.goal)} can{'' if found.goal_is_reachable else 'not'} be reached"


def _size(world: World) -> str:
    x0, y0, x1, y1 = world.bounds
    return f"{x1 - x0:.4g} x {y1 - y0:.4g} m"


def _join(items: list[str]) -> str:
    more = f" and {len(items) - _MAX_LISTED} more" if len(items) > _MAX_LISTED else ""
    return ", ".join(items[:_MAX_LISTED]) + more


def _at(point: tuple[float, ...]) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"


def _settings(options: argparse.Namespace) -> list[Any]:
    """Values for `task.world`: the worlds of the command line, changed by its options."""
    keys = ("start", "goal", "unknown", "laser_height", "model_path")
    changes = {key: getattr(options, key) for key in keys if getattr(options, key) is not None}
    settings = [parse_yaml(name, "the world") if name[:1] in "{[" else name for name in options.worlds]
    if changes:
        settings = [{**(s if isinstance(s, Mapping) else {"file": s}), **changes} for s in settings]
    return [checked(Worlds, setting, "the world") for setting in settings]


def only_world(setting: Any, where: str) -> World:
    """The single world of a setting; if it has several, the `InputError` mentions the argument `where`."""
    world, *others = find_worlds(checked(Worlds, setting, where))
    if others:
        raise InputError(f"{where} takes one world, got {len(others) + 1}")
    return world


def _worlds_by_difficulty(name: str) -> list[World]:
    """Worlds of a generator, row by row, with a column for each difficulty and at least one row for each family."""
    rows = max(_MIN_ROWS, len(GENERATORS[name]))
    columns = []
    for difficulty in _DIFFICULTIES:
        worlds = find_worlds({"generator": name, "worlds": rows, "difficulty": difficulty})
        columns.append([replace(world, name=f"{world.name}, difficulty {difficulty:g}") for world in worlds])
    return [world for row in zip(*columns, strict=True) for world in row]
