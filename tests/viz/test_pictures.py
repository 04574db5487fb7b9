"""Pictures of paths mark the starts, the ends of failed episodes, and the goal of a task that has one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.rendering.colours import FAILED, GOAL, PATH, START
from tb2rl.viz.pictures import draw_paths

PATHS = [np.array([(0.0, 1.0), (1.0, 2.0), (1.5, 2.0)]), np.array([(0.0, -2.0), (2.0, -2.0)])]


def centres(scene, picture: np.ndarray, colour: str) -> tuple[float, float] | None:
    """Centre of the pixels with the colour, x, y [m]; None if there are none."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero((np.abs(picture.astype(int) - wanted) < 12).all(axis=2))
    if not len(rows):
        return None
    x0, _, x1, y1 = scene.world.bounds
    scale = picture.shape[1] / (x1 - x0 + 0.6)
    left, right, top, bottom = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
    return (left + right) / 2 / scale + x0 - 0.3, y1 + 0.3 - (top + bottom) / 2 / scale


@pytest.fixture
def driven(make):
    """A function that makes episodes along `PATHS`, or other paths, in worlds."""

    def of(failed=(False, False), worlds=(0, 0), paths=PATHS, goal=None):
        episodes = [
            make.episode(path, np.zeros(len(path) - 1, int), failed=f) for path, f in zip(paths, failed, strict=True)
        ]
        return [replace(each, world=world, goal=goal) for each, world in zip(episodes, worlds, strict=True)]

    return of


def test_the_ends_of_failed_episodes_are_marked(make, driven):
    scene = make.config("wall").scene
    picture = draw_paths(scene, driven((False, True)))
    assert centres(scene, picture, FAILED) == pytest.approx(PATHS[1][-1], abs=0.02)
    assert centres(scene, picture, START) == pytest.approx((0.0, -0.5), abs=0.02), "between the two starts"
    assert centres(scene, picture, GOAL) == pytest.approx((5.0, 0.0), abs=0.02)
    assert centres(scene, picture, PATH) is not None


def test_the_goal_is_that_of_the_episode_and_only_tasks_with_a_goal_show_one(make, driven):
    scene = make.config("navigate", world="wall").scene
    picture = draw_paths(scene, driven(goal=(2.0, 1.0)))
    assert centres(scene, picture, GOAL) == pytest.approx((2.0, 1.0), abs=0.02)
    assert centres(scene, picture, FAILED) is None
    without = make.config("maze", world="wall").scene
    assert centres(without, draw_paths(without, driven()), GOAL) is None


def test_many_worlds_stand_in_rows_half_as_large(make, driven):
    scene = make.config("maze", world=["loop", "wall"] * 4).scene
    episodes = driven([True] * 8, range(8), PATHS[:1] * 8)
    pictures = [draw_paths(scene, [episode]) for episode in episodes]
    together = draw_paths(scene, episodes)
    wide = sum(picture.shape[1] // 2 for picture in pictures[:6])
    assert together.shape == (2 * max(len(picture) // 2 for picture in pictures), wide, 3)
    low = pictures[7].shape[0] // 2
    begin, end = pictures[6].shape[1] // 2, (pictures[6].shape[1] + pictures[7].shape[1]) // 2
    last = together[len(together) // 2 :][:low, begin:end]
    seen = pictures[7].reshape(low, 2, -1, 2, 3).mean(axis=(1, 3))
    assert np.abs(last - seen).max() <= 1, "the last world is the second of the second row"
    assert (together[len(together) // 2 :, end:] == 255).all()
