"""Pictures of the paths of many episodes from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluation import Episode
from tb2rl.rendering.above import draw_goal, draw_routes
from tb2rl.rendering.canvas import Canvas
from tb2rl.rendering.colours import FAILED, PATH, START

_COLUMNS = 6  # worlds in a row


def draw_paths(scene: Scene, episodes: Sequence[Episode]) -> np.ndarray:
    """Draw paths, a dot at each start, a red dot at the end of each failed episode, and routes of dynamic obstacles.

    Args:
        scene: The scene of the episodes; each of its worlds has a picture, side by side and in rows.
        episodes: At least one.

    Returns:
        Shape (height, width, 3), uint8.
    """
    by_world = group_by_world(episodes).items()
    pictures = [Image.fromarray(_draw_world(scene, world, driven)) for world, driven in by_world]
    if len(pictures) > _COLUMNS:
        pictures = [picture.reduce(2) for picture in pictures]
    rows = [pictures[i : i + _COLUMNS] for i in range(0, len(pictures), _COLUMNS)]
    width = max(sum(picture.width for picture in row) for row in rows)
    heights = [max(picture.height for picture in row) for row in rows]
    grid, top = Image.new("RGB", (width, sum(heights)), "white"), 0
    for row, height in zip(rows, heights, strict=True):
        left = 0
        for picture in row:
            grid.paste(picture, (left, top))
            left += picture.width
        top += height
    return np.array(grid)


def _draw_world(scene: Scene, world: int, episodes: Sequence[Episode]) -> np.ndarray:
    canvas = Canvas(scene.spec.worlds[world])
    draw_routes(canvas, scene.spec.dynamic_obstacles_in(world))
    for goal in goals_in(scene, world, episodes):
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


def group_by_world(episodes: Sequence[Episode]) -> dict[int, list[Episode]]:
    """Episodes by the index of their world, in the order of the worlds' first episodes."""
    by_world: dict[int, list[Episode]] = {}
    for episode in episodes:
        by_world.setdefault(episode.world, []).append(episode)
    return by_world


def goals_in(scene: Scene, world: int, episodes: Sequence[Episode]) -> list[tuple[float, float]]:
    """Goals of the episodes in a world, x, y [m], without duplicates; empty for a task without a goal."""
    goals = {episode.goal or scene.goal_in(world) for episode in episodes}
    return sorted(goal for goal in goals if goal is not None)
