"""Validates values of YAML files and keyword arguments, and makes frozen dataclasses from them.

pydantic validates the values; this module converts its errors to messages of one line that include the key. A string
in `Annotated` describes the type in `python -m tb2rl.settings`.
"""

import dataclasses
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Annotated, Any, TypeVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import AfterValidator, BeforeValidator, ConfigDict, TypeAdapter, ValidationError, WrapValidator

from tb2rl.core.errors import InputError, one_line, unknown

T = TypeVar("T")

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1), Le(2**31 - 1)]
CountOrZero = Annotated[int, Ge(0), Le(2**31 - 1)]
Point = tuple[float, float]
MAX_WORLDS = 10_000  # maximum number of worlds of a task; to read or generate so many takes 15 to 20 s


def _require(condition: Callable[[Any], bool], message: str) -> AfterValidator:
    """Make a validator that checks a condition after pydantic has checked the type."""

    def validate(value: Any) -> Any:
        if not condition(value):
            raise ValueError(message)
        return value

    return AfterValidator(validate)


def _with_message(message: str) -> WrapValidator:
    """Make a validator that replaces all of pydantic's messages by one."""

    def validate(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(message) from None

    return WrapValidator(validate)


def _has_source(world: str | dict[str, Any]) -> bool:
    return isinstance(world, str) or isinstance(world.get("file", world.get("generator")), str)


Pose = Annotated[tuple[float, float, float], "[x, y, yaw]", _with_message("must be [x, y, yaw], in m and rad")]
_NAME_MESSAGE = 'must be a name, or "module:NAME" for an object in your own file'
Name = Annotated[str, _with_message(_NAME_MESSAGE)]
RobotSetting = Annotated[
    str | dict[str, Any], "name, file or mapping", _with_message(f"{_NAME_MESSAGE}, or a robot file")
]
PAIR = BeforeValidator(lambda value: (value, value) if isinstance(value, int | float) else value)  # number to pair
ASCENDING = _require(lambda pair: pair[0] <= pair[1], "must be a number, or the lowest and the highest")
Names = Annotated[
    tuple[str, ...],
    "name or list of names",
    Len(0, 100),
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
    _require(lambda names: len(set(names)) == len(names), "must be different names"),
]
Bins = Annotated[  # borders between the classes of a discretized value
    tuple[float, ...],
    "increasing list of float",
    Len(1, 1000),
    _require(lambda values: all(a < b for a, b in pairwise(values)), "must strictly increase"),
]
Arguments = dict[str, Any]
PluginNames = Annotated[
    tuple[str | Annotated[dict[str, Arguments | None], Len(1, 1)], ...],
    "list of names",
    Len(0, 100),
    _with_message("must be a list of names, with or without arguments, such as [laser, {camera: {width: 64}}]"),
]
SensorNames = Annotated[PluginNames, Len(1)]
DynamicObstaclesSetting = Annotated[  # read by `tb2rl.worlds.dynamic_obstacles`
    Any,
    "mapping or list of mappings",
    BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value),
]
_World = Annotated[str | dict[str, Any], _require(_has_source, "must have a file or a generator")]
Worlds = Annotated[  # read by `tb2rl.envs.worlds`
    _World | Annotated[tuple[_World, ...], Len(1, MAX_WORLDS)],
    "name, file, mapping or list of these",
    _with_message(
        f"{_NAME_MESSAGE}, or a generator such as {{generator: clutter, difficulty: 0.5}}, or {{file: my_map.yaml}}, "
        f"or a list of 1 to {MAX_WORLDS} of these"
    ),
]

_UNKNOWN_KEY = "unexpected_keyword_argument"  # pydantic's error type
_STRICT_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)


def build(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Make a dataclass from values of YAML or keyword arguments, which are checked against its annotations.

    `where` is the origin of the values, for messages, such as "task" or "maze loop.yaml".

    Raises:
        InputError: If a key is unknown, or a value is invalid.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{where}: expected a mapping of keys to values, got {values!r}")
    known = [field.name for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
    for key in [key for key in values if key not in known]:
        if isinstance(key, str) and is_untyped(cls, key):  # a key of YAML can be null
            hint = f"write {key}: float = ..., or another type"
            raise InputError(f"{where}.{key}: a setting needs a type in its class; {hint}")
        raise unknown(f"key of {where}", key, known)
    return checked(type_with_checks(cls), dict(values), where)


def type_with_checks(cls: type[T]) -> Any:
    """Configure the dataclass `cls` for pydantic, which then rejects NaN, infinities and unknown keys."""
    if "__pydantic_config__" not in cls.__dict__:
        cls.__pydantic_config__ = _STRICT_CONFIG  # type: ignore[attr-defined]
    return cls


def checked(annotation: Any, value: Any, where: str) -> Any:
    """Check a value against a type annotation, and convert it; raises an `InputError` if it is invalid."""
    has_own_config = isinstance(annotation, type) and dataclasses.is_dataclass(annotation)
    adapter = TypeAdapter(annotation) if has_own_config else TypeAdapter(annotation, config=_STRICT_CONFIG)
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        details = error.errors()
        detail = next((item for item in details if item["type"] == _UNKNOWN_KEY), details[0])
        path = ".".join([where, *map(str, detail["loc"])])
        problem = detail["msg"].removeprefix("Value error, ")
        raise InputError(one_line(f"{path}: {problem}, got {one_line(_describe(detail['input']), 200)}")) from None


def is_untyped(cls: type, key: str) -> bool:
    """Whether a class has a plain attribute without annotation, such as `bonus = 5.0`, which is not a field."""
    is_typed = key in getattr(cls, "__dataclass_fields__", {})  # also a ClassVar
    return not is_typed and isinstance(getattr(cls, key, None), bool | int | float | str | tuple | list)


def _describe(value: Any) -> str:
    """Describe a value for a message: plain values as they are, other objects by their class."""
    is_plain = value is None or isinstance(value, bool | int | float | str | list | tuple | dict)
    return repr(value) if is_plain else f"an object of class {type(value).__name__}"
