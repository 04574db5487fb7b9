"""XML from strangers: small enough, without entities, and its numbers finite; by the standard library's parser."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tb2rl.core.errors import InputError, one_line

LARGEST_FILE = 8 * 2**20  # [bytes] a world of BARN has 0.7 MB
_LONG_TAG = re.compile(rb"<[^<>]{50000}")  # a million attributes take seconds
MOST_ELEMENTS = 200_000  # a world of BARN has 11 000
LARGEST_NUMBER = 1e6  # [m] no place or size of a world is beyond


class _Tree(ElementTree.TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self._elements = 0

    def start(self, tag: str, attributes: dict[str, str]) -> Element:
        self._elements += 1
        if self._elements > MOST_ELEMENTS:
            raise InputError(f"it is too large: more than {MOST_ELEMENTS} elements")
        return super().start(tag, attributes)

    def doctype(self, name: str, public: str | None, system: str | None) -> NoReturn:
        # Entities are declared there, and a few of them blow up to gigabytes; neither SDF nor COLLADA needs any.
        raise InputError("it has a <!DOCTYPE>, which is not read: take that line out")


def read_xml(path: Path) -> Element:
    """The root of an XML file.

    Raises:
        InputError: If it cannot be read, is larger than `LARGEST_FILE`, declares a document type, or is not XML.
    """
    content = read_limited(path)
    if _LONG_TAG.search(content):
        raise InputError(f"cannot read {path}: it is too large: a tag with more than 50 kB")
    try:
        return ElementTree.fromstring(content, ElementTree.XMLParser(target=_Tree()))
    except InputError as error:
        raise InputError(f"cannot read {path}: {error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two for its encoding
        raise InputError(one_line(f"{path} is not XML: {error}")) from None


def read_limited(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a file that is not too large.

    Raises:
        InputError: If it is no file, cannot be read, or has more than `largest` bytes.
    """
    try:
        if not path.is_file():  # a pipe or a device would never end
            raise InputError(one_line(f"there is no file {path}"))
        if path.stat().st_size > largest:
            raise InputError(f"{path} is too large: {path.stat().st_size / 2**20:.0f} MB, the limit is {largest >> 20}")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(one_line(f"cannot read {path}: {error}")) from None


def name_of(element: Element) -> str:
    """What an element is called, for people: its name, or else its tag."""
    return element.get("name") or f"<{element.tag}>"


def text_of(element: Element | None) -> str:
    """The text in an element, without blanks around it; "" for None."""
    return "" if element is None else (element.text or "").strip()


def numbers(element: Element, count: int) -> list[float]:
    """The finite numbers in an element's text.

    Args:
        element: What holds them.
        count: How many there must be.

    Raises:
        InputError: If they are not numbers, not finite, beyond `LARGEST_NUMBER`, or not as many.
    """
    words = text_of(element).split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(abs(value) <= LARGEST_NUMBER for value in values):
        raise InputError(one_line(f"<{element.tag}> must be finite numbers, got {' '.join(words)!r}", 200))
    if len(values) != count:
        raise InputError(one_line(f"<{element.tag}> must be {count} numbers, got {' '.join(words)!r}", 200))
    return values


def sizes(parent: Element, tag: str, count: int) -> Sequence[float]:
    """The numbers above 0 in a child that must be there, such as the <size> of a box.

    Raises:
        InputError: If there is no such child, or a number is not above 0.
    """
    child = parent.find(tag)
    if child is None:
        raise InputError(f"<{parent.tag}> has no <{tag}>")
    values = numbers(child, count)
    if min(values) <= 0:
        raise InputError(f"<{tag}> of a <{parent.tag}> must be above 0, got {text_of(child)}")
    return values
