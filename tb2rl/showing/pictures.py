"""The paths of many episodes, seen from above, and the goal that an episode shows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.pictures.above import draw_goal
from tb2rl.pictures.canvas import Canvas
from tb2rl.pictures.colours import FAILED, PATH, START
from tb2rl.simulation import Start
from tb2rl.tasks import Task


def draw_paths(scene: Scene, paths: Iterable[np.ndarray], failed: Iterable[bool]) -> np.ndarray:
    """The paths of episodes, a dot at each start and a red one at the end of each that failed.

    Args:
        scene: Where they drove.
        paths: One an episode, shape (steps + 1, 2 or 3), x and y first [m].
        failed: Whether its ending counts as failed.

    Returns:
        Shape (height, width, 3), uint8.
    """
    canvas = Canvas(scene.world)
    draw_goal(canvas, scene.goal)
    paths = list(paths)
    for path in paths:
        if len(path) > 1:
            canvas.line(path, PATH, 0.02)
    for path, has_failed in zip(paths, failed, strict=True):
        canvas.disc(path[0][0], path[0][1], 0.08, START)
        if has_failed:
            canvas.disc(path[-1][0], path[-1][1], 0.12, FAILED)
    return canvas.array()


def goal_of(task: Task, start: Start) -> np.ndarray:
    """The goal of the first robot that began so, x, y [m], shape (2,); NaN for a task without a goal."""
    return start.goal[0] if task.goal_task else np.full(2, np.nan)
