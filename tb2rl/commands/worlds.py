"""Implementation of `python -m tb2rl.worlds`, see `tb2rl.worlds.__main__`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import parse_yaml, replacing
from tb2rl.core.values import Worlds, checked
from tb2rl.envs.worlds import absolute_worlds, find_worlds
from tb2rl.rendering.plan import draw_plan, make_grid
from tb2rl.robots import Robot
from tb2rl.robots.registry import find_robot
from tb2rl.worlds import World
from tb2rl.worlds.description import write_description
from tb2rl.worlds.formats.maps import write_map
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate
from tb2rl.worlds.reachability import Door, Reachability, find_reachability
from tb2rl.worlds.readers import source_files
from tb2rl.worlds.registry import find_world, world_names

_DRAWN = 64  # worlds in a picture
_DIFFICULTIES, _EACH = (0.0, 0.25, 0.5, 0.75, 1.0), 4  # columns of a generator's picture, and least worlds in each
_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff")  # Pillow knows more that fail
_SHOWN = 8  # regions and doors that are listed one by one


def run(options: argparse.Namespace) -> None:
    """Run the action that the command line names."""
    {"list": _list, "draw": _draw, "convert": _convert, "check": _check}[options.action](options)


def _list(options: argparse.Namespace) -> None:
    for name in world_names():
        print(f"{name:12} {find_world(name).description}".rstrip())
    print(f"generators: {', '.join(sorted(GENERATORS))}")


def _draw(options: argparse.Namespace) -> None:
    robot, ending = find_robot(options.robot), options.out.suffix.lower()
    if ending not in _PICTURES:
        raise InputError(one_line(f"cannot write {options.out}: pictures end in {', '.join(_PICTURES)}"))
    (name, *others), columns = options.worlds, None
    if not others and not _import_settings(options) and name in GENERATORS and name not in world_names():
        worlds, columns = _by_difficulty(name), len(_DIFFICULTIES)
    else:
        worlds = _worlds(options)
    if len(worlds) > _DRAWN:
        print(f"{len(worlds)} worlds; the first {_DRAWN} are drawn")
    titles = [world.name for world in worlds[:_DRAWN]]
    picture = Image.fromarray(make_grid([draw_plan(world, robot) for world in worlds[:_DRAWN]], titles, columns))
    with replacing(options.out) as temporary, temporary.open("wb") as file:
        picture.save(file, format=Image.registered_extensions()[ending])
    print(f"wrote {options.out}")


def _convert(options: argparse.Namespace) -> None:
    world, out = _only_world(options), options.out
    settings = out.with_suffix(".yaml") if out.suffix == ".pgm" else out
    sources = _sources(options.worlds[0])
    for target in (out, settings):
        if target.resolve() in sources:
            raise InputError(one_line(f"{target} is the source of the world; write it to another file"))
    if settings.is_file() and out.resolve() not in _files(settings):
        raise InputError(one_line(f"{settings} is there, and is no map with the picture {out}; name another one"))
    if out.suffix == ".pgm":
        for file in reversed(write_map(world, out, options.resolution)):
            print(f"wrote {file}")
    elif out.suffix in (".yaml", ".yml"):
        write_description(world, out)
        print(f"wrote {out}")
    else:
        raise InputError(one_line(f"cannot write {out}: it ends in .yaml (a world of ours) or .pgm (a map)"))


def _check(options: argparse.Namespace) -> None:
    world = _only_world(options)
    robot = find_robot(options.robot)
    x0, y0, x1, y1 = world.bounds
    print(f"{world.name}: {x1 - x0:.4g} x {y1 - y0:.4g} m, {len(world.boxes)} boxes, {len(world.posts)} posts")
    for line in _findings(find_reachability(world, robot.radius), world, robot):
        print(line)


def _findings(found: Reachability, world: World, robot: Robot) -> list[str]:
    """Lines of the output of `check`."""
    size = f"{robot.name} ({2 * robot.radius:.3f} m wide)"
    areas = f"{found.reached:.1f} of {found.floor:.1f} m2"
    lines = [f"{size} reaches {found.reached / found.floor:.0%} of the floor, {areas}, from {_at(world.start)}"]
    if found.doors:
        doors = [f"{_width(door, robot)} at {_at(door.place)}" for door in found.doors]
        are = "door is" if len(doors) == 1 else "doors are"
        lines.append(f"{len(doors)} {are} narrower than the robot: {_listed(doors)}")
    for closed, why in ((False, "behind passages that are too narrow"), (True, "closed on all sides")):
        parts = [f"{part.area:.1f} m2 at {_at(part.place)}" for part in found.unreached if part.closed == closed]
        if parts:
            are = "part of the floor cannot be" if len(parts) == 1 else "parts of the floor cannot be"
            lines.append(f"{len(parts)} {are} reached, {why}: {_listed(parts)}")
    if world.goal is not None:
        lines.append(f"the goal {_at(world.goal)} can{'' if found.goal_reached else 'not'} be reached")
    return lines


def _width(door: Door, robot: Robot) -> str:
    """The width of a door, in tenths of a millimetre where it would look like that of the robot."""
    found, needed = f"{door.width:.3f}", f"{2 * robot.radius:.3f}"
    return f"{found} m" if found != needed else f"{door.width:.4f} m (the robot needs {2 * robot.radius:.4f} m)"


def _listed(things: list[str]) -> str:
    more = f" and {len(things) - _SHOWN} more" if len(things) > _SHOWN else ""
    return ", ".join(things[:_SHOWN]) + more


def _at(place: tuple[float, ...]) -> str:
    return f"({place[0]:.2f}, {place[1]:.2f})"


def _worlds(options: argparse.Namespace) -> list[World]:
    """The worlds that the command line names, with its settings for imports."""
    settings = _import_settings(options)
    return [world for name in options.worlds for world in find_worlds(_setting(name, settings))]


def _import_settings(options: argparse.Namespace) -> dict[str, Any]:
    keys = ("start", "goal", "unknown", "laser_height", "model_path")
    return {key: value for key in keys if (value := getattr(options, key)) is not None}


def _only_world(options: argparse.Namespace) -> World:
    world, *more = _worlds(options)
    if more:
        text = f"{options.action} takes one world, and {options.worlds[0]} is {len(more) + 1}"
        raise InputError(one_line(text))
    return world


def _setting(name: str, settings: Mapping[str, Any]) -> Any:
    """A world's name and further settings as a value for `task.world`."""
    setting = parse_yaml(name, "the world") if name[:1] in "{[" else name
    if settings:
        setting = {**(setting if isinstance(setting, Mapping) else {"file": setting}), **settings}
    return checked(Worlds, setting, "the world")


def _sources(name: str) -> list[Path]:
    """The files that a world is read from."""
    setting = absolute_worlds(_setting(name, {"file": name} if name[:1] not in "{[" else {}))
    file = Path(setting["file"].rpartition(":")[2]) if isinstance(setting, Mapping) and "file" in setting else Path()
    return _files(file) if file.is_file() else []


def _files(file: Path) -> list[Path]:
    return [each.resolve() for each in source_files(file)]


def _by_difficulty(name: str) -> list[World]:
    """Worlds of a generator in rows, with a column for each difficulty."""
    columns, each = [], max(_EACH, len(GENERATORS[name]))  # at least one world of each family
    for difficulty in _DIFFICULTIES:
        settings = GeneratorSettings(name, worlds=each, difficulty=(difficulty, difficulty))
        worlds = generate(settings, GENERATORS[name], "training")
        columns.append([replace(world, name=f"{world.name}, {difficulty:g}") for world in worlds])
    return [world for row in zip(*columns, strict=True) for world in row]
