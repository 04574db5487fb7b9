"""PyBullet's window: what a policy or the user drives, shown as fast as it happens."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import main_hidden
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.moments import Moment
from tb2rl.simulation import InitialState, check_bullet, default_simulator
from tb2rl.viz.pictures import goal_of
from tb2rl.viz.shots import shots

_RATE = 30  # poses a second
_OPENING = 60.0  # [s] that a window may take to open


class Window:
    """PyBullet's window in a process of its own, which PyBullet ends as it likes.

    Args:
        scene: The robot and the worlds to show, and the task that says whether there is a goal.
        camera: "above" looks at the whole world, "chase" over the robot's shoulder.

    Raises:
        InputError: If the window cannot be opened.
    """

    def __init__(self, scene: Scene, camera: str = "above") -> None:
        check_bullet("the window")
        from tb2rl.viz.stage import show  # PyBullet may be missing

        self._task = scene.task
        context = multiprocessing.get_context("spawn")  # clean, and without torch: it opens in a second
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=show, args=(theirs, scene.spec, camera == "chase"), daemon=True)
        with main_hidden():
            self._process.start()
        theirs.close()
        if not self._has_opened():
            self.close()
            raise InputError(
                "PyBullet's window does not open on this display, it needs OpenGL; --video FILE.mp4 writes a film, "
                "and without the variable DISPLAY nothing asks for a window"
            )

    def show(self, initial_state: InitialState, pose: np.ndarray, dynamic_obstacles: np.ndarray | None = None) -> bool:
        """Show the robot at a pose (3,) of the episode that began so; False once the user has closed the window.

        `dynamic_obstacles` (movers, 6) are the outlines of what moves, see `RobotState.dynamic_obstacles`.
        """
        try:
            self._pipe.send((int(initial_state.world[0]), goal_of(self._task, initial_state), pose, dynamic_obstacles))
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the window."""
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=5.0)
        self._process.kill()
        self._pipe.close()

    def _has_opened(self) -> bool:
        try:
            return self._pipe.poll(_OPENING) and self._pipe.recv()
        except (EOFError, OSError):  # the process has ended
            return False


def has_display() -> bool:
    """Whether PyBullet's window can be expected to open; only on Linux a variable tells."""
    return default_simulator() == "bullet" and (
        not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY"))
    )


def watch(drives: Iterable[Iterator[Moment]], period: float, window: Window, speed: float) -> None:
    """Show episodes in a window until the user closes it.

    Args:
        drives: The control steps of each.
        period: Of a control step [s].
        window: Where they are shown.
        speed: How many times as fast as they happened.
    """
    for moments in drives:
        due = time.monotonic()
        for shot in shots(moments, period, _RATE, speed):
            if not window.show(shot.moment.initial_state, shot.pose, shot.dynamic_obstacles):
                return
            due += 1 / _RATE
            time.sleep(max(0.0, due - time.monotonic()))
