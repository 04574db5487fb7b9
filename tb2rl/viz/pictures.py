"""Pictures from above with the paths of many episodes."""

from collections.abc import Sequence

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluation import Episode
from tb2rl.rendering.above import SIDE, Canvas, draw_goal, draw_routes, make_grid
from tb2rl.rendering.colours import FAILED, PATH, START
from tb2rl.worlds import World

_PATH_MARGIN = 0.5  # [m] minimum distance between a path and extended bounds
_MAX_LARGE_PICTURES = 6  # in a grid; with more pictures, all are half as large


def draw_paths(scene: Scene, episodes: Sequence[Episode]) -> np.ndarray:
    """Draw paths with their starts, goals, routes of dynamic obstacles, and a red dot at the end of a failed episode.

    Args:
        scene: The scene of the episodes. Each world in which episodes took place has a picture in a grid.
        episodes: At least one episode.

    Returns:
        Shape (height, width, 3), uint8.
    """
    by_world = group_by_world(episodes)
    pictures = [_draw_world(scene, world, world_episodes) for world, world_episodes in by_world.items()]
    side = SIDE if len(pictures) <= _MAX_LARGE_PICTURES else SIDE // 2
    return make_grid(pictures, [scene.spec.worlds[world].name for world in by_world], side=side)


def _draw_world(scene: Scene, world: int, episodes: Sequence[Episode]) -> np.ndarray:
    canvas = Canvas(scene.spec.worlds[world])
    draw_routes(canvas, scene.spec.dynamic_obstacles_in(world))
    for goal in goals_in(scene, world, episodes):
        draw_goal(canvas, goal)
    for episode in episodes:
        canvas.line(episode.path, PATH, 0.02)
    for episode in episodes:
        (x, y), (end_x, end_y) = episode.path[0], episode.path[-1]
        canvas.disc(x, y, 0.08, START)
        if episode.failed:
            canvas.disc(end_x, end_y, 0.12, FAILED)
    return canvas.array()


def group_by_world(episodes: Sequence[Episode]) -> dict[int, list[Episode]]:
    """Group episodes by the index of their world, in the order of the first episode in each world."""
    worlds = dict.fromkeys(episode.world for episode in episodes)
    return {world: [episode for episode in episodes if episode.world == world] for world in worlds}


def goals_in(scene: Scene, world: int, episodes: Sequence[Episode]) -> list[tuple[float, float]]:
    """The different goals x, y [m] of episodes in a world; empty for a task without a goal."""
    goals = {episode.goal or scene.goal_in(world) for episode in episodes}  # a stored episode may lack its goal
    return sorted(goal for goal in goals if goal is not None)


def extend_bounds(world: World, path: np.ndarray) -> World:
    """Extend the bounds of a world to contain a path x, y [m], shape (n, 2)."""
    low = np.minimum(world.bounds[:2], path.min(axis=0) - _PATH_MARGIN)
    high = np.maximum(world.bounds[2:], path.max(axis=0) + _PATH_MARGIN)
    return world.with_changes(None, None, (*low.tolist(), *high.tolist()))  # None: keep start and goal
