"""The worlds of the setting `task.world`: one, several, a folder of files, or generated ones."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import is_path
from tb2rl.core.values import MOST_WORLDS, build
from tb2rl.worlds import ImportOptions, World
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, Purpose, generate
from tb2rl.worlds.registry import MADE_BY_CODE, find_world, world_endings, world_maker, world_names

_NAMED = 3  # worlds that a title names one by one


def find_worlds(setting: Any, purpose: Purpose = "training") -> tuple[World, ...]:
    """The worlds of a task.

    Args:
        setting: A name that `find_world` takes, a generator's name, a folder, the settings of a generator, a file with
            `tb2rl.worlds.ImportOptions` ({file: my_map.yaml, start: [0, 0, 0]}), or a list of all these. A name of both
            a world and a generator (`maze`) is the world; `{generator: maze}` the generator.
        purpose: Of generated worlds; others are the same for every purpose.

    Raises:
        InputError: If there is no such world, or a setting does not fit.
    """
    if _carried and (brought := _carried.get(_key(setting))):
        return brought
    if isinstance(setting, Mapping) and "file" in setting:
        return (_of_file(setting),)
    if isinstance(setting, Mapping):
        return _generated(build(GeneratorSettings, setting, "task.world"), purpose)
    if not isinstance(setting, str):
        _check_number(setting)
        return tuple(world for entry in setting for world in find_worlds(entry, purpose))
    if _is_folder(setting):
        return tuple(map(find_world, _files_in(setting)))
    if setting in _generators():
        return _generated(GeneratorSettings(setting), purpose)
    if ":" not in setting and not is_path(setting) and setting not in world_names():
        raise unknown("world", setting, [*world_names(), *_generators()])
    return (find_world(setting),)


def _check_number(entries: Iterable[Any]) -> None:
    """Raise an `InputError` before any world is read if a list has too many worlds."""
    number = 0
    for entry in entries:
        number += _number(entry)
        if number > MOST_WORLDS:
            raise InputError(f"task.world is more than {MOST_WORLDS} worlds; name fewer")


def _number(entry: Any) -> int:
    """The number of worlds of an entry of a list."""
    if isinstance(entry, Mapping):
        return 1 if "file" in entry else build(GeneratorSettings, entry, "task.world").worlds
    if _is_folder(entry):
        return len(_files_in(entry))
    return GeneratorSettings.worlds if entry in _generators() else 1


def worlds_of_files(setting: Any) -> dict[str, tuple[World, ...]]:
    """The worlds of a setting that come from files, for `carry` on another machine."""
    if not isinstance(setting, str | Mapping):
        return {key: worlds for entry in setting for key, worlds in worlds_of_files(entry).items()}
    return {_key(setting): find_worlds(setting)} if list(files_named(setting)) else {}


def carry(worlds: Mapping[str, tuple[World, ...]]) -> None:
    """Let `find_worlds` find the worlds of `worlds_of_files` in this process, without their files."""
    _carried.update(worlds)


_carried: dict[str, tuple[World, ...]] = {}


def _key(setting: Any) -> str:
    return json.dumps(setting, sort_keys=True, default=list)


def absolute_worlds(setting: Any) -> Any:
    """The setting with absolute paths, so that a run finds its worlds from any folder."""
    if isinstance(setting, Mapping):
        if "file" not in setting:
            return setting
        folders = [str(Path(folder).resolve()) for folder in _import_options(setting).model_path if folder]
        return {**setting, "file": absolute_worlds(setting["file"]), **({"model_path": folders} if folders else {})}
    if not isinstance(setting, str):
        return tuple(map(absolute_worlds, setting))
    code = MADE_BY_CODE.fullmatch(setting)
    if code is not None:
        return setting if code[2] is None else f"{code[1]}:{Path(code[2]).resolve()}"
    is_file = is_path(setting) and os.path.isfile(setting)  # noqa: PTH113 (Path.is_file raises for a name that is too long)
    return str(Path(setting).resolve()) if is_file or _is_folder(setting) else setting


def files_named(setting: Any) -> Iterator[str]:
    """The files and folders that a setting names."""
    if isinstance(setting, Mapping):
        yield from (
            [*files_named(str(setting["file"])), *_import_options(setting).model_path] if "file" in setting else []
        )
    elif not isinstance(setting, str):
        yield from (file for entry in setting for file in files_named(entry))
    elif (code := MADE_BY_CODE.fullmatch(setting)) is not None:
        yield from filter(None, [code[2]])
    elif is_path(setting) or _is_folder(setting):
        yield setting


def are_generated(setting: Any) -> bool:
    """Whether some worlds of a setting are generated; these differ by purpose."""
    if isinstance(setting, str):
        return setting in _generators()
    return "file" not in setting if isinstance(setting, Mapping) else any(map(are_generated, setting))


def place_of(setting: Any, worlds: Sequence[World]) -> str:
    """The worlds of a setting for titles: "loop", "loop, circuit", "512 worlds of mixed"."""
    if len(worlds) <= _NAMED:
        return ", ".join(world.name for world in worlds)
    generator = setting["generator"] if isinstance(setting, Mapping) else setting
    of = f" of {generator}" if are_generated(setting) and isinstance(generator, str) else ""
    return f"{len(worlds)} worlds{of}"


def _of_file(setting: Mapping[str, Any]) -> World:
    file, code = setting["file"], MADE_BY_CODE.fullmatch(setting["file"])
    if file in _generators() or _is_folder(file) or (code and code[2] is None):
        options = ", ".join(str(key) for key in setting if key != "file")
        raise InputError(one_line(f"task.world.file must be one file, for {options or 'it'} to count; {file} is not"))
    return find_world(file, _import_options(setting))


def _import_options(setting: Mapping[str, Any]) -> ImportOptions:
    return build(ImportOptions, {key: value for key, value in setting.items() if key != "file"}, "task.world")


@lru_cache(maxsize=16)
def _generated(settings: GeneratorSettings, purpose: Purpose) -> tuple[World, ...]:
    if ":" in settings.generator:
        return generate(settings, (world_maker(settings.generator, "rng", "difficulty", "size"),), purpose)
    if settings.generator not in GENERATORS:
        raise unknown("generator", settings.generator, GENERATORS)
    return generate(settings, GENERATORS[settings.generator], purpose)


def _generators() -> list[str]:
    """Names of generators that are not names of worlds, too."""
    return [name for name in GENERATORS if name not in world_names()]


def _is_folder(name: str) -> bool:
    is_name = name in world_names() or name in GENERATORS
    return not is_name and "\0" not in name and os.path.isdir(name)  # noqa: PTH112 (Path.is_dir raises for a name that is too long)


def _files_in(folder: str) -> list[str]:
    """The world files in a folder, sorted by name."""
    endings = world_endings()
    files = [file for file in Path(folder).iterdir() if file.suffix in endings and file.stem.upper() != "README"]
    if not files:
        raise InputError(
            one_line(f"there is no world in the folder {folder}; files of worlds end in {', '.join(endings)}")
        )
    if len(files) > MOST_WORLDS:
        raise InputError(one_line(f"there are more than {MOST_WORLDS} worlds in the folder {folder}; name fewer"))
    return sorted(map(str, files))
