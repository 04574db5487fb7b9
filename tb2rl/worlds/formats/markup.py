"""Safe parsing of untrusted XML: limited size, no entities, finite numbers."""

import os
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tb2rl.core.errors import InputError, one_line

MAX_FILE_SIZE = 8 * 2**20  # [bytes] a BARN world has 0.7 MB
MAX_NUMBER = 1e6  # [m] larger than any position or size in a world


class _NoEntities(ElementTree.TreeBuilder):
    def doctype(self, name: str, public: str | None, system: str | None) -> NoReturn:
        # A document type can declare entities that expand to gigabytes. Neither SDF nor COLLADA needs one.
        raise ValueError("it has a <!DOCTYPE>, which is not allowed; remove the <!DOCTYPE>")


def read_xml(path: Path) -> Element:
    """Parse an XML file and return its root.

    Raises:
        InputError: If the file cannot be read, is larger than `MAX_FILE_SIZE`, declares a document type, or is not XML.
    """
    content = read_limited(path)
    try:
        return ElementTree.fromstring(content, ElementTree.XMLParser(target=_NoEntities()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two for unsupported encodings, too
        raise InputError(one_line(f"{path} is not XML that can be read: {error}")) from None


def read_limited(path: Path) -> bytes:
    """Read a regular file of at most `MAX_FILE_SIZE` bytes.

    Raises:
        InputError: If the path is not a regular file, or the file is larger.
        OSError: If the file cannot be read.
    """
    if not os.path.isfile(path):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
        raise InputError(one_line(f"there is no file {path}"))  # reading a pipe or a device might never end
    if (size := path.stat().st_size) > MAX_FILE_SIZE:
        raise InputError(f"{path} is too large: {size / 2**20:.0f} MB, the limit is {MAX_FILE_SIZE >> 20} MB")
    return path.read_bytes()


def element_name(element: Element) -> str:
    """Name of an element in messages: its attribute `name`, otherwise its tag."""
    return element.get("name") or f"<{element.tag}>"


def element_text(element: Element | None) -> str:
    """Stripped text of an element, or an empty string for None."""
    return "" if element is None else (element.text or "").strip()


def parse_numbers(element: Element, count: int, *, positive: bool = False) -> list[float]:
    """Parse `count` numbers in the text of an element.

    Raises:
        InputError: If the text is not `count` finite numbers up to `MAX_NUMBER`, all above 0 if `positive`.
    """
    text = element_text(element)
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) <= MAX_NUMBER for number in numbers):
        raise InputError(one_line(f"<{element.tag}> must be {count} numbers up to {MAX_NUMBER:g}, got {text!r}", 200))
    if positive and min(numbers) <= 0:
        raise InputError(f"<{element.tag}> must be above 0, got {text}")
    return numbers


def parse_sizes(parent: Element, tag: str, count: int) -> list[float]:
    """Parse `count` numbers above 0 in a required child, such as the <size> of a box.

    Raises:
        InputError: If the child is missing or invalid.
    """
    child = parent.find(tag)
    if child is None:
        raise InputError(f"<{parent.tag}> has no <{tag}>")
    return parse_numbers(child, count, positive=True)
