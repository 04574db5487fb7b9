"""PyBullet's window, which shows a policy or a user driving in real time."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import main_hidden
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.moments import Moment
from tb2rl.simulation import InitialState, default_simulator
from tb2rl.simulation.bullet import SIMULATOR
from tb2rl.viz.film_frames import film_frames, goal_of

_RATE = 30  # poses a second
_OPENING_TIMEOUT = 60.0  # [s]


class Window:
    """PyBullet's window in a process of its own, because PyBullet ends its process with the window.

    Args:
        scene: The robot, the worlds and the task, which may have a goal.
        camera: "above" shows the whole world, "chase" looks over the robot's shoulder.

    Raises:
        InputError: If the window cannot be opened.
    """

    def __init__(self, scene: Scene, camera: str = "above") -> None:
        SIMULATOR.check("the window")
        from tb2rl.viz.scene_view import run_window  # PyBullet may be missing

        self._scene = scene
        context = multiprocessing.get_context("spawn")  # opens in a second, because it does not import torch
        self._pipe, other_end = context.Pipe()
        self._process = context.Process(target=run_window, args=(other_end, scene.spec, camera == "chase"), daemon=True)
        with main_hidden():
            self._process.start()
        other_end.close()
        try:
            is_open = self._pipe.poll(_OPENING_TIMEOUT) and self._pipe.recv()
        except (EOFError, OSError):  # the process has ended
            is_open = False
        if not is_open:
            self.close()
            raise InputError(
                "PyBullet's window does not open on this display, because it needs OpenGL; use --video FILE.mp4, or "
                "unset DISPLAY to get a film instead of a window"
            )

    def show(self, initial_state: InitialState, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> bool:
        """Show the robot at a pose (3,), and outlines of dynamic obstacles (obstacles, 6).

        Returns:
            False once the user has closed the window.
        """
        goal = goal_of(self._scene.task, initial_state)
        try:
            self._pipe.send((int(initial_state.world[0]), goal, pose, dynamic_obstacles))
        except OSError:
            return False
        return True

    def watch(self, episodes: Iterable[Iterable[Moment]], speed: float) -> None:
        """Show episodes at a playback speed until the user closes the window."""
        for moments in episodes:
            due = time.monotonic()
            for frame in film_frames(moments, self._scene.task.control_period, _RATE, speed):
                if not self.show(frame.initial_state, frame.pose, frame.dynamic_obstacles):
                    return
                due += 1 / _RATE
                time.sleep(max(0.0, due - time.monotonic()))

    def close(self) -> None:
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=5.0)
        self._process.kill()
        self._pipe.close()


def has_display() -> bool:
    """Whether PyBullet's window can be expected to open; on Linux an environment variable tells."""
    display = not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY"))
    return display and default_simulator().has_window
