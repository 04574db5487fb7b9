"""Real-time drives: PyBullet's window, and teleoperation in a terminal."""

import math
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import hide_main_script
from tb2rl.envs.encodings import ranges_to_bins
from tb2rl.envs.scene import Scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.evaluation.episodes import EpisodeStep
from tb2rl.robots import Laser
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.bullet import SIMULATOR
from tb2rl.simulation.simulator import default_simulator
from tb2rl.viz.cameras import film_frames, goal_of

_RATE = 30  # frames per second
_OPENING_TIMEOUT = 60.0  # [s]
KEYS = {"w": (0.1, 0.0), "s": (-0.1, 0.0), "a": (0.0, 0.5), "d": (0.0, -0.5)}  # changes of v [m/s], w [rad/s]
_MAX_BAR_RANGE, _BAR_SCALE = 5.0, 8  # range of the longest bar [m], length of bars [characters/m]

# Arguments: initial state; pose (3,); dynamic obstacles (obstacles, 6) or None. Returns False to end the drive.
Show = Callable[[InitialState, np.ndarray, np.ndarray | None], bool]


class Window:
    """PyBullet's window in a separate process, because PyBullet ends its process when the user closes the window.

    Args:
        scene: The robot, the worlds and the task.
        camera: "above" shows the whole world, "chase" looks over the robot's shoulder.

    Raises:
        InputError: If the window cannot be opened.
    """

    def __init__(self, scene: Scene, camera: str = "above") -> None:
        SIMULATOR.check("the window")
        from tb2rl.viz.scene_view import run_window  # imports PyBullet, which may be missing

        self._scene = scene
        context = multiprocessing.get_context("spawn")  # starts within a second, because torch is not imported
        self._pipe, child_end = context.Pipe()
        self._process = context.Process(target=run_window, args=(child_end, scene.spec, camera == "chase"), daemon=True)
        with hide_main_script():
            self._process.start()
        child_end.close()
        with suppress(EOFError, OSError):  # the process has ended
            if self._pipe.poll(_OPENING_TIMEOUT) and self._pipe.recv():
                return
        self.close()
        raise InputError("PyBullet's window needs a display with OpenGL; use --video FILE.mp4, or unset DISPLAY")

    def show(self, initial_state: InitialState, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> bool:
        """Show the robot at a pose (3,), and dynamic obstacles by their outlines (obstacles, 6).

        Returns:
            False once the user has closed the window.
        """
        goal = goal_of(self._scene.task, initial_state)
        try:
            self._pipe.send((int(initial_state.world[0]), goal, pose, dynamic_obstacles))
        except OSError:
            return False
        return True

    def watch(self, episodes: Iterable[Iterable[EpisodeStep]], speed: float) -> None:
        """Show episodes at a playback speed, until they end or the user closes the window."""
        for steps in episodes:
            next_frame_time = time.monotonic()
            for frame in film_frames(steps, self._scene.task.control_period, _RATE, speed):
                if not self.show(frame.step.after.initial_state, frame.pose, frame.dynamic_obstacles):
                    return
                next_frame_time += 1 / _RATE
                time.sleep(max(0.0, next_frame_time - time.monotonic()))

    def close(self) -> None:
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=5.0)
        self._process.kill()
        self._pipe.close()


def has_display() -> bool:
    """Whether there is probably a display, and the default simulator has a window."""
    display_is_set = not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY"))  # only Linux needs it
    return display_is_set and default_simulator().has_window


