"""Pictures of paths mark the starts, the ends of failed episodes, and the goal of a task that has one."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.colours import FAILED, GOAL, PATH, START
from tb2rl.viz.pictures import draw_paths

PATHS = [np.array([(0.0, 1.0), (1.0, 2.0), (1.5, 2.0)]), np.array([(0.0, -2.0), (2.0, -2.0)])]


@pytest.fixture
def centre(coloured):
    """A function that returns the centre of the pixels with a colour, x, y [m]; None if there are none."""

    def of(scene, picture: np.ndarray, colour: str) -> np.ndarray | None:
        pixels, (x0, _, x1, y1) = coloured(picture, colour), scene.world.bounds
        if not len(pixels):
            return None
        row, column = (pixels.min(axis=0) + pixels.max(axis=0) + 1) / 2 * (x1 - x0 + 0.6) / picture.shape[1]
        return np.array([column + x0 - 0.3, y1 + 0.3 - row])

    return of


@pytest.fixture
def driven(make):
    """A function that makes an episode along each of `PATHS`, the second one failed."""

    def of(goal=None):
        return [
            replace(make.episode(path, [0] * (len(path) - 1), failed=failed), goal=goal)
            for path, failed in zip(PATHS, (False, True), strict=True)
        ]

    return of


def test_starts_and_the_ends_of_failed_episodes_are_marked(make, driven, centre):
    scene = make.config("wall").scene
    picture = draw_paths(scene, driven())
    assert centre(scene, picture, FAILED) == pytest.approx(PATHS[1][-1], abs=0.02)
    assert centre(scene, picture, START) == pytest.approx((0.0, -0.5), abs=0.02), "between the two starts"
    assert centre(scene, picture, GOAL) == pytest.approx((5.0, 0.0), abs=0.02)
    assert centre(scene, picture, PATH) is not None


def test_the_goal_is_that_of_the_episode_and_only_tasks_with_a_goal_show_one(make, driven, centre):
    scene, without = make.config("navigate", world="wall").scene, make.config("maze", world="wall").scene
    assert centre(scene, draw_paths(scene, driven(goal=(2.0, 1.0))), GOAL) == pytest.approx((2.0, 1.0), abs=0.02)
    assert centre(without, draw_paths(without, driven()), GOAL) is None


@pytest.mark.parametrize(("worlds", "side"), [(2, 640), (8, 320)])
def test_several_worlds_stand_in_a_grid(worlds, side, make, driven):
    scene = make.config("maze", world=["loop", "wall"] * 4).scene
    grid = draw_paths(scene, [replace(driven()[1], world=world) for world in range(worlds)])
    columns = grid.shape[1] // side
    tiles = [tile for row in np.array_split(grid, len(grid) // side) for tile in np.array_split(row, columns, axis=1)]
    shown = [(tile == ImageColor.getrgb(FAILED)).all(axis=2).any() for tile in tiles]
    assert shown == [True] * worlds + [False] * (len(tiles) - worlds)
