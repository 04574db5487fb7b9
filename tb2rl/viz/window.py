"""PyBullet's window, which shows a robot in real time."""

import multiprocessing
import os
import sys
import time
from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.processes import hide_main_script
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import EpisodeStep
from tb2rl.simulation import InitialState
from tb2rl.simulation.bullet import SIMULATOR
from tb2rl.simulation.simulator import default_simulator
from tb2rl.viz.cameras import film_frames, goal_of

_RATE = 30  # frames per second
_OPENING_TIMEOUT = 60.0  # [s]


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
    display_is_set = not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY"))  # on Linux only
    return display_is_set and default_simulator().has_window