class Teleop:
    """A simulated robot whose command is changed by keys, with the task's reward and endings.

    Args:
        scene: The robot, the worlds and the task.
        seed: Seed of the initial states.
        simulation: Name of a simulator; None: `default_simulator`.
    """

    command: np.ndarray  # v [m/s], w [rad/s], shape (2,)
    robot_state: RobotState  # latest state

    def __init__(self, scene: Scene, seed: int, simulation: str | None = None) -> None:
        self.scene, self.env = scene, TurtleBot2Env(scene, simulation=simulation or default_simulator())
        self._message = ""
        self._reset(seed)

    def step(self) -> None:
        """Simulate a control period; when an episode ends, start another one."""
        before, actions = self.robot_state, self.scene.actions
        self.robot_state = self._simulate()
        action = actions.nearest(self.command)
        outcome = self.scene.task.outcome(before, actions.checked(action), self.robot_state)
        ending = outcome.ending(0, timed_out=False)
        if ending:
            self._message = f"{ending.name.upper()} ({_describe_contact(self.robot_state)}): new episode"
            self._reset()
        elif self.command.any():
            self._message = f"rewarded as action {actions.describe(action)}: {outcome.reward[0]:+g}"

    @property
    def dynamic_obstacles(self) -> np.ndarray | None:
        """Outlines (obstacles, 6) as in `RobotState.dynamic_obstacles`; None without dynamic obstacles."""
        return None if self.robot_state.dynamic_obstacles is None else self.robot_state.dynamic_obstacles[0]

    def lines(self, height: int) -> list[str]:
        """The content of the terminal, at most `height` lines."""
        scene, robot_state = self.scene, self.robot_state
        (x, y, yaw), (v, w) = robot_state.pose[0], robot_state.twist[0]
        header = [
            f"{scene.worlds_title}: arrows or w/a/s/d change the speeds, space stops, q ends",
            f"command  v {self.command[0]:+5.2f} m/s   w {self.command[1]:+5.2f} rad/s",
            f"robot    v {v:+z5.2f} m/s   w {w:+z5.2f} rad/s",
            f"pose     x {x:+5.2f} m     y {y:+5.2f} m       yaw {math.degrees(yaw):+.0f} deg",
            f"nearest  {robot_state.nearest_range[0]:.2f} m{'   BUMPED' if robot_state.bumped[0] else ''}",
            self._message,
            "",
        ]
        bins = scene.task.range_bins if scene.observation == "discrete" else None
        ranges = range_lines(scene.laser, robot_state.ranges[0], bins, max(1, height - len(header)))
        return [*header, *ranges][:height]

    def press(self, key: str) -> None:
        """Change the command, within the robot's limits."""
        new_command = self.command + KEYS.get(key, 0.0)
        self.command = np.zeros(2) if key == " " else np.round(self.scene.robot.clip_commands(new_command), 3)

    def close(self) -> None:
        self.env.close()

    def _reset(self, seed: int | None = None) -> None:
        self.command = np.zeros(2)
        self.env.reset(seed=seed)
        self.robot_state = self._simulate()  # one control period at rest

    def _simulate(self) -> RobotState:
        return self.env.simulator.step(self.command[None], self.scene.task.control_period)


def _describe_contact(robot_state: RobotState) -> str:
    if not robot_state.bumped[0]:
        return f"nearest {robot_state.nearest_range[0]:.2f} m"
    is_dynamic = robot_state.nearest_is_dynamic is not None and robot_state.nearest_is_dynamic[0]
    return f"touched {'a dynamic obstacle' if is_dynamic else 'a wall'}"


def range_lines(laser: Laser, ranges: np.ndarray, bins: Sequence[float] | None, max_lines: int) -> list[str]:
    """Lines with the angle, range and bar of beams, from right to left.

    Args:
        laser: The laser.
        ranges: Ranges [m], shape (beams,).
        bins: Borders of the range bins [m]; None: no bins.
        max_lines: Maximum number of lines; with more beams, evenly spaced ones are selected.
    """
    selected = np.unique(np.linspace(0, len(ranges) - 1, min(max_lines, len(ranges))).round().astype(int))
    bin_texts = [""] * len(ranges) if bins is None else [f"bin {i} " for i in ranges_to_bins(ranges, bins)]
    bars = ["#" * round(min(distance, _MAX_BAR_RANGE) * _BAR_SCALE) for distance in ranges]
    angles = np.degrees(laser.angles)
    return [f"{angles[i]:+4.0f} deg {ranges[i]:6.2f} m {bin_texts[i]}{bars[i]}" for i in selected]


def steer_in_terminal(teleop: Teleop, show: Show) -> None:
    """Steer by the terminal's keys in real time, until the user presses q or Ctrl-C, or `show` returns False.

    Raises:
        InputError: If the terminal cannot be used.
    """
    try:
        import curses
    except ImportError:
        raise InputError("--teleop needs Python's module curses, which Windows lacks") from None
    try:
        curses.setupterm()
    except curses.error as error:
        raise InputError(f"--teleop cannot use this terminal: {error}") from None
    arrows = {curses.KEY_UP: "w", curses.KEY_LEFT: "a", curses.KEY_DOWN: "s", curses.KEY_RIGHT: "d"}
    with suppress(KeyboardInterrupt):
        curses.wrapper(_steer, teleop, show, arrows)


def _steer(terminal: Any, teleop: Teleop, show: Show, arrows: dict[int, str]) -> None:
    next_step_time = time.monotonic()
    while show(teleop.robot_state.initial_state, teleop.robot_state.pose[0], teleop.dynamic_obstacles):
        height, width = terminal.getmaxyx()
        terminal.erase()
        for row, line in enumerate(teleop.lines(height)):
            terminal.insnstr(row, 0, line, width)  # because addnstr fails in the bottom right corner
        terminal.refresh()
        next_step_time = max(next_step_time + teleop.scene.task.control_period, time.monotonic())
        while (remaining := next_step_time - time.monotonic()) > 0:
            terminal.timeout(max(1, round(1000 * remaining)))
            code = terminal.getch()  # -1: no key was pressed
            key = arrows.get(code) or (chr(code).lower() if code >= 0 else "")
            if key == "q":
                return
            if key:
                teleop.press(key)
        teleop.step()
