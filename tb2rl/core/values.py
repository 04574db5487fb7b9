"""Validation: values of YAML files and keyword arguments become frozen dataclasses.

pydantic validates; this module turns its reports into one line that names the key.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Annotated, Any, TypeVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import AfterValidator, BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from tb2rl.core.errors import InputError, one_line, unknown

T = TypeVar("T")

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1), Le(2**31 - 1)]
CountOrZero = Annotated[int, Ge(0), Le(2**31 - 1)]
Point = tuple[float, float]
MOST_WORLDS = 10_000  # of a task; reading or generating so many takes 15 to 20 s


def _validator(fits: Callable[[Any], bool], message: str) -> Callable[[Any], Any]:
    """A validator that passes a value on, or refuses it with a message."""

    def validate(value: Any) -> Any:
        if not fits(value):
            raise ValueError(message)
        return value

    return validate


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, bool | int | float | str | list | tuple | dict)


def _pair(value: Any) -> Any:
    return (value, value) if isinstance(value, int | float) else value


def _listed(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


_check_pose = _validator(
    lambda value: not isinstance(value, list | tuple) or len(value) == 3, "must be [x, y, yaw], in m and rad"
)
_check_name = _validator(_is_plain, 'must be a name, or "module:NAME" of what a file of yours defines')
_check_increasing = _validator(lambda values: all(a < b for a, b in pairwise(values)), "must strictly increase")
_check_different = _validator(lambda names: len(set(names)) == len(names), "must be different names")
_check_variation = _validator(
    lambda value: isinstance(value, str | Mapping),
    "must be a preset, or what is to vary, such as {preset: mild, latency: [0, 1]}",
)
_check_ascending = _validator(lambda pair: pair[0] <= pair[1], "must be a number, or the lowest and the highest")

Pose = Annotated[tuple[float, float, float], BeforeValidator(_check_pose)]  # x [m], y [m], yaw [rad]
Name = Annotated[str, BeforeValidator(_check_name)]  # of an object, because a config holds no objects
PAIR, ASCENDING = BeforeValidator(_pair), AfterValidator(_check_ascending)  # a range, or a number for both ends
Names = Annotated[
    tuple[str, ...], Len(0, 100), BeforeValidator(_listed), AfterValidator(_check_different)
]  # or one name
Bins = Annotated[tuple[float, ...], Len(1, 1000), AfterValidator(_check_increasing)]  # borders of classes


def _check_parts(value: Any) -> Any:
    """Check a list of names, each alone or as the only key of a mapping to its arguments."""
    example = "such as laser, or {camera: {width: 64}}"
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of names, {example}")
    for entry in value:
        alone = isinstance(entry, Mapping) and len(entry) == 1
        if not isinstance(entry, str) and not (alone and isinstance(next(iter(entry.values())), Mapping | None)):
            raise ValueError(f"must list names, each alone or as the only key of its arguments, {example}")
    return value


def _worlds(value: Any) -> Any:
    """Check a world's name, a generator's or a file's settings, or a list of these."""
    entries = value if isinstance(value, list | tuple) else [value]
    if not entries:
        raise ValueError("must name at least one world")
    if len(entries) > MOST_WORLDS:
        raise ValueError(f"must name at most {MOST_WORLDS} worlds, not {len(entries)}")
    for entry in entries:
        if not isinstance(_check_name(entry), str | Mapping):
            raise ValueError("must be a name, a list of names, or a generator: {generator: clutter, difficulty: 0.5}")
        named = (*entry, entry.get("file", entry.get("generator"))) if isinstance(entry, Mapping) else ()
        if not all(isinstance(each, str) for each in named):
            raise ValueError("must name its generator, such as {generator: clutter, difficulty: 0.5}, or its file")
    return value if isinstance(value, str | Mapping) else tuple(entries)


def _obstacles(value: Any) -> Any:
    entries = value if isinstance(value, list | tuple) else [value]
    if value is not None and not all(isinstance(entry, Mapping) for entry in entries):
        raise ValueError("must say how many of what move, such as {people: 4}, or be a list of such")
    return tuple(value) if isinstance(value, list) else value


Moved = Annotated[Any, BeforeValidator(_obstacles)]  # read by `tb2rl.worlds.dynamic_obstacles`
Varied = Annotated[Any, BeforeValidator(_check_variation)]  # read by `tb2rl.simulation.variation`
Arguments = dict[str, Any]
Parts = Annotated[tuple[str | dict[str, Arguments | None], ...], Len(0, 100), BeforeValidator(_check_parts)]
Observed = Annotated[Parts, Len(1)]
Worlds = Annotated[Any, BeforeValidator(_worlds)]  # read by `tb2rl.envs.worlds`

_UNKNOWN = "unexpected_keyword_argument"  # pydantic's error type for an unknown key
_CHECKS = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)


def build(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Make the frozen dataclass `cls` from values of YAML or keyword arguments.

    Args:
        cls: A dataclass whose annotations say what fits.
        values: Its fields by name.
        where: Origin of the values, for messages: "task", "maze loop.yaml".

    Raises:
        InputError: For an unknown key (with the nearest one), or a value that does not fit.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{where}: expected a mapping of keys to values, got {values!r}")
    known = [field.name for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
    for key in values:
        if key not in known and isinstance(key, str) and untyped(cls, key):  # a key of YAML can be null
            raise InputError(
                f"{where}.{key}: a setting needs a type in its class; write {key}: float = ..., or another"
            )
        if key not in known:
            raise unknown(f"key of {where}", key, known)
    return checked(type_with_checks(cls), dict(values), where)


def type_with_checks(cls: type[T]) -> Any:
    """The dataclass `cls`, configured for pydantic to refuse NaN and infinities."""
    if "__pydantic_config__" not in cls.__dict__:
        cls.__pydantic_config__ = _CHECKS  # type: ignore[attr-defined]
    return cls


def checked(kind: Any, value: Any, where: str) -> Any:
    """`value` as the type `kind`, or an `InputError` with its place and what fits."""
    own_config = isinstance(kind, type) and dataclasses.is_dataclass(kind)
    adapter = TypeAdapter(kind) if own_config else TypeAdapter(kind, config=_CHECKS)
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        found = error.errors()
        first = next((one for one in found if one["type"] == _UNKNOWN), found[0])
        place = ".".join([where, *map(str, first["loc"])])
        missing = ", ".join(str(one["loc"][-1]) for one in found if one["type"] == "missing")
        problem = first["msg"].removeprefix("Value error, ")
        if missing and first["type"] == _UNKNOWN:
            problem += f" (and {missing} is missing)"
        raise InputError(one_line(f"{place}: {problem}, got {one_line(_shown(first['input']), 200)}")) from None


def untyped(cls: type, key: str) -> bool:
    """Whether a class has an attribute without a type that was meant as a field, such as `bonus = 5.0`."""
    typed = any(key in vars(base).get("__annotations__", {}) for base in cls.__mro__)
    return not typed and isinstance(getattr(cls, key, None), bool | int | float | str | tuple | list)


def _shown(value: Any) -> str:
    """A value for a message; of an object only its class, because it may hold thousands of numbers."""
    return repr(value) if _is_plain(value) else f"an object of class {type(value).__name__}"
