"""What `python -m tb2rl.worlds` does, see `tb2rl.worlds.__main__`: lists, draws, converts and checks worlds."""

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
from tb2rl.rendering.plan import draw_plan, sheet
from tb2rl.robots import Robot
from tb2rl.robots.registry import find_robot
from tb2rl.worlds import World
from tb2rl.worlds.access import Access, Door, find_access
from tb2rl.worlds.description import write_description
from tb2rl.worlds.formats.maps import write_map
from tb2rl.worlds.generators import GENERATORS, Generated, generate
from tb2rl.worlds.readers import files_of
from tb2rl.worlds.registry import find_world, world_names

_DRAWN = 64  # worlds on a sheet
_DIFFICULTIES, _EACH = (0.0, 0.25, 0.5, 0.75, 1.0), 4  # columns of a generator's sheet, and worlds in each, or more
_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff")  # Pillow knows more that fail
_SHOWN = 8  # parts and doors that are named one by one


def run(options: argparse.Namespace) -> None:
    """List, draw, convert or check."""
    {"list": _list, "draw": _draw, "convert": _convert, "check": _check}[options.what](options)


def _list(options: argparse.Namespace) -> None:
    for name in world_names():
        print(f"{name:12} {find_world(name).description}".rstrip())
    print(f"generators: {', '.join(sorted(GENERATORS))}")


def _draw(options: argparse.Namespace) -> None:
    robot = find_robot(options.robot)
    if options.out.suffix.lower() not in _PICTURES:
        raise InputError(one_line(f"cannot write {options.out}: pictures end in {', '.join(_PICTURES)}"))
    if not _said(options) and len(options.worlds) == 1 and _is_generator(options.worlds[0]):
        worlds, columns = _by_difficulty(options.worlds[0]), len(_DIFFICULTIES)
    else:
        worlds, columns = _worlds(options), None
    if len(worlds) > _DRAWN:
        print(f"{len(worlds)} worlds; the first {_DRAWN} are drawn")
    titles = [world.name for world in worlds[:_DRAWN]]
    picture = Image.fromarray(sheet([draw_plan(world, robot) for world in worlds[:_DRAWN]], titles, columns))
    with replacing(options.out) as temporary, temporary.open("wb") as file:
        picture.save(file, format=Image.registered_extensions()[options.out.suffix.lower()])
    print(f"wrote {options.out}")


def _convert(options: argparse.Namespace) -> None:
    world = _only_world(options)
    ending = options.out.suffix
    beside = options.out.with_suffix(".yaml") if ending == ".pgm" else options.out
    _check_source(options.worlds[0], {options.out, beside})
    if beside.is_file() and options.out.resolve() not in _files(beside):
        raise InputError(one_line(f"{beside} is there, and is no map with the picture {options.out}; name another one"))
    if ending == ".pgm":
        for file in reversed(write_map(world, options.out, options.resolution)):
            print(f"wrote {file}")
    elif ending in (".yaml", ".yml"):
        write_description(world, options.out)
        print(f"wrote {options.out}")
    else:
        raise InputError(one_line(f"cannot write {options.out}: it ends in .yaml (a world of ours) or .pgm (a map)"))


def _check(options: argparse.Namespace) -> None:
    world = _only_world(options)
    robot = find_robot(options.robot)
    x0, y0, x1, y1 = world.bounds
    print(f"{world.name}: {x1 - x0:.4g} x {y1 - y0:.4g} m, {len(world.boxes)} boxes, {len(world.posts)} posts")
    for line in _findings(find_access(world, robot.radius), world, robot):
        print(line)


