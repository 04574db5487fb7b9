"""XML from strangers, with the standard library's parser: limited size, no entities, finite numbers."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tb2rl.core.errors import InputError, one_line

LARGEST_FILE = 8 * 2**20  # [bytes] a world of BARN has 0.7 MB
LARGEST_NUMBER = 1e6  # [m] beyond any position or size of a world


class _NoEntities(ElementTree.TreeBuilder):
    def doctype(self, name: str, public: str | None, system: str | None) -> NoReturn:
        # Entities are declared there, and a few of them expand to gigabytes; neither SDF nor COLLADA needs any.
        raise InputError("it has a <!DOCTYPE>, which is not read: take that line out")


def read_xml(path: Path) -> Element:
    """Read the root of an XML file.

    Raises:
        InputError: If it cannot be read, is larger than `LARGEST_FILE`, declares a document type, or is not XML.
    """
    content = read_limited(path)
    try:
        return ElementTree.fromstring(content, ElementTree.XMLParser(target=_NoEntities()))
    except InputError as error:
        raise InputError(f"cannot read {path}: {error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two for its encoding
        raise InputError(one_line(f"{path} is not XML: {error}")) from None


def read_limited(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Read a regular file of at most `largest` bytes.

    Raises:
        InputError: If it is no such file, or cannot be read.
    """
    if not os.path.isfile(path):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
        raise InputError(one_line(f"there is no file {path}"))  # nor a pipe or a device, which would never end
    try:
        if (size := path.stat().st_size) > largest:
            raise InputError(f"{path} is too large: {size / 2**20:.0f} MB, the limit is {largest >> 20}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(one_line(f"cannot read {path}: {error}")) from None


def name_of(element: Element) -> str:
    """Name of an element in messages: its attribute `name`, or else its tag."""
    return element.get("name") or f"<{element.tag}>"


def text_of(element: Element | None) -> str:
    """Text in an element, stripped; "" for None."""
    return "" if element is None else (element.text or "").strip()


def numbers(element: Element, count: int) -> list[float]:
    """Parse `count` finite numbers in an element's text.

    Raises:
        InputError: If they are not numbers, beyond `LARGEST_NUMBER`, or not as many.
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
    """Parse the numbers above 0 in a required child, such as the <size> of a box.

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
