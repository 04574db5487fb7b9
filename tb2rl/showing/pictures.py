"""The paths of many episodes, seen from above, and the goal that an episode shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.pictures.above import draw_goal, draw_routes
from tb2rl.pictures.canvas import Canvas
from tb2rl.pictures.colours import FAILED, PATH, START
from tb2rl.simulation import Start
from tb2rl.tasks import Task


def draw_paths(
    scene: Scene, paths: Sequence[np.ndarray], failed: Sequence[bool], worlds: Sequence[int] | None = None
) -> np.ndarray:
    """The paths of episodes, a dot at each start, a red one at the end of each that failed; movers' paths are faint.

    Args:
        scene: Where they drove.
        paths: One an episode, shape (steps + 1, 2 or 3), x and y first [m].
        failed: Whether its ending counts as failed.
        worlds: Index of its world, each of which is a picture beside the others; None: all drove in the first.

    Returns:
        Shape (height, width, 3), uint8.
    """
    together: dict[int, list[tuple[np.ndarray, bool]]] = {}
    for path, has_failed, world in zip(paths, failed, worlds or [0] * len(paths), strict=True):
        together.setdefault(world, []).append((path, has_failed))
    return _beside([_draw_in(scene, world, driven) for world, driven in together.items()])


def _draw_in(scene: Scene, world: int, driven: Sequence[tuple[np.ndarray, bool]]) -> np.ndarray:
    """The paths in one world, each with whether it failed."""
    canvas = Canvas(scene.setup.worlds[world])
    draw_routes(canvas, scene.setup.movers_in(world))
    draw_goal(canvas, scene.goal_in(world))
    for path, _ in driven:
        if len(path) > 1:
            canvas.line(path, PATH, 0.02)
    for path, has_failed in driven:
        canvas.disc(path[0][0], path[0][1], 0.08, START)
        if has_failed:
            canvas.disc(path[-1][0], path[-1][1], 0.12, FAILED)
    return canvas.array()


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures side by side, the lower ones with white below."""
    height = max(len(picture) for picture in pictures)
    below = [((0, height - len(picture)), (0, 0), (0, 0)) for picture in pictures]
    return np.hstack([np.pad(*each, constant_values=255) for each in zip(pictures, below, strict=True)])


def goal_of(task: Task, start: Start) -> np.ndarray:
    """The goal of the first robot that began so, x, y [m], shape (2,); NaN for a task without a goal."""
    return start.goal[0] if task.goal_task else np.full(2, np.nan)
