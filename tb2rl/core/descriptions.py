"""Descriptions of settings: types from annotations, units and meanings from comments and docstrings."""

import ast
import inspect
import re
from collections.abc import Callable
from functools import cache
from textwrap import dedent
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tb2rl.core.values import PAIR

_UNIT = re.compile(r"\s*\[((?:control steps|m|s|rad|px|1)(?:[ /^][^],]*)?)\]")  # such as " [m/s^2]"
_NAMES: dict[Any, str] = {
    Any: "any",
    Callable: "schedule",
    NoneType: "null",
    bool: "true or false",
    dict: "mapping",
    str: "text",
}
_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def describe_type(annotation: Any) -> str:
    """Describe a type as a user writes its values: "float > 0", "one of success, return".

    A string in `Annotated` replaces the description: `Annotated[str, "name of a simulator"]`.
    """
    origin, (first, *others) = get_origin(annotation), get_args(annotation) or (None,)
    if origin is Annotated:
        given = [item for item in others if isinstance(item, str)]
        is_range = PAIR in others
        text = describe_type(get_args(first)[0] if is_range else first) + _describe_limits(others)
        return given[0] if given else f"{text} or [low, high]" if is_range else text
    if origin is Literal:
        return f"one of {', '.join((first, *others))}"
    if origin in (Union, UnionType):
        return " or ".join(map(describe_type, (first, *others)))
    if origin is tuple:
        is_list = others == [Ellipsis]
        return f"list of {describe_type(first)}" if is_list else f"[{', '.join(map(describe_type, (first, *others)))}]"
    return _NAMES.get(origin or annotation, str(getattr(annotation, "__name__", "any")))


def _describe_limits(metadata: list[Any]) -> str:
    found = {name: getattr(item, name) for item in metadata for name in _SIGNS if hasattr(item, name)}
    texts = {name: f"{limit:.6g}" if isinstance(limit, float) else f"{limit}" for name, limit in found.items()}
    if texts.keys() == {"ge", "le"}:
        return f" {texts['ge']} to {texts['le']}"
    return ",".join(f" {_SIGNS[name]} {text}" for name, text in texts.items())


def describe_fields(cls: type) -> dict[str, tuple[str, str]]:
    """Unit and meaning of fields and arguments, by name; a subclass may replace either.

    They are in a comment at the end of the field, `# [m/s] meaning`, or in the docstring.
    """
    described: dict[str, tuple[str, str]] = {}
    for name, text in (item for base in reversed(cls.__mro__) for item in [*_documented(base), *_commented(base)]):
        units, (unit, meaning) = {*_UNIT.findall(text)}, described.get(name, ("", ""))
        if len(units) == 1:  # otherwise they stay in the text: "x [m], y [m], yaw [rad]"
            unit, text = units.pop(), _UNIT.sub("", text).lstrip("; ")
        described[name] = unit, text or meaning
    return described


@cache  # because to find the source of a class takes time
def _commented(cls: type) -> list[tuple[str, str]]:
    try:
        source = dedent(inspect.getsource(cls))
    except (OSError, TypeError):  # the class is built in, or was typed in
        return []
    tree: Any = ast.parse(source)
    lines = [line.encode() for line in source.splitlines()]  # because offsets count bytes
    fields: list[Any] = [node for node in tree.body[0].body if isinstance(node, ast.AnnAssign)]
    ends = [(node.target.id, lines[node.end_lineno - 1][node.end_col_offset :].decode()) for node in fields]
    return [(name, end.partition("#")[2].strip()) for name, end in ends]


def _documented(cls: type) -> list[tuple[str, str]]:
    """Arguments in the docstring, in Google's form, or in Sphinx's `:param NAME: meaning`; also units: `bins` [m]."""
    text = inspect.cleandoc(cls.__doc__ or "")
    form = r"^:param (\w+): (.*?)(?=^:|\Z)" if ":param" in text else r"^ {4}(\w+(?:, \w+)*): (.*?)(?=^ {0,4}\S|\Z)"
    found = re.findall(form, text, re.DOTALL | re.MULTILINE) + re.findall(r"`(\w+)` (\[[^]]+\])", text)
    plain = [(names, re.sub(r"(:\w+:)?`+", "`", " ".join(meaning.split())).rstrip(".")) for names, meaning in found]
    return [(name, meaning) for names, meaning in plain for name in names.split(", ")]
