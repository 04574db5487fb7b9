"""Worlds as text drawings: `#` for a wall, `S` for the start, `G` for the goal, `.` or a blank for free floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tb2rl.core.errors import InputError
from tb2rl.core.values import Pose
from tb2rl.worlds.world import BoxShape

MOST_SQUARES = 2**18  # 512 x 512: a second to read, if every other one is a wall


@dataclass(frozen=True)
class Drawing:
    """What a drawing shows; its lower left corner is the origin."""

    boxes: Sequence[BoxShape]
    start: Pose | None
    goal: Pose | None


def read_drawing(text: str, cell: float) -> Drawing:
    """Read a drawing whose characters are squares with sides of `cell` [m].

    Runs of `#` become one box, and equal runs above each other one larger box.

    Raises:
        InputError: For any other character, a second start or goal, or more than `MOST_SQUARES`.
    """
    if len(text) > MOST_SQUARES:
        raise InputError(f"the drawing has more than {MOST_SQUARES} squares, the limit")
    lines = text.rstrip(" \n").split("\n")
    _check(lines)
    lines.reverse()
    marks: dict[str, Pose] = {}
    for row, line in enumerate(lines):
        for column, mark in enumerate(line):
            if mark in "SG":
                marks[mark] = ((column + 0.5) * cell, (row + 0.5) * cell, 0.0)
    boxes: list[BoxShape] = []
    for first, last, bottom, top in rectangles([[c for c, mark in enumerate(line) if mark == "#"] for line in lines]):
        length, width = (last - first + 1) * cell, (top - bottom + 1) * cell
        boxes.append(((first + last + 1) / 2 * cell, (bottom + top + 1) / 2 * cell, length, width, 0.0))
    return Drawing(boxes, marks.get("S"), marks.get("G"))


def _check(lines: Sequence[str]) -> None:
    seen: dict[str, str] = {}  # where the start and the goal are
    for row, line in enumerate(lines, start=1):
        for column, mark in enumerate(line, start=1):
            place = f"line {row}, column {column}"
            if mark not in "#SG. ":
                raise InputError(
                    f"the drawing has {mark!r} in {place}; "
                    "it takes # (wall), S (start), G (goal), and . or a blank (free floor)"
                )
            if mark in seen:
                raise InputError(f"the drawing has a second {mark} in {place}; the first is in {seen[mark]}")
            if mark in "SG":
                seen[mark] = place


def rectangles(rows: Sequence[Sequence[int]]) -> list[tuple[int, int, int, int]]:
    """First and last column, first and last row of the rectangles that cover the ascending columns of some rows.

    Columns in a row are joined to runs, and equal runs above each other to one rectangle.
    """
    runs: dict[tuple[int, int], list[int]] = {}
    for row, columns in enumerate(rows):
        for run in _stretches(columns):
            runs.setdefault(run, []).append(row)
    return [(*run, *those) for run, found in runs.items() for those in _stretches(found)]


def _stretches(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each stretch of consecutive ascending integers."""
    stretches: list[tuple[int, int]] = []
    for number in numbers:
        if stretches and number == stretches[-1][1] + 1:
            stretches[-1] = (stretches[-1][0], number)
        else:
            stretches.append((number, number))
    return stretches
