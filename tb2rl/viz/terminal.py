"""The keyboard and the screen of a terminal, for driving in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation import InitialState
from tb2rl.viz.keyboard import Teleop

# Of the start of the episode, a pose (3,) and the movers (movers, 6) or None; False: it is over.
Show = Callable[[InitialState, np.ndarray, np.ndarray | None], bool]


def steer_in_terminal(teleop: Teleop, show: Show) -> None:
    """Drive by the terminal's keys in real time, until q, Ctrl-C, or `show` says that it is over.

    Raises:
        InputError: If there is no terminal that this can be done in.
    """
    try:
        import curses  # not on Windows

        curses.setupterm()
    except (ImportError, curses.error) as error:
        raise InputError(f"--teleop cannot use this terminal: {error}") from None
    with suppress(KeyboardInterrupt):
        curses.wrapper(_steer, teleop, show)


def _steer(terminal: Any, teleop: Teleop, show: Show) -> None:
    due = time.monotonic()
    while show(teleop.robot_state.initial_state, teleop.robot_state.pose[0], teleop.dynamic_obstacles):
        _write(terminal, teleop.lines(terminal.getmaxyx()[0]))
        due = max(due + teleop.scene.task.control_period, time.monotonic())
        for key in _keys_until(terminal, due):
            if key == "q":
                return
            teleop.steer(key)
        teleop.step()


def _keys_until(terminal: Any, due: float) -> Iterator[str]:
    """The keys that are pressed until a time of the monotonic clock; arrows as w, a, s, d."""
    import curses

    arrows = {curses.KEY_UP: "w", curses.KEY_LEFT: "a", curses.KEY_DOWN: "s", curses.KEY_RIGHT: "d"}
    while (remaining := due - time.monotonic()) > 0:
        terminal.timeout(max(1, round(1000 * remaining)))
        code = terminal.getch()
        if code >= 0:
            yield arrows.get(code) or chr(code).lower()


def _write(terminal: Any, lines: Sequence[str]) -> None:
    terminal.erase()
    for row, line in enumerate(lines):
        terminal.insnstr(row, 0, line, terminal.getmaxyx()[1])  # addnstr fails in the last corner
    terminal.refresh()
