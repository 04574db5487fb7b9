"""Foreign values, checked: YAML trees and keyword arguments become frozen dataclasses.

The checking itself is pydantic's; this module turns its reports into one line that names the key.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, TypeVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import AfterValidator, ConfigDict, TypeAdapter, ValidationError

from tb2rl.errors import InputError, one_line, unknown

T = TypeVar("T")

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1), Le(2**31 - 1)]
CountOrZero = Annotated[int, Ge(0), Le(2**31 - 1)]
Point = tuple[float, float]

Pose = tuple[float, float, float]  # x [m], y [m], yaw [rad]


def _increasing(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(after <= before for before, after in pairwise(values)):
        raise ValueError("must strictly increase")
    return values


Edges = Annotated[tuple[float, ...], Len(1, 1000), AfterValidator(_increasing)]  # borders of classes

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
        first = error.errors()[0]
        place = ".".join([where, *map(str, first["loc"])])
        raise InputError(one_line(f"{place}: {first['msg']}, got {one_line(repr(first['input']), 200)}")) from None
