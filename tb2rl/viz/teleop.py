"""Teleoperation in a terminal: keys change the command, and the screen shows the robot's state as text."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import ranges_to_bins
from tb2rl.envs.scene import Scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.robots import Laser, Robot
from tb2rl.simulation import InitialState, RobotState, default_simulator

ZERO = np.zeros(2)  # a command: v [m/s], w [rad/s]
KEYS = {"w": (0.1, 0.0), "s": (-0.1, 0.0), "a": (0.0, 0.5), "d": (0.0, -0.5)}  # changes of the command
_BAR_RANGE, _BAR_SCALE = 5.0, 8  # [m] longest bar of a range, [characters/m]

# Takes the episode's initial state, a pose (3,) and dynamic obstacles (obstacles, 6) or None; returns False to end.
Show = Callable[[InitialState, np.ndarray, np.ndarray | None], bool]


class Teleop:
    """A robot driven by keys, and the task's reward and endings.

    Args:
        scene: The robot, the worlds and the task.
        seed: Of the initial states.
        simulation: A simulator's name; None: see `default_simulator`.
    """

    def __init__(self, scene: Scene, seed: int, simulation: str | None = None) -> None:
        self.scene, self.env = scene, TurtleBot2Env(scene, simulation=simulation or default_simulator())
        self.command = ZERO
        self.message = ""
        self.env.reset(seed=seed)
        self.robot_state = self._advance()

    def step(self) -> None:
        """Drive for a control period; an episode that ends is followed by another one."""
        before, actions = self.robot_state, self.scene.actions
        self.robot_state = self._advance()
        action = actions.nearest(self.command)
        outcome = self.scene.task.outcome(before, actions.checked(action), self.robot_state)
        ending = outcome.ending(0, timed_out=False)
        if ending:
            self.message = f"{ending.name.upper()} ({_contact(self.robot_state)}): new episode"
            self.command = ZERO
            self.env.reset()
            self.robot_state = self._advance()
        elif self.command.any():
            self.message = f"as action {actions.describe(action)}: reward {outcome.reward[0]:+g}"

    @property
    def dynamic_obstacles(self) -> np.ndarray | None:
        """Outlines as in `RobotState.dynamic_obstacles`, shape (obstacles, 6)."""
        return None if self.robot_state.dynamic_obstacles is None else self.robot_state.dynamic_obstacles[0]

    def lines(self, height: int) -> list[str]:
        """The terminal's content, at most `height` lines."""
        head = [
            f"{self.scene.place}: arrows or w/a/s/d change the speeds, space stops, q ends",
            *state_lines(self.robot_state, self.command),
            self.message,
            "",
        ]
        bins = self.scene.task.range_bins if self.scene.observation == "discrete" else None
        rows = max(1, height - len(head))
        return [*head, *range_lines(self.scene.laser, self.robot_state.ranges[0], bins, rows)][:height]

    def press(self, key: str) -> None:
        """Change the command."""
        self.command = changed_command(self.scene.robot, self.command, key)

    def close(self) -> None:
        self.env.close()

    def _advance(self) -> RobotState:
        return self.env.simulator.step(self.command[None], self.scene.task.control_period)


def changed_command(robot: Robot, command: np.ndarray, key: str) -> np.ndarray:
    """The command (v [m/s], w [rad/s]) after a key, within the robot's limits, shape (2,)."""
    if key == " ":
        return ZERO
    return np.round(robot.within_limits(command + KEYS.get(key, ZERO)), 3)


def _contact(robot_state: RobotState) -> str:
    if not robot_state.bumped[0]:
        return f"nearest {robot_state.nearest[0]:.2f} m"
    by_dynamic = robot_state.nearest_is_dynamic is not None and robot_state.nearest_is_dynamic[0]
    return f"touched {'a dynamic obstacle' if by_dynamic else 'a wall'}"


def state_lines(robot_state: RobotState, command: np.ndarray) -> list[str]:
    """The command and the robot's state."""
    (x, y, yaw), (v, w) = robot_state.pose[0], robot_state.twist[0]
    bumped = "   BUMPED" if robot_state.bumped[0] else ""
    return [
        f"command  v {command[0]:+5.2f} m/s   w {command[1]:+5.2f} rad/s",
        f"robot    v {v:+z5.2f} m/s   w {w:+z5.2f} rad/s",
        f"pose     x {x:+5.2f} m     y {y:+5.2f} m       yaw {math.degrees(yaw):+.0f} deg",
        f"nearest  {robot_state.nearest[0]:.2f} m{bumped}",
    ]


def range_lines(laser: Laser, ranges: np.ndarray, bins: Sequence[float] | None, rows: int) -> list[str]:
    """A bar for each beam, right to left, or for `rows` of the beams.

    Args:
        laser: Beam angles.
        ranges: Shape (beams,) [m].
        bins: Borders of the range bins [m]; None: no bins.
        rows: Most lines.
    """
    shown = np.unique(np.linspace(0, len(ranges) - 1, min(rows, len(ranges))).round().astype(int))
    classes = [""] * len(ranges) if bins is None else [f"bin {i} " for i in ranges_to_bins(ranges, bins)]
    return [
        f"{math.degrees(laser.angles[i]):+4.0f} deg {ranges[i]:6.2f} m "
        f"{classes[i]}{'#' * round(min(ranges[i], _BAR_RANGE) * _BAR_SCALE)}"
        for i in shown
    ]


def steer_in_terminal(teleop: Teleop, show: Show) -> None:
    """Drive by the terminal's keys in real time, until q, Ctrl-C, or `show` returns False.

    Raises:
        InputError: If the terminal cannot be used.
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
        height, width = terminal.getmaxyx()
        terminal.erase()
        for row, line in enumerate(teleop.lines(height)):
            terminal.insnstr(row, 0, line, width)  # addnstr fails in the last corner
        terminal.refresh()
        due = max(due + teleop.scene.task.control_period, time.monotonic())
        for key in _keys_until(terminal, due):
            if key == "q":
                return
            teleop.press(key)
        teleop.step()


def _keys_until(terminal: Any, due: float) -> Iterator[str]:
    """Keys pressed until a time of the monotonic clock; arrows as w, a, s, d."""
    import curses

    arrows = {curses.KEY_UP: "w", curses.KEY_LEFT: "a", curses.KEY_DOWN: "s", curses.KEY_RIGHT: "d"}
    while (remaining := due - time.monotonic()) > 0:
        terminal.timeout(max(1, round(1000 * remaining)))
        code = terminal.getch()
        if code >= 0:
            yield arrows.get(code) or chr(code).lower()
