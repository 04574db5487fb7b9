"""Films last as long as the drive, play everywhere, and replace an older one only when they are complete."""

from __future__ import annotations

import os
import time
from itertools import pairwise

import av
import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.film import film, open_env
from tb2rl.viz.writers import WRITERS
from tb2rl.worlds.registry import world_names

STEPS = 10
HOLD = 1.0  # [s] at the end of an episode


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_lasts_as_long_as_the_drive_and_moves(suffix, camera, make, frames, seconds, tmp_path):
    path = film(make.policy(), tmp_path / f"drive{suffix}", make.config(start="fixed"), steps=STEPS, camera=camera)
    assert path == tmp_path / f"drive{suffix}"
    assert list(tmp_path.iterdir()) == [path]
    pictures = frames(path)
    assert seconds(path) == pytest.approx(STEPS * 0.2 + HOLD, abs=0.02)
    height, width, _ = pictures[0].shape
    assert (width, height % 2) == (640, 0)
    moving = [picture[:-48].astype(int) for picture in pictures[: len(pictures) * 2 // 3]]  # without the captions
    assert len(moving) >= STEPS  # at least one for each control step
    assert all(abs(before - after).max() > 30 for before, after in pairwise(moving))


def test_the_time_limit_can_be_a_setting(make, seconds, tmp_path):
    path = film(make.policy(), tmp_path / "drive.gif", make.config(), {"episode_steps": 3})
    assert seconds(path) == pytest.approx(3 * 0.2 + HOLD, abs=0.05)


def test_an_mp4_is_what_browsers_and_notebooks_play(make, tmp_path):
    film(make.policy(), tmp_path / "drive.mp4", make.config(), steps=1)
    with av.open(str(tmp_path / "drive.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
    data = (tmp_path / "drive.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that it plays while it loads"


@pytest.mark.parametrize("world", world_names())
def test_every_world_can_be_filmed(world, make, frames, tmp_path):
    pictures = frames(film(make.policy(), tmp_path / "drive.gif", make.config(world=world), steps=1))
    assert pictures[0].shape[1] >= 560  # room for the caption


def test_a_narrow_world_leaves_room_for_the_caption(make, frames, tmp_path):
    (tmp_path / "narrow.txt").write_text("###\n" + "#.#\n" * 12 + "#S#\n###\n")
    config = make.config(world=str(tmp_path / "narrow.txt"))
    path = film(make.policy(), tmp_path / "drive.mp4", config, steps=1)
    assert frames(path)[0].shape[:2] == (688, 560)


def test_a_faster_film_is_shorter(make, seconds, tmp_path):
    path = film(make.policy(), tmp_path / "drive.mp4", make.config(), steps=STEPS, speed=4.0)
    assert seconds(path) == pytest.approx(STEPS * 0.2 / 4 + HOLD, abs=0.1)


def test_episodes_follow_one_another_and_the_end_of_each_is_told(make, seconds, tmp_path):
    told = []

    def listen(episode, last) -> None:
        told.append((episode, last.step, last.info["ended"]))

    path = film(make.policy(), tmp_path / "drive.mp4", make.config(), steps=2, episodes=3, listener=listen)
    assert seconds(path) == pytest.approx(3 * (2 * 0.2 + HOLD), abs=0.1)
    assert told == [(1, 2, "time limit"), (2, 2, "time limit"), (3, 2, "time limit")]


def test_continuous_actions_can_be_filmed(make, cruise, frames, seconds, tmp_path):
    config = make.config(cruise, start="fixed")
    path = film(make.policy([1.0, 0.0]), tmp_path / "drive.gif", config, steps=5)
    assert seconds(path) == pytest.approx(5 * 0.2 + HOLD, abs=0.1)
    assert len(frames(path)) > 5


def test_settings_change_what_is_filmed(make, frames, tmp_path):
    films = [
        film(make.policy(), tmp_path / f"{world}.mp4", make.config(), {"world": world}, steps=1)
        for world in ("loop", "circuit")
    ]
    loop, circuit = (frames(path)[0].astype(int) for path in films)
    assert loop.shape == circuit.shape
    assert abs(loop - circuit).max() > 100
    with pytest.raises(InputError, match="did you mean 'world'"):
        film(make.policy(), tmp_path / "it.mp4", make.config(), {"wrld": "loop"})


def test_films_are_in_worlds_that_no_training_draws(make):
    world = {"generator": "rooms", "worlds": 5, "difficulty": 0.0}
    _, env = open_env(make.policy(), make.config(), {"world": world}, steps=7)
    assert [world.name for world in env.scene.spec.worlds] == [f"rooms {i} (test)" for i in range(5)]
    env.close()


def test_what_plays_is_loaded_and_held_against_its_task(seeds, make):
    policy, env = open_env(seeds / "seed-0", None, {"laser_noise": 0.1}, steps=7)
    env.close()
    assert policy.num_timesteps == load(seeds / "seed-0").num_timesteps
    assert (env.task.laser_noise, env.task.episode_steps) == (0.1, 7)
    with pytest.raises(InputError, match="knows the observation"):
        open_env(seeds / "seed-0", None, {"beams": 11}, steps=7)
    with pytest.raises(InputError, match="no config"):
        open_env(make.policy(), None, {}, steps=7)


# ---- what is refused, and what is left behind then


@pytest.mark.parametrize(("speed", "episodes"), [(0.0, 1), (101.0, 1), (float("nan"), 1), (1.0, 0)])
def test_a_film_that_would_never_end_or_never_begin_is_refused(speed, episodes, make, tmp_path):
    with pytest.raises(InputError, match="speed must be from" if episodes else "at least 1"):
        film(make.policy(), tmp_path / "drive.mp4", make.config(), speed=speed, episodes=episodes)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_camera_is_refused_with_the_known_ones(make, tmp_path):
    with pytest.raises(InputError, match="unknown camera 'below'; known: above, chase"):
        film(make.policy(), tmp_path / "drive.mp4", make.config(), camera="below")


def test_a_film_replaces_an_older_one_only_when_it_is_complete(make, frames, tmp_path):
    class Stumbling:
        def predict(self, observation, *, deterministic=False):
            raise RuntimeError("stumbled")

    (tmp_path / "drive.mp4").write_text("old")
    with pytest.raises(RuntimeError, match="stumbled"):
        film(Stumbling(), tmp_path / "drive.mp4", make.config())
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
    film(make.policy(), tmp_path / "drive.mp4", make.config(), steps=1)
    assert len(frames(tmp_path / "drive.mp4")) > 1


def test_a_film_may_be_named_like_an_address(make, frames, tmp_path):
    path = film(make.policy(), tmp_path / "12:30.mp4", make.config(), steps=1)
    assert len(frames(path)) > 1


def test_a_reader_who_goes_away_is_not_an_error_of_the_disk(make, tmp_path, monkeypatch):
    def away(path, pictures, rate):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setitem(WRITERS, ".mp4", (away, 15))
    with pytest.raises(BrokenPipeError):
        film(make.policy(), tmp_path / "drive.mp4", make.config(), steps=1)


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(make, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="not writable"):
        film(make.policy(), tmp_path / "it.mp4", make.config())


def test_a_full_disk_is_one_line_and_leaves_nothing(make, tmp_path, monkeypatch):
    def full(path, frames, rate):
        path.write_bytes(next(frames).tobytes())
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(WRITERS, ".mp4", (full, 15))
    with pytest.raises(InputError, match=r"cannot write .*it.mp4: No space left"):
        film(make.policy(), tmp_path / "it.mp4", make.config())
    assert list(tmp_path.iterdir()) == []


# ---- how long it takes, and how large it is


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "limit"), [("above", 15.0), ("chase", 45.0)])
def test_the_film_of_a_minute_takes_less_than_that(camera, limit, seconds, tmp_path):
    drive_on = resolve("wallfollower")
    policy = make_baseline(drive_on)
    film(policy, tmp_path / "first.mp4", drive_on, steps=1, camera=camera)  # compiles what is to be compiled
    began = time.process_time()
    path = film(policy, tmp_path / "drive.mp4", drive_on, seed=1, camera=camera)
    assert seconds(path) == pytest.approx(61.0, abs=0.1)
    assert time.process_time() - began < limit


@pytest.mark.slow
def test_a_gif_for_a_readme_is_small(tmp_path):
    drive_on = resolve("wallfollower")
    path = film(make_baseline(drive_on), tmp_path / "drive.gif", drive_on, steps=60, seed=1)
    assert path.stat().st_size < 1.5e6
