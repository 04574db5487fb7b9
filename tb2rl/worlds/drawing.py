"""Worlds as text drawings: `#` for a wall, `S` for the start, `G` for the goal, `.` or a blank for free floor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.values import Pose
from tb2rl.worlds.rectangles import stack_runs
from tb2rl.worlds.world import BoxShape


@dataclass(frozen=True)
class Drawing:
    """Content of a drawing; its lower left corner is the origin."""

    boxes: Sequence[BoxShape]
    start: Pose | None
    goal: Pose | None


def read_drawing(text: str, cell: float) -> Drawing:
    """Read a drawing whose characters are squares with sides of `cell` [m]; adjacent walls become larger boxes.

    Raises:
        InputError: For any other character, or a second start or goal.
    """
    lines = text.rstrip(" \n").split("\n")
    marks = {
        mark: ((column - 0.5) * cell, (len(lines) - line + 0.5) * cell, 0.0)
        for mark, (line, column) in _find_marks(lines).items()
    }
    lines.reverse()
    runs = [(row, *run.span()) for row, line in enumerate(lines) for run in re.finditer("#+", line)]
    boxes: list[BoxShape] = []
    for left, right, bottom, top in stack_runs(*np.array(runs, dtype=int).reshape(-1, 3).T).tolist():
        centre = (left + right) / 2 * cell, (bottom + top) / 2 * cell
        boxes.append((*centre, (right - left) * cell, (top - bottom) * cell, 0.0))
    return Drawing(boxes, marks.get("S"), marks.get("G"))


def _find_marks(lines: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Line and column of S and G, from 1."""
    found: dict[str, tuple[int, int]] = {}
    for line, text in enumerate(lines, start=1):
        for match in re.finditer(r"[^#. ]", text):
            mark, column = match[0], match.start() + 1
            place = f"line {line}, column {column}"
            if mark not in "SG":
                allowed = "# (wall), S (start), G (goal), and . or a blank (free floor)"
                raise InputError(f"the drawing has {mark!r} in {place}; it takes {allowed}")
            if mark in found:
                first = "line {}, column {}".format(*found[mark])
                raise InputError(f"the drawing has a second {mark} in {place}; the first is in {first}")
            found[mark] = line, column
    return found
