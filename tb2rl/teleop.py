"""Driving by the terminal's keys, with what the robot reads on the screen."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from tb2rl.actions import action_names
from tb2rl.config import Config
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.observations import ranges_to_bins
from tb2rl.robot import MAX_SPEED, MAX_TURN_RATE, Laser, within_limits
from tb2rl.simulation import Reading
from tb2rl.tasks import Task

STILL = np.zeros(2)  # a command: v [m/s], w [rad/s]
STEERING = {"w": (0.1, 0.0), "s": (-0.1, 0.0), "a": (0.0, 0.5), "d": (0.0, -0.5)}  # what a key adds to the command
_BAR_RANGE, _BAR_SCALE = 5.0, 8  # [m] at which a range's bar ends, [characters/m]


class Teleop:
    """The robot in the user's hands: a command that keys change, and what the robot reads and the task says.

    Args:
        config: The task to drive at, and how it is observed.
        seed: Of the start poses.
    """

    def __init__(self, config: Config, seed: int) -> None:
        self.env = TurtleBot2Env(config.task_settings, config.observation)
        self.edges = config.task_settings.edges if config.observation == "discrete" else None
        self.command = STILL
        self.news = ""
        self.env.reset(seed=seed)
        self.reading = self._advance()

    def step(self) -> None:
        """Drive for a control period; an ending starts again elsewhere."""
        before, task = self.reading, self.env.task
        self.reading = self._advance()
        action = nearest_action(task, self.command)
        outcome = task.judge(before, np.array([action]), self.reading)
        ended = outcome.ending(0, timed_out=False)
        if ended:
            touched = "touched a wall" if self.reading.bumped[0] else f"nearest {self.reading.nearest[0]:.2f} m"
            self.news = f"{ended.upper()} ({touched}): a new start"
            self.command = STILL
            self.env.reset()
            self.reading = self._advance()
        elif self.command.any():
            self.news = f"as action {action_names(task.commands)[action]}: reward {outcome.reward[0]:+g}"

    def lines(self, height: int) -> list[str]:
        """What the terminal shows on at most so many lines."""
        task, reading = self.env.task, self.reading
        head = [
            f"{task.maze}: arrows or w/a/s/d change the speeds, space stops, q ends",
            *reading_lines(reading, self.command),
            self.news,
            "",
        ]
        rows = max(1, height - len(head))
        return [*head, *range_lines(self.env.laser, reading.ranges[0], self.edges, rows)][:height]

    def close(self) -> None:
        self.env.close()

    def _advance(self) -> Reading:
        return self.env.simulation.step(self.command[None], self.env.task.control_period)


def steered(command: np.ndarray, key: str) -> np.ndarray:
    """The command (v [m/s], w [rad/s]) that a key makes of another, within what the base can do, shape (2,)."""
    if key == " ":
        return STILL
    return np.round(within_limits(command + STEERING.get(key, STILL)), 3)


def nearest_action(task: Task, command: np.ndarray) -> int:
    """The task's action that is most like a command."""
    return int(np.abs((task.commands - command) / (MAX_SPEED, MAX_TURN_RATE)).sum(axis=1).argmin())


def reading_lines(reading: Reading, command: np.ndarray) -> list[str]:
    """What is commanded, and what the robot does and reads."""
    (x, y, yaw), (v, w) = reading.pose[0], reading.twist[0]
    bumped = "   BUMPED" if reading.bumped[0] else ""
    return [
        f"command  v {command[0]:+5.2f} m/s   w {command[1]:+5.2f} rad/s",
        f"robot    v {v:+z5.2f} m/s   w {w:+z5.2f} rad/s",
        f"pose     x {x:+5.2f} m     y {y:+5.2f} m       yaw {math.degrees(yaw):+.0f} deg",
        f"nearest  {reading.nearest[0]:.2f} m{bumped}",
    ]


def range_lines(laser: Laser, ranges: np.ndarray, edges: Sequence[float] | None, rows: int) -> list[str]:
    """A bar for each beam, right to left, or for as many as there are rows; with `edges` its distance class."""
    shown = np.unique(np.linspace(0, len(ranges) - 1, min(rows, len(ranges))).round().astype(int))
    classes = None if edges is None else ranges_to_bins(ranges, edges)
    return [
        f"{math.degrees(laser.angles[i]):+4.0f} deg {ranges[i]:6.2f} m "
        f"{'' if classes is None else f'class {classes[i]} '}{'#' * round(min(ranges[i], _BAR_RANGE) * _BAR_SCALE)}"
        for i in shown
    ]


def steer_in_terminal(teleop: Teleop, show: Callable[[np.ndarray], bool]) -> None:
    """Drive by the terminal's keys in real time, until q, Ctrl-C, or `show` of the pose (3,) says that it is over.

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


def _steer(terminal: Any, teleop: Teleop, show: Callable[[np.ndarray], bool]) -> None:
    due = time.monotonic()
    while show(teleop.reading.pose[0]):
        _write(terminal, teleop.lines(terminal.getmaxyx()[0]))
        due = max(due + teleop.env.task.control_period, time.monotonic())
        for key in _keys_until(terminal, due):
            if key == "q":
                return
            teleop.command = steered(teleop.command, key)
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
