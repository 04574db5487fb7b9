"""The paths of many episodes, seen from above, and the goal that an episode shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluation import Episode
from tb2rl.rendering.above import draw_goal, draw_routes
from tb2rl.rendering.canvas import Canvas
from tb2rl.rendering.colours import FAILED, PATH, START
from tb2rl.simulation import InitialState
from tb2rl.tasks import Task

_ABREAST = 6  # worlds in a row


def draw_paths(scene: Scene, episodes: Sequence[Episode]) -> np.ndarray:
    """The paths of episodes, a dot at each start, a red one at the end of each that failed; movers' paths are faint.

    Args:
        scene: Where they drove; each of the worlds is a picture beside the others, in rows.
        episodes: At least one.

    Returns:
        Shape (height, width, 3), uint8.
    """
    together: dict[int, list[Episode]] = {}
    for episode in episodes:
        together.setdefault(episode.world, []).append(episode)
    return _in_rows([_draw_in(scene, world, driven) for world, driven in together.items()])


def _draw_in(scene: Scene, world: int, episodes: Sequence[Episode]) -> np.ndarray:
    """The paths in one world."""
    canvas = Canvas(scene.spec.worlds[world])
    draw_routes(canvas, scene.spec.dynamic_obstacles_in(world))
    for goal in goals_of(scene, world, episodes):
        draw_goal(canvas, goal)
    for episode in episodes:
        if len(episode.path) > 1:
            canvas.line(episode.path, PATH, 0.02)
    for episode in episodes:
        (x, y), (end_x, end_y) = episode.path[0], episode.path[-1]
        canvas.disc(x, y, 0.08, START)
        if episode.failed:
            canvas.disc(end_x, end_y, 0.12, FAILED)
    return canvas.array()


def goals_of(scene: Scene, world: int, episodes: Sequence[Episode]) -> list[tuple[float, float]]:
    """Where the episodes in a world were to get, x, y [m], each place once; empty for a task without a goal."""
    goals = {episode.goal or scene.goal_in(world) for episode in episodes}
    return sorted(goal for goal in goals if goal is not None)


def _in_rows(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures side by side, those of many worlds half as large and in rows; white beside and below smaller ones."""
    if len(pictures) > _ABREAST:
        pictures = [np.array(Image.fromarray(picture).reduce(2)) for picture in pictures]
    rows = [np.hstack(_as_large(pictures[i : i + _ABREAST], 0)) for i in range(0, len(pictures), _ABREAST)]
    return np.vstack(_as_large(rows, 1))


def _as_large(pictures: Sequence[np.ndarray], axis: int) -> list[np.ndarray]:
    """Pictures with white after their end along an axis, up to where the largest ends."""
    largest = max(picture.shape[axis] for picture in pictures)
    after = [[(0, largest - picture.shape[i] if i == axis else 0) for i in range(3)] for picture in pictures]
    return [np.pad(*each, constant_values=255) for each in zip(pictures, after, strict=True)]


def goal_of(task: Task, initial_state: InitialState) -> np.ndarray:
    """The goal of the first robot that began so, x, y [m], shape (2,); NaN for a task without a goal."""
    return initial_state.goal[0] if task.goal_task else np.full(2, np.nan)
