"""Films last as long as their episodes, play everywhere, and replace an older film only when they are complete."""

from __future__ import annotations

import time
from itertools import pairwise

import av
import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.viz.episodes import FilmOptions, load_policy
from tb2rl.viz.film import WRITERS, film

STEPS = 10
HOLD = 1.0  # [s] at the end of an episode


@pytest.mark.parametrize(("suffix", "camera"), [(".mp4", "above"), (".gif", "chase")])
def test_a_film_lasts_as_long_as_the_episode_and_moves(suffix, camera, make, read_film, tmp_path):
    options = FilmOptions(steps=STEPS, camera=camera)
    path = film(make.policy(), tmp_path / f"it{suffix}", make.config(start="fixed"), options=options)
    assert list(tmp_path.iterdir()) == [path] == [tmp_path / f"it{suffix}"]
    shown, seconds = read_film(path)
    assert seconds == pytest.approx(STEPS * 0.2 + HOLD, abs=0.02)
    height, width, _ = shown[0].shape
    assert (width, height % 2) == (640, 0)
    moving = [picture[:-48].astype(int) for picture in shown[: len(shown) * 2 // 3]]  # without the captions
    assert len(moving) >= STEPS  # at least one for each control step
    assert all(abs(before - after).max() > 30 for before, after in pairwise(moving))


def test_options_and_settings_change_the_duration_and_the_end_of_each_episode_is_reported(make, read_film, tmp_path):
    lines = []
    options = FilmOptions(episodes=2, speed=4.0, on_end=lines.append)
    path = film(make.policy(), tmp_path / "it.mp4", make.config(start="fixed"), {"episode_steps": 8}, options)
    assert read_film(path)[1] == pytest.approx(2 * (8 * 0.2 / 4 + HOLD), abs=0.1)
    assert [line.partition(" (")[0] for line in lines] == [f"episode {i}: time limit after 8 steps" for i in (1, 2)]


def test_an_mp4_is_what_browsers_and_notebooks_play(make, tmp_path):
    film(make.policy(), tmp_path / "12:30.mp4", make.config(), options=FilmOptions(steps=1))
    with av.open(str(tmp_path / "12:30.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
    data = (tmp_path / "12:30.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that it plays while it loads"


def test_films_are_in_worlds_that_no_training_uses(make):
    world = {"generator": "rooms", "worlds": 5, "difficulty": 0.0}
    _, scene = load_policy(make.policy(), make.config(), {"world": world}, FilmOptions(steps=7))
    assert [world.name for world in scene.spec.worlds] == [f"rooms {i} (test)" for i in range(5)]


def test_a_policy_is_loaded_and_must_fit_the_task(seeds, make):
    options = FilmOptions(steps=7)
    policy, scene = load_policy(seeds / "seed-0", None, {"laser_noise": 0.1}, options)
    assert policy.num_timesteps == load(seeds / "seed-0").num_timesteps
    assert (scene.task.laser_noise, scene.task.episode_steps) == (0.1, 7)
    with pytest.raises(InputError, match="knows the observation"):
        load_policy(seeds / "seed-0", None, {"beams": 11}, options)
    with pytest.raises(InputError, match="did you mean 'world'"):
        load_policy(seeds / "seed-0", None, {"wrld": "loop"}, options)
    with pytest.raises(InputError, match="no config"):
        load_policy(make.policy(), None, None, options)


# ---- what is refused, and what is left behind then


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": float("nan")}, "speed must be from"),
        ({"steps": 0}, "at least 1"),
        ({"seed": -1}, "seed from 0"),
        ({"camera": "below"}, "unknown camera 'below'; known: above, chase"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        FilmOptions(**options)


def test_a_film_replaces_an_older_one_only_when_it_is_complete(make, read_film, tmp_path):
    class Stumbling:
        def predict(self, observation, *, deterministic=False):
            raise RuntimeError("stumbled")

    (tmp_path / "it.mp4").write_text("old")
    with pytest.raises(RuntimeError, match="stumbled"):
        film(Stumbling(), tmp_path / "it.mp4", make.config())
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
    film(make.policy(), tmp_path / "it.mp4", make.config(), options=FilmOptions(steps=1))
    assert len(read_film(tmp_path / "it.mp4")[0]) > 1


@pytest.mark.parametrize(
    ("error", "raised", "message"),
    [
        (OSError(28, "No space left on device"), InputError, r"cannot write .*it.mp4: No space left"),
        (BrokenPipeError(32, "Broken pipe"), BrokenPipeError, "Broken pipe"),
    ],
    ids=["a full disk is one line", "a closed stdout is no error of the film"],
)
def test_errors_while_writing_leave_nothing(error, raised, message, make, tmp_path, monkeypatch):
    def fail(path, pictures, rate):
        path.write_bytes(next(pictures).tobytes())
        raise error

    monkeypatch.setitem(WRITERS, ".mp4", (fail, 15))
    with pytest.raises(raised, match=message):
        film(make.policy(), tmp_path / "it.mp4", make.config())
    assert list(tmp_path.iterdir()) == []


# ---- duration and size


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "limit"), [("above", 15.0), ("chase", 45.0)])
def test_filming_a_minute_takes_less_than_a_minute(camera, limit, read_film, tmp_path):
    config = resolve("wallfollower")
    policy = make_baseline(config)
    film(policy, tmp_path / "first.mp4", config, options=FilmOptions(steps=1, camera=camera))  # compiles
    began = time.process_time()
    path = film(policy, tmp_path / "it.mp4", config, options=FilmOptions(seed=1, camera=camera))
    assert read_film(path)[1] == pytest.approx(61.0, abs=0.1)
    assert time.process_time() - began < limit
