"""Plain values (numbers, text, lists, mappings), the only ones that the config of a run holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tb2rl.core.errors import InputError, one_line, unknown

SECTIONS = ("agent", "task", "train")
_LARGEST = 1e12  # of any number


def check_sections(tree: Any, where: str) -> dict[str, Any]:
    """The tree as a dictionary of sections.

    Raises:
        InputError: If a section is not one of `SECTIONS` or not a mapping.
    """
    if not isinstance(tree, Mapping):
        raise InputError(f"{where}: expected the sections agent, task and train, got {tree!r}")
    for name, values in tree.items():
        if name not in SECTIONS:
            raise unknown(f"section of {where}", name, SECTIONS)
        if not isinstance(values, Mapping):
            raise InputError(f"{where}: section {name} must be a mapping, got {values!r}")
    return dict(tree)


def check_plain(value: Any, where: str) -> None:
    """Check that a tree can be kept in the config of a run and computed with.

    Args:
        value: Any tree.
        where: Its dotted key, for messages; "" for a whole config.

    Raises:
        InputError: For a key that is not text, text that is not printable, a number that is not finite or too large,
            or a value of any other type.
    """
    if isinstance(value, Mapping | list | tuple):
        for key, part in value.items() if isinstance(value, Mapping) else enumerate(value):
            if isinstance(value, Mapping) and not isinstance(key, str):
                raise InputError(one_line(f"{where or 'config'}: a key must be text, got {key!r}"))
            check_plain(part, f"{where}.{key}".lstrip("."))
    elif isinstance(value, str):
        if not value.isprintable():
            raise InputError(one_line(f"{where}: text must be printable, got {value!r}"))
    elif isinstance(value, int | float):
        if not abs(value) <= _LARGEST:
            shown = value if isinstance(value, float) else f"an integer of {value.bit_length()} bits"
            raise InputError(f"{where}: numbers must be finite, within {_LARGEST:g} of 0, got {shown}")
    elif value is not None:
        raise InputError(one_line(f"{where}: expected plain numbers, text, lists and mappings, got {value!r}"))


def to_plain(value: Any) -> Any:
    """The tree with dictionaries for mappings and lists for sequences, as YAML and JSON read them."""
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    return [to_plain(item) for item in value] if isinstance(value, list | tuple) else value