def _findings(access: Access, world: World, robot: Robot) -> list[str]:
    """What a check says, one thing a line."""
    share = access.reached / access.floor
    size = f"{robot.name} ({2 * robot.radius:.3f} m wide)"
    areas = f"{access.reached:.1f} of {access.floor:.1f} m2"
    lines = [f"{size} reaches {share:.0%} of the floor, {areas}, from {_at(world.start)}"]
    if access.doors:
        doors = [f"{_width(door, robot)} at {_at(door.place)}" for door in access.doors]
        are = "door is" if len(doors) == 1 else "doors are"
        lines.append(f"{len(doors)} {are} narrower than the robot: {_listed(doors)}")
    for closed, why in ((False, "behind ways that are too narrow"), (True, "closed on all sides")):
        parts = [f"{part.area:.1f} m2 at {_at(part.place)}" for part in access.parts if part.closed == closed]
        if parts:
            are = "part of the floor cannot be" if len(parts) == 1 else "parts of the floor cannot be"
            lines.append(f"{len(parts)} {are} reached, {why}: {_listed(parts)}")
    if world.goal is not None:
        lines.append(f"the goal {_at(world.goal)} can{'' if access.goal_reached else 'not'} be reached")
    return lines


def _width(door: Door, robot: Robot) -> str:
    """The width of a door, in tenths of a millimetre where it looks like that of the robot."""
    found, needed = f"{door.width:.3f}", f"{2 * robot.radius:.3f}"
    return f"{found} m" if found != needed else f"{door.width:.4f} m (the robot needs {2 * robot.radius:.4f} m)"


def _listed(things: list[str]) -> str:
    more = f" and {len(things) - _SHOWN} more" if len(things) > _SHOWN else ""
    return ", ".join(things[:_SHOWN]) + more


def _at(place: tuple[float, ...]) -> str:
    return f"({place[0]:.2f}, {place[1]:.2f})"


def _worlds(options: argparse.Namespace) -> list[World]:
    """The worlds that the command line names, with what it says about them."""
    said = _said(options)
    return [world for name in options.worlds for world in find_worlds(_setting(name, said))]


def _said(options: argparse.Namespace) -> dict[str, Any]:
    """What the command line says beside the names."""
    keys = ("start", "goal", "unknown", "laser_height", "model_path")
    return {key: value for key in keys if (value := getattr(options, key)) is not None}


def _only_world(options: argparse.Namespace) -> World:
    """The world of a command that takes one."""
    world, *more = _worlds(options)
    if more:
        text = f"{options.what} takes one world, and {options.worlds[0]} is {len(more) + 1}"
        raise InputError(one_line(text))
    return world


def _setting(name: str, said: Mapping[str, Any]) -> Any:
    """What the command line names and says, as `task.world` takes it."""
    setting = parse_yaml(name, "the world") if name[:1] in "{[" else name
    if said:
        setting = {**(setting if isinstance(setting, Mapping) else {"file": setting}), **said}
    return checked(Worlds, setting, "the world")


def _check_source(name: str, targets: set[Path]) -> None:
    """Raise an `InputError` if a file that is to be written is one that the world is read from."""
    setting = absolute_worlds(_setting(name, {"file": name} if name[:1] not in "{[" else {}))
    file = Path(setting["file"].rpartition(":")[2]) if isinstance(setting, Mapping) and "file" in setting else Path()
    sources = _files(file) if file.is_file() else []
    for target in targets:
        if target.resolve() in sources:
            raise InputError(one_line(f"{target} is what the world is read from; write it to another file"))


def _files(file: Path) -> list[Path]:
    return [each.resolve() for each in files_of(file)]


def _is_generator(name: str) -> bool:
    return name in GENERATORS and name not in world_names()


def _by_difficulty(name: str) -> list[World]:
    """Some worlds of a generator, for a sheet with a column for each difficulty."""
    columns, each = [], max(_EACH, len(GENERATORS[name]))  # one world of each family at least
    for difficulty in _DIFFICULTIES:
        settings = Generated(name, worlds=each, difficulty=(difficulty, difficulty))
        worlds = generate(settings, GENERATORS[name], "training")
        columns.append([replace(world, name=f"{world.name}, {difficulty:g}") for world in worlds])
    return [world for row in zip(*columns, strict=True) for world in row]
