"""The caption of a film says what the robot does in the words of its task, and failed endings in red."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from tb2rl.evaluation.rollout import roll_out
from tb2rl.rendering.colours import FAILED
from tb2rl.viz.caption import HEIGHT, caption, draw_caption, with_caption
from tb2rl.viz.film import open_env
from tb2rl.viz.shots import shots


def red(picture: np.ndarray) -> int:
    """How many pixels have the colour of what failed."""
    colour = [int(FAILED[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - colour).max(axis=2) < 12).sum())


def shots_of(policy, config, steps):
    """All shots of an episode, and its scene."""
    policy, env = open_env(policy, config, {}, steps)
    with closing(env):
        return list(shots(roll_out(env, policy, seed=0), period=0.2, rate=10)), env.scene


def test_the_caption_says_what_the_robot_does(make):
    shown, scene = shots_of(make.policy(), make.config(start="fixed"), 100)
    during, end = caption(shown[20], scene), caption(shown[-1], scene)
    assert during == {
        "time [s]": "2.0",
        "v [m/s]": "0.50",
        "w [rad/s]": "+0.00",
        "action": "forward",
        "reward": "+5",
        "return": "55",
    }
    assert (end["ended"], end["reward"]) == ("collision", "-200")
    assert "action" not in end


@pytest.mark.parametrize(("action", "described"), [([1.0, 0.0], "0.50, +0.00"), ([0.0, -0.5], "0.25, -0.50")])
def test_an_action_of_velocities_is_described_by_them(action, described, make, cruise):
    shown, scene = shots_of(make.policy(action), make.config(cruise, start="fixed"), 5)
    assert caption(shown[0], scene)["action"] == described
    assert caption(shown[-1], scene)["ended"] == "time limit"


ENDINGS = {  # what fails, or does not, and with which steps
    "collision": ("maze", {}, 100, True),
    "out of bounds": ("wall", {"bounds": [-1.0, -3.0, 0.5, 3.0]}, 100, True),
    "goal": ("wall", {"goal": [1.0, 0.0], "collision_range": 0.0}, 100, False),
    "time limit": ("maze", {}, 5, False),
}


@pytest.mark.parametrize("ended", ENDINGS)
def test_an_ending_that_counts_as_failed_is_red(ended, make):
    task, settings, steps, failed = ENDINGS[ended]
    shown, scene = shots_of(make.policy(), make.config(task, start="fixed", **settings), steps)
    assert caption(shown[-1], scene)["ended"] == ended
    first, last = (with_caption(np.zeros((20, 640, 3), np.uint8), shown[i], scene) for i in (0, -1))
    assert last.shape == (20 + HEIGHT, 640, 3)
    assert red(first) == 0
    assert (red(last) > 20) == failed


def test_a_narrow_picture_stands_in_the_middle_above_its_caption(make):
    shown, scene = shots_of(make.policy(), make.config(), 1)
    picture = with_caption(np.zeros((10, 100, 3), np.uint8), shown[0], scene)
    assert picture.shape == (10 + HEIGHT, 560, 3)
    assert not picture[:10, 230:330].any()
    assert picture[:10, :230].min() > 200
    assert (picture[:10, :230] == picture[:10, 330:]).all()


def test_long_values_stay_in_their_columns():
    picture = draw_caption(300, {"action": "straight on and then to the left", "": "", "return": "1"})
    assert picture.shape == (HEIGHT, 300, 3)
    assert picture[:, 100:200].min() == 255, "the column in the middle is empty"
