"""Films last as long as their episodes, play everywhere, and replace an older film only when they are complete."""

import time
from itertools import pairwise

import av
import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.viz.film import WRITERS, FilmOptions, film, open_episodes

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
    options = FilmOptions(episodes=2, speed=4.0, on_episode_end=lines.append)
    path = film(make.policy(), tmp_path / "it.mp4", make.config(start="fixed"), {"episode_steps": 8}, options)
    assert read_film(path)[1] == pytest.approx(2 * (8 * 0.2 / 4 + HOLD), abs=0.1)
    assert [line.partition(" (")[0] for line in lines] == [f"episode {i}: time limit after 8 steps" for i in (1, 2)]


def test_films_are_in_worlds_that_no_training_uses(make):
    world = {"generator": "rooms", "worlds": 5, "difficulty": 0.0}
    with open_episodes(make.policy(), make.config(), {"world": world}, FilmOptions(steps=7), "") as (scene, _):
        assert [world.name for world in scene.spec.worlds] == [f"rooms {i} (test)" for i in range(5)]


def test_a_policy_is_loaded_and_must_fit_the_task(seeds, make):
    options = FilmOptions(steps=7)
    with open_episodes(seeds / "seed-0", None, {"laser_noise": 0.1}, options, "") as (scene, episodes):
        assert (scene.task.laser_noise, scene.task.episode_steps) == (0.1, 7)
        assert len(list(next(episodes))) <= 7
    for policy, settings, message in (
        (seeds / "seed-0", {"beams": 11}, "the policy has the observation space"),
        (seeds / "seed-0", {"wrld": "loop"}, "did you mean 'world'"),
        (make.policy(), None, "no config"),
    ):
        with pytest.raises(InputError, match=message), open_episodes(policy, None, settings, options, ""):
            pass


# ---- what is refused, and what is left behind then


def test_options_out_of_range_are_refused():
    cameras = "unknown camera 'below'; known: above, chase"
    wrong = {"speed must be from": {"speed": float("nan")}, "at least 1": {"steps": 0}, cameras: {"camera": "below"}}
    for message, options in wrong.items():
        with pytest.raises(InputError, match=message):
            FilmOptions(**options)


def test_a_film_replaces_an_older_one_only_when_it_is_complete(make, tmp_path):
    class Stumbling:
        def predict(self, observation, *, deterministic=False):
            raise RuntimeError("stumbled")

    (tmp_path / "it.mp4").write_text("old")
    with pytest.raises(RuntimeError, match="stumbled"):
        film(Stumbling(), tmp_path / "it.mp4", make.config())
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
    film(make.policy(), tmp_path / "it.mp4", make.config(), options=FilmOptions(steps=1))
    with av.open(str(tmp_path / "it.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p"), "what browsers and notebooks play"
    data = (tmp_path / "it.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that it plays while it loads"


def test_errors_while_writing_leave_nothing(make, tmp_path, monkeypatch):
    def fail(path, pictures, rate):
        path.write_bytes(next(pictures).tobytes())
        raise errors.pop()

    full, closed = OSError(28, "No space left on device"), BrokenPipeError(32, "Broken pipe")
    errors = [closed, full]
    monkeypatch.setitem(WRITERS, ".mp4", (fail, 15))
    with pytest.raises(InputError, match=r"cannot write .*it.mp4: No space left"):
        film(make.policy(), tmp_path / "it.mp4", make.config())
    with pytest.raises(BrokenPipeError):  # a closed stdout is no error of the film
        film(make.policy(), tmp_path / "it.mp4", make.config())
    assert list(tmp_path.iterdir()) == []


# ---- duration and size


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["above", "chase"])
def test_filming_takes_less_time_than_the_film(camera, read_film, tmp_path):
    config = resolve("wallfollower")
    policy = make_baseline(config)
    film(policy, tmp_path / "first.mp4", config, options=FilmOptions(steps=1, camera=camera))  # compiles
    began = time.process_time()
    path = film(policy, tmp_path / "it.mp4", config, options=FilmOptions(steps=75, seed=1, camera=camera))
    seconds = read_film(path)[1]
    assert seconds == pytest.approx(16.0, abs=0.1)
    assert time.process_time() - began < seconds
