"""Worlds of the setting `task.world`: named worlds, files, folders of files, and generated worlds."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from tb2rl.core import InputError, one_line, unknown
from tb2rl.core.files import is_path
from tb2rl.core.values import MAX_WORLDS, build
from tb2rl.worlds import ImportOptions, World
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, Purpose, generate
from tb2rl.worlds.registry import WORLD_OR_READER, find_maker, find_world, world_extensions, world_names

_MAX_NAMES = 3  # most worlds that a title lists by name
_registered: dict[str, tuple[World, ...]] = {}  # worlds from another process, by `_key` of their entry


def find_worlds(setting: Any, purpose: Purpose = "training") -> tuple[World, ...]:
    """Find, read or generate the worlds of a task.

    Args:
        setting: A name for `find_world`, a generator's name, a folder, the settings of a generator, a file and
            `tb2rl.worlds.ImportOptions` for it ({file: my_map.yaml, start: [0, 0, 0]}), or a list of these. If a world
            and a generator have the same name (`maze`), the name alone is the world, and `{generator: maze}` the
            generator.
        purpose: Purpose of generated worlds; other worlds do not depend on it.

    Raises:
        InputError: If there is no such world, or a setting is invalid.
    """
    sources = [_source(entry) for entry in _entries(setting)]
    count = sum(source.worlds if isinstance(source, GeneratorSettings) else len(source) for source in sources)
    if count > MAX_WORLDS:  # checked before any world is read
        raise InputError(f"task.world has {count} worlds; more than {MAX_WORLDS} worlds are too many")
    return tuple(world for source in sources for world in _worlds_of(source, purpose))


def worlds_of_files(setting: Any) -> dict[str, tuple[World, ...]]:
    """The worlds that a setting reads from files, for `register_worlds` in a process on another machine."""
    return {_key(entry): find_worlds(entry) for entry in _entries(setting) if any(paths_in(entry))}


def register_worlds(worlds: Mapping[str, tuple[World, ...]]) -> None:
    """Register a result of `worlds_of_files` for `find_worlds` in this process, which may lack the files."""
    _registered.update(worlds)


def absolute_worlds(setting: Any) -> Any:
    """The setting with absolute paths, so that a run finds its worlds in any working directory."""
    if isinstance(setting, Mapping):
        if "file" not in setting:
            return setting
        folders = [str(Path(folder).resolve()) for folder in _import_options(setting).model_path if folder]
        return {**setting, "file": absolute_worlds(setting["file"]), **({"model_path": folders} if folders else {})}
    if not isinstance(setting, str):
        return tuple(map(absolute_worlds, setting))
    if reference := WORLD_OR_READER.fullmatch(setting):
        return f"{reference[1]}:{Path(reference['path']).resolve()}" if reference["path"] else setting
    is_file = is_path(setting) and os.path.isfile(setting)  # noqa: PTH113 (Path.is_file raises for a name that is too long)
    return str(Path(setting).resolve()) if is_file or _is_folder(setting) else setting


def paths_in(setting: Any) -> Iterator[str]:
    """Paths of the files and folders in a setting."""
    for entry in _entries(setting):
        if isinstance(entry, Mapping):
            if "file" in entry:
                yield from [*paths_in(str(entry["file"])), *_import_options(entry).model_path]
        elif reference := WORLD_OR_READER.fullmatch(entry):
            yield from filter(None, [reference["path"]])
        elif is_path(entry) or _is_folder(entry):
            yield entry


def are_generated(setting: Any) -> bool:
    """Whether a setting has generated worlds, which depend on the purpose."""
    entries, names = _entries(setting), _bare_generator_names()
    return any("file" not in entry if isinstance(entry, Mapping) else entry in names for entry in entries)


def worlds_title(setting: Any, worlds: Sequence[World]) -> str:
    """A title for the worlds of a setting: "loop", "loop, circuit", "512 worlds of mixed"."""
    if len(worlds) <= _MAX_NAMES:
        return ", ".join(world.name for world in worlds)
    source = setting["generator"] if isinstance(setting, Mapping) else setting
    is_generator = are_generated(setting) and isinstance(source, str)
    return f"{len(worlds)} worlds of {source}" if is_generator else f"{len(worlds)} worlds"


def _entries(setting: Any) -> Sequence[str | Mapping[str, Any]]:
    return [setting] if isinstance(setting, str | Mapping) else setting


def _source(entry: str | Mapping[str, Any]) -> Any:
    """Generator settings, a list of `find_world` arguments, or registered worlds, without reading or generating."""
    if _registered and (worlds := _registered.get(_key(entry))):
        return worlds
    if isinstance(entry, Mapping):
        return [_file_and_options(entry)] if "file" in entry else build(GeneratorSettings, entry, "task.world")
    if _is_folder(entry):
        return [(file, None) for file in _files_in(entry)]
    if entry in _bare_generator_names():
        return GeneratorSettings(entry)
    if ":" not in entry and not is_path(entry) and entry not in world_names():
        raise unknown("world", entry, [*world_names(), *_bare_generator_names()])
    return [(entry, None)]


def _worlds_of(source: Any, purpose: Purpose) -> Sequence[World]:
    if isinstance(source, GeneratorSettings):
        return _generated_worlds(source, purpose)
    return [item if isinstance(item, World) else find_world(*item) for item in source]


def _key(entry: Any) -> str:
    return json.dumps(entry, sort_keys=True, default=list)


def _file_and_options(entry: Mapping[str, Any]) -> tuple[str, ImportOptions]:
    file, reference = entry["file"], WORLD_OR_READER.fullmatch(entry["file"])
    if file in _bare_generator_names() or _is_folder(file) or (reference and reference["path"] is None):
        raise InputError(one_line(f"task.world.file must be a single file; {file} is not"))
    return file, _import_options(entry)


def _import_options(entry: Mapping[str, Any]) -> ImportOptions:
    return build(ImportOptions, {key: value for key, value in entry.items() if key != "file"}, "task.world")


@lru_cache(maxsize=16)
def _generated_worlds(settings: GeneratorSettings, purpose: Purpose) -> tuple[World, ...]:
    if ":" in settings.generator:
        return generate(settings, (find_maker(settings.generator, "rng", "difficulty", "size"),), purpose)
    if settings.generator not in GENERATORS:
        raise unknown("generator", settings.generator, GENERATORS)
    return generate(settings, GENERATORS[settings.generator], purpose)


def _bare_generator_names() -> list[str]:
    """Names of generators, without those that are also names of worlds."""
    return [name for name in GENERATORS if name not in world_names()]


def _is_folder(name: str) -> bool:
    is_known = name in world_names() or name in GENERATORS
    return not is_known and "\0" not in name and os.path.isdir(name)  # noqa: PTH112 (Path.is_dir raises for a name that is too long)


def _files_in(folder: str) -> list[str]:
    """The world files in a folder, sorted by name."""
    extensions = world_extensions()
    files = [file for file in Path(folder).iterdir() if file.suffix in extensions and file.stem.upper() != "README"]
    if not files:
        raise InputError(one_line(f"no world in the folder {folder}; files of worlds end in {', '.join(extensions)}"))
    return sorted(map(str, files))
