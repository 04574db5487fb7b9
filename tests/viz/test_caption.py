"""The caption of a film shows the action in the words of the task, and failed endings in red."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.colours import FAILED
from tb2rl.viz.caption import HEIGHT, add_caption, caption, draw_caption


def red(picture: np.ndarray) -> int:
    """Number of pixels in the colour of failures."""
    return int((np.abs(picture.astype(int) - ImageColor.getrgb(FAILED)).max(axis=2) < 12).sum())


@pytest.mark.parametrize(("action", "described"), [([1.0, 0.0], "0.50, +0.00"), ([0.0, -0.5], "0.25, -0.50")])
def test_velocities_are_described_by_their_values(action, described, make, cruise):
    frames, scene = make.frames(make.policy(action), make.config(cruise, start="fixed"), 5)
    assert caption(frames[0], scene)["action"] == described
    assert caption(frames[-1], scene)["ended"] == "time limit"


ENDINGS = {  # task, settings, steps, whether the ending is a failure
    "collision": ("maze", {}, 100, True),
    "out of bounds": ("wall", {"bounds": [-1.0, -3.0, 0.5, 3.0]}, 100, True),
    "goal": ("wall", {"goal": [1.0, 0.0], "collision_range": 0.0}, 100, False),
    "time limit": ("maze", {}, 5, False),
}


@pytest.mark.parametrize("ended", ENDINGS)
def test_failed_endings_are_red(ended, make):
    task, settings, steps, failed = ENDINGS[ended]
    frames, scene = make.frames(make.policy(), make.config(task, start="fixed", **settings), steps)
    assert caption(frames[-1], scene)["ended"] == ended
    assert "action" not in caption(frames[-1], scene)
    first, last = (add_caption(np.zeros((20, 640, 3), np.uint8), frames[i], scene) for i in (0, -1))
    assert last.shape == (20 + HEIGHT, 640, 3)
    assert red(first) == 0
    assert (red(last) > 20) == failed
    if ended == "collision":
        assert caption(frames[20], scene) == {
            "time [s]": "2.0", "v [m/s]": "0.50", "w [rad/s]": "+0.00", "action": "forward", "reward": "+5",
            "return": "55",
        }  # fmt: skip


def test_narrow_pictures_are_centred_and_long_values_stay_in_their_columns(make):
    frames, scene = make.frames(make.policy(), make.config())
    picture = add_caption(np.zeros((10, 100, 3), np.uint8), frames[0], scene)
    assert picture.shape == (10 + HEIGHT, 560, 3)
    assert not picture[:10, 230:330].any()
    assert picture[:10, :230].min() > 200
    strip = draw_caption(300, {"action": "straight on and then to the left", "": "", "return": "1"})
    assert strip[:, 100:200].min() == 255, "the column in the middle is empty"
