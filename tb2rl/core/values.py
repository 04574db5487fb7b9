"""Foreign values, checked: YAML trees and keyword arguments become frozen dataclasses.

The checking itself is pydantic's; this module turns its reports into one line that names the key.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
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
MOST_WORLDS = 10_000  # of a task; to read or to generate so many takes 15 to 20 s


def _three(value: Any) -> Any:
    if isinstance(value, list | tuple) and len(value) != 3:
        raise ValueError("must be [x, y, yaw], in m and rad")
    return value


def _no_object(value: Any) -> Any:
    if not _is_plain(value):
        raise ValueError('must be a name, or "module:NAME" of what a file of yours defines')
    return value


Pose = Annotated[tuple[float, float, float], BeforeValidator(_three)]  # x [m], y [m], yaw [rad]
Name = Annotated[str, BeforeValidator(_no_object)]  # of an object, which a config can only name


def _increasing(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(after <= before for before, after in pairwise(values)):
        raise ValueError("must strictly increase")
    return values


def _pair(value: Any) -> Any:
    return (value, value) if isinstance(value, int | float) else value


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("must be a number, or the lowest and the highest")
    return pair


def _different(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise ValueError("must be different names")
    return names


def _listed(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


PAIR, ASCENDING = BeforeValidator(_pair), AfterValidator(_ascending)  # of a range, which a number can stand for
Names = Annotated[tuple[str, ...], Len(0, 100), BeforeValidator(_listed), AfterValidator(_different)]  # or one alone
Bins = Annotated[tuple[float, ...], Len(1, 1000), AfterValidator(_increasing)]  # borders of classes


def _sensors(value: Any) -> Any:
    """A list of names, each alone or as the one key of a mapping to arguments."""
    if not isinstance(value, list | tuple) or not value:
        raise ValueError("must be a list of sensors, such as [laser, twist]")
    for entry in value:
        if not isinstance(entry, str | Mapping):
            raise ValueError("must name each sensor, or give its name with arguments, such as {camera: {width: 64}}")
        if isinstance(entry, Mapping) and len(entry) != 1:
            raise ValueError("must give each sensor by itself: [{camera: {width: 64}}, laser]")
        if isinstance(entry, Mapping) and not isinstance(next(iter(entry.values())), Mapping | None):
            raise ValueError("must give a sensor's arguments as a mapping, such as {camera: {width: 64}}")
    return value


def _worlds(value: Any) -> Any:
    """A world's name, a generator's settings, a file with what it does not say, or a tuple of these."""
    entries = value if isinstance(value, list | tuple) else [value]
    if not entries:
        raise ValueError("must name at least one world")
    if len(entries) > MOST_WORLDS:
        raise ValueError(f"must name at most {MOST_WORLDS} worlds, not {len(entries)}")
    for entry in entries:
        if not isinstance(_no_object(entry), str | Mapping):
            raise ValueError("must be a name, a list of names, or a generator: {generator: clutter, difficulty: 0.5}")
        named = (*entry, entry.get("file", entry.get("generator"))) if isinstance(entry, Mapping) else ()
        if not all(isinstance(each, str) for each in named):
            raise ValueError("must name its generator, such as {generator: clutter, difficulty: 0.5}, or its file")
    return value if isinstance(value, str | Mapping) else tuple(entries)


def _variation(value: Any) -> Any:
    if not isinstance(value, str | Mapping):
        raise ValueError("must be a preset, or what is to vary, such as {preset: mild, latency: [0, 1]}")
    return value


def _movers(value: Any) -> Any:
    entries = value if isinstance(value, list | tuple) else [value]
    if value is not None and not all(isinstance(entry, Mapping) for entry in entries):
        raise ValueError("must say how many of what move, such as {people: 4}, or be a list of such")
    return tuple(value) if isinstance(value, list) else value


Moved = Annotated[Any, BeforeValidator(_movers)]  # what it means: see `tb2rl.worlds.dynamic_obstacles`
Varied = Annotated[Any, BeforeValidator(_variation)]  # what it means: see `tb2rl.simulation.variation`
Arguments = dict[str, Any]
Observed = Annotated[tuple[str | dict[str, Arguments | None], ...], Len(1, 100), BeforeValidator(_sensors)]
Worlds = Annotated[Any, BeforeValidator(_worlds)]  # what they mean: see `tb2rl.envs.worlds`

_UNKNOWN = "unexpected_keyword_argument"  # pydantic's word for a key that a dataclass does not have
_CHECKS = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)


def build(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Make the frozen dataclass `cls` from foreign values.

    Args:
        cls: A dataclass whose annotations say what fits; a default lives in its signature.
        values: Its fields by name, as YAML or keyword arguments bring them.
        where: What the values are, for the message: "task", "maze loop.yaml".

    Raises:
        InputError: For a key that the class lacks (with the nearest one), or a value that does not fit.
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
    """The dataclass `cls` itself, told to pydantic to refuse NaN and infinities."""
    if "__pydantic_config__" not in cls.__dict__:
        cls.__pydantic_config__ = _CHECKS  # type: ignore[attr-defined]
    return cls


def checked(kind: Any, value: Any, where: str) -> Any:
    """`value` as the type `kind`, or an `InputError` that says where it stands and what fits."""
    own_config = isinstance(kind, type) and dataclasses.is_dataclass(kind)
    adapter = TypeAdapter(kind) if own_config else TypeAdapter(kind, config=_CHECKS)
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        found = error.errors()
        first = next((one for one in found if one["type"] == _UNKNOWN), found[0])
        place = ".".join([where, *map(str, first["loc"])])
        missing = ", ".join(str(one["loc"][-1]) for one in found if one["type"] == "missing")
        said = first["msg"].removeprefix("Value error, ")
        if missing and first["type"] == _UNKNOWN:
            said += f" (and {missing} is missing)"
        raise InputError(one_line(f"{place}: {said}, got {one_line(_shown(first['input']), 200)}")) from None


def untyped(cls: type, key: str) -> bool:
    """Whether a class has an attribute that was meant as a field, `bonus = 5.0`, but for its type."""
    typed = any(key in vars(base).get("__annotations__", {}) for base in cls.__mro__)
    return not typed and isinstance(getattr(cls, key, None), bool | int | float | str | tuple | list)


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, bool | int | float | str | list | tuple | dict)


def _shown(value: Any) -> str:
    """A value that a user gave; of an object its class alone, for it may hold thousands of numbers."""
    return repr(value) if _is_plain(value) else f"an object of class {type(value).__name__}"
