"""Films show what was driven and play everywhere, the window keeps time, and the keyboard steers."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

import tb2rl.play as play
from tb2rl import train
from tb2rl.config import resolve
from tb2rl.driving import drive
from tb2rl.errors import InputError
from tb2rl.film import CAMERAS, WRITERS, between, caption, film, open_world, shots, speeds
from tb2rl.maze import load_maze, maze_names
from tb2rl.robot import MAX_SPEED, MAX_TURN_RATE, Laser
from tb2rl.runs import make_baseline
from tb2rl.tasks.my_turtlebot2_maze import MyTurtleBot2Maze
from tb2rl.tasks.wander import Wander
from tb2rl.teleop import STILL, Teleop, nearest_action, range_lines, steered

STEPS = 10
HOLD = 1.0  # [s] at the end of an episode


class Ahead:
    """Goes forward."""

    def predict(self, observation, *, deterministic=False):
        return np.array(Wander.FORWARD), None


def config(task="maze", **settings):
    return resolve("random", task, settings={f"task.{key}": value for key, value in settings.items()})


def frames(path: Path) -> list[np.ndarray]:
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    with Image.open(path) as image:
        return [np.asarray((image.seek(i), image.convert("RGB"))[1]) for i in range(image.n_frames)]


def seconds(path: Path) -> float:
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return container.duration / av.time_base
    with Image.open(path) as image:
        return sum((image.seek(i), image.info["duration"])[1] for i in range(image.n_frames)) / 1000


def place(maze, picture, x, y) -> tuple[int, int]:
    """Row and column of a point in a picture from above of a square maze."""
    x0, y0, x1, y1 = maze.bounds
    side = picture.shape[1]
    return int((y1 + 0.3 - y) / (y1 - y0 + 0.6) * side), int((x - x0 + 0.3) / (x1 - x0 + 0.6) * side)


# ---- films


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_lasts_as_long_as_the_drive_and_moves(suffix, camera, tmp_path):
    path = film(Ahead(), tmp_path / f"drive{suffix}", config(start="fixed"), steps=STEPS, camera=camera)
    assert path == tmp_path / f"drive{suffix}"
    assert list(tmp_path.iterdir()) == [path]
    pictures = frames(path)
    assert seconds(path) == pytest.approx(STEPS * 0.2 + HOLD, abs=0.02)
    height, width, _ = pictures[0].shape
    assert (width, height % 2) == (640, 0)
    moving = [picture[:-48].astype(int) for picture in pictures[: len(pictures) * 2 // 3]]  # without the captions
    assert len(moving) >= STEPS  # at least one for each control step
    assert all(abs(before - after).max() > 30 for before, after in pairwise(moving))


def test_an_mp4_is_what_browsers_and_notebooks_play(tmp_path):
    film(Ahead(), tmp_path / "drive.mp4", config(), steps=1)
    with av.open(str(tmp_path / "drive.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
    data = (tmp_path / "drive.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that it plays while it loads"


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_the_robot_is_where_it_drives(suffix, tmp_path):
    pictures = frames(film(Ahead(), tmp_path / f"drive{suffix}", config(start="fixed", beams=1), steps=STEPS))
    maze = load_maze("loop")
    x, y, _ = maze.start
    gone = 0.5 * 0.2 * STEPS - 0.04  # it has to gather speed
    for picture, here, elsewhere in ((pictures[0], x, x + gone), (pictures[-1], x + gone, x)):
        beside = -0.09, y + 0.09  # a spot of the body alone, off its wheels, its nose, its path and its beam
        assert picture[place(maze, picture, here + beside[0], beside[1])].max() < 90
        assert picture[place(maze, picture, elsewhere + beside[0], beside[1])].min() > 190


def test_the_chase_camera_stays_behind_the_robot(tmp_path):
    pictures = frames(film(Ahead(), tmp_path / "drive.mp4", config(start="fixed"), steps=STEPS, camera="chase"))
    for picture in (pictures[0], pictures[-1]):
        assert picture[250, 320].max() < 90
        assert picture[340, 320].min() > 180  # floor
        assert ((picture[:360, :, 0] - picture[:360, :, 2].astype(int)) > 40).mean() > 0.05  # brick walls


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_film_shows_the_goal(camera, tmp_path):
    path = film(Ahead(), tmp_path / "drive.mp4", config("wall", start="fixed", goal=[2.0, 1.0]), steps=1, camera=camera)
    picture = frames(path)[0].astype(int)
    green = (picture[..., 1] - picture[..., 0] > 30) & (picture[..., 1] - picture[..., 2] > 30)
    _, columns = np.nonzero(green)
    if camera == "above":
        assert columns.max() / 640 == pytest.approx((2.0 + 1.0 + 0.3 + 0.2) / 7.6, abs=0.01)  # the ring's right end
    else:
        assert 100 < columns.min() < 250  # ahead and to the left


@pytest.mark.parametrize("maze", maze_names())
def test_every_maze_can_be_filmed(maze, tmp_path):
    pictures = frames(film(Ahead(), tmp_path / "drive.gif", config(maze=maze), steps=1))
    assert pictures[0].shape[1] >= 560  # room for the caption


def test_a_narrow_maze_leaves_room_for_the_caption(tmp_path):
    (tmp_path / "narrow.txt").write_text("###\n" + "#.#\n" * 12 + "#S#\n###\n")
    path = film(Ahead(), tmp_path / "drive.mp4", config(maze=str(tmp_path / "narrow.txt")), steps=1)
    assert frames(path)[0].shape[:2] == (688, 560)


def test_a_faster_film_is_shorter(tmp_path):
    path = film(Ahead(), tmp_path / "drive.mp4", config(), steps=STEPS, speed=4.0)
    assert seconds(path) == pytest.approx(STEPS * 0.2 / 4 + HOLD, abs=0.1)


def test_a_film_that_would_never_end_is_refused(tmp_path):
    with pytest.raises(InputError, match="speed must be from"):
        film(Ahead(), tmp_path / "drive.mp4", config(), speed=0.0)


def test_episodes_follow_one_another(tmp_path):
    path = film(Ahead(), tmp_path / "drive.mp4", config(), steps=2, episodes=3)
    assert seconds(path) == pytest.approx(3 * (2 * 0.2 + HOLD), abs=0.1)


def test_a_film_replaces_an_older_one_only_when_it_is_complete(tmp_path):
    class Stumbling(Ahead):
        def predict(self, observation, *, deterministic=False):
            raise RuntimeError("stumbled")

    (tmp_path / "drive.mp4").write_text("old")
    with pytest.raises(RuntimeError, match="stumbled"):
        film(Stumbling(), tmp_path / "drive.mp4", config())
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
    film(Ahead(), tmp_path / "drive.mp4", config(), steps=1)
    assert len(frames(tmp_path / "drive.mp4")) > 1


def test_the_drive_is_the_one_of_the_environment():
    policy, env = open_world(Ahead(), config(start="fixed"), {}, 100)
    moments = list(drive(env, policy, seed=3))
    env.reset(seed=3)
    total, steps, over = 0.0, 0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(Wander.FORWARD)
        total, steps, over = total + reward, steps + 1, terminated or truncated
    last = moments[-1]
    assert (last.step, last.total, last.info["ended"]) == (steps, total, info["ended"])
    assert last.info["distance"] == info["distance"]
    assert (last.pose == info["pose"]).all()
    assert [moment.info["ended"] for moment in moments[:-1]] == [None] * (steps - 1)
    env.close()


def test_the_caption_says_what_the_robot_does():
    policy, env = open_world(Ahead(), config(start="fixed"), {}, 100)
    shown = list(shots(drive(env, policy, seed=0), period=0.2, rate=10))
    env.close()
    during, end = caption(shown[20], env.task), caption(shown[-1], env.task)
    assert during == {
        "time [s]": "2.0",
        "v [m/s]": "0.50",
        "w [rad/s]": "+0.00",
        "action": "forward",
        "reward": "+5",
        "return": "55",
    }
    assert (end["ended"], end["reward"]) == ("crash", "-200")


def test_between_two_poses_the_robot_turns_the_short_way():
    before, after = np.array([0.0, 0.0, math.pi - 0.1]), np.array([1.0, 2.0, 0.1 - math.pi])
    assert between(before, after, 0.25) == pytest.approx([0.25, 0.5, math.pi - 0.05])
    assert speeds(before, before + (0.0, 0.0, 0.4 - math.tau), 0.2) == pytest.approx((0.0, 2.0))


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "limit"), [("above", 15.0), ("chase", 45.0)])
def test_the_film_of_a_minute_takes_less_than_that(camera, limit, tmp_path):
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


# ---- the command


@pytest.fixture
def alone(tmp_path, monkeypatch) -> Path:
    """A working directory, and no display."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    return tmp_path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run folder with a policy."""
    folder = tmp_path_factory.mktemp("runs") / "mine"
    train("qlearn", total_timesteps=8, n_envs=1, eval_freq=0, folder=folder)
    return folder


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a display is an environment variable")
def test_without_a_display_there_is_a_film_named_after_the_policy(alone, run, capsys):
    play.main([str(run), "--steps", "2", "--episodes", "2", "--seed", "1"])
    first, second, written = capsys.readouterr().out.splitlines()
    assert first.startswith("episode 1: time limit after 2 steps (0.4 s), 0.")
    assert "m/s, return" in second
    assert written == f"wrote mine.mp4 ({(alone / 'mine.mp4').stat().st_size / 1e6:.1f} MB)"
    assert len(list(alone.iterdir())) == 1


def test_an_agent_that_does_not_learn_plays_too(alone, capsys):
    play.main(
        shlex.split(
            "--agent wallfollower --task wall --set task.maze=round 'task.goal=[0, 2]' --steps 2 --video it.GIF"
        )
    )
    assert capsys.readouterr().out.count("\n") == 2
    assert [file.name for file in alone.iterdir()] == ["it.GIF"]


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["policy", "--agent", "--teleop"]),
        ("RUN --agent random", ["policy", "--agent", "--teleop"]),
        ("RUN --teleop", ["policy", "--agent", "--teleop"]),
        ("RUN --task wall", ["--task"]),
        ("RUN --set agent.gamma=1", ["task.KEY=VALUE", "agent.gamma"]),
        ("RUN --set task.maze=lop", ["did you mean 'loop'", "circuit"]),
        ("RUN --set task.beams=9", ["observation"]),
        ("missing", ["missing", "run folder"]),
        ("zoo:missing", ["zoo", "'missing'"]),
        ("--agent qlearn", ["qlearn", "tb2rl.train"]),
        ('--agent ""', ["qlearn learns"]),
        (300 * "x", ["File name too long", 300 * "x"]),
        (f"--agent random --video {300 * 'x'}.mp4", ["File name too long"]),
        ("--agent rando", ["did you mean 'random'"]),
        ("--agent random --task wal", ["did you mean 'wall'"]),
        ("--agent random --set task.maze=missing.yaml", ["missing.yaml"]),
        ("--agent random --task wall --set task.maze=loop", ["maze loop", "goal", "task.goal"]),
        ("--agent random --episodes 0", ["episodes", "at least 1"]),
        ("--agent random --steps 0", ["steps", "at least 1"]),
        ("--agent random --steps 99999999999", ["episode_steps"]),
        ("--agent random --seed -1", ["seed"]),
        ("--agent random --seed 99999999999", ["seed", "4294967295"]),
        ("--agent random --speed 0", ["speed", "0.1"]),
        ("--agent random --speed nan", ["speed", "0.1"]),
        ("--agent random --camera below", ["--camera", "above", "chase"]),
        ("--agent random --video it.avi", [".mp4 or .gif", "it.avi"]),
        ("--agent random --video it", [".mp4 or .gif", "'it'"]),
        ("--agent random --video missing/it.mp4", ["missing/it.mp4", "folder"]),
        ("--agent random --video folder.mp4", ["folder.mp4", "folder"]),
        ("--teleop --video it.mp4", ["--video", "--teleop"]),
        ("--teleop --task wal", ["did you mean 'wall'"]),
        ("--teleop", ["terminal"]),
    ],
)
def test_play_says_what_is_wrong(line, named, alone, run, capsys):
    (alone / "folder.mp4").mkdir()
    before = sorted(alone.rglob("*"))
    with pytest.raises(SystemExit) as stopped:
        play.main(shlex.split(line.replace("RUN", str(run))))
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1, message
    assert [part for part in named if part not in message] == [], message
    assert sorted(alone.rglob("*")) == before, "it leaves nothing behind"


def test_a_film_may_be_named_like_an_address(tmp_path):
    path = film(Ahead(), tmp_path / "12:30.mp4", config(), steps=1)
    assert len(frames(path)) > 1


def test_a_reader_who_goes_away_is_no_error_of_the_disk(tmp_path, monkeypatch):
    def away(path, pictures, rate):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setitem(WRITERS, ".mp4", (away, 15))
    with pytest.raises(BrokenPipeError):
        film(Ahead(), tmp_path / "drive.mp4", config(), steps=1)


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="not writable"):
        film(Ahead(), tmp_path / "it.mp4", config())


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    def full(path, frames, rate):
        path.write_bytes(next(frames).tobytes())
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(WRITERS, ".mp4", (full, 15))
    with pytest.raises(InputError, match=r"cannot write .*it.mp4: No space left"):
        film(Ahead(), tmp_path / "it.mp4", config())
    assert list(tmp_path.iterdir()) == []


# ---- the window


@pytest.fixture
def screen(monkeypatch):
    """A function that starts an X server with a display of its own."""
    if not shutil.which("Xvfb"):
        pytest.skip("a window needs a display, and there is no Xvfb to make one")
    servers = []

    def start(*arguments: str) -> subprocess.Popen:
        read, write = os.pipe()
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "800x600x24", *arguments]
        servers.append(subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL))
        os.close(write)
        with os.fdopen(read) as answer:
            monkeypatch.setenv("DISPLAY", f":{answer.readline().strip()}")
        return servers[-1]

    yield start
    for server in servers:
        server.terminate()
        server.wait()


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_the_window_shows_the_drive_in_its_own_time(screen, camera, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    screen()
    began = time.monotonic()
    play.main(["--agent", "wallfollower", "--task", "wall", "--steps", str(STEPS), "--camera", camera])
    assert STEPS * 0.2 < time.monotonic() - began < 60
    assert capsys.readouterr().out.startswith("episode 1: time limit after 10 steps (2.0 s)")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_window_that_is_closed_ends_the_drive_quietly(screen):
    server = screen()
    arguments = [sys.executable, "-m", "tb2rl.play", "--agent", "wallfollower", "--steps", "10", "--episodes", "1000"]
    playing = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert playing.stdout.readline().startswith("episode 1")
    server.terminate()  # takes the window along
    out, _ = playing.communicate(timeout=60)
    assert playing.returncode == 0
    assert [line for line in out.splitlines() if not line.startswith("episode ")] == []


@pytest.mark.slow
def test_a_window_that_cannot_open_is_one_line(screen, capsys):
    screen("-extension", "GLX")
    with pytest.raises(SystemExit) as stopped:
        play.main(["--agent", "wallfollower"])
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1
    assert "OpenGL" in message
    assert "--video" in message


# ---- driving by keyboard


@pytest.mark.parametrize(
    ("keys", "command"),
    [
        ("", (0.0, 0.0)),
        ("ww", (0.2, 0.0)),
        ("wss", (-0.1, 0.0)),
        ("waad", (0.1, 0.5)),
        ("dx", (0.0, -0.5)),
        ("wa ", (0.0, 0.0)),
        ("w" * 20, (MAX_SPEED, 0.0)),
        ("s" * 20, (-MAX_SPEED, 0.0)),
        ("a" * 20, (0.0, MAX_TURN_RATE)),
    ],
)
def test_keys_change_the_command_within_the_limits(keys, command):
    given = STILL
    for key in keys:
        given = steered(given, key)
    assert given == pytest.approx(command, abs=1e-3)


def test_the_nearest_action_is_the_one_that_does_alike():
    task = MyTurtleBot2Maze()
    for command, action in (((0.4, 0.1), 0), ((0.1, 1.5), 1), ((0.0, -0.8), 2), ((-0.2, 0.0), 3)):
        assert nearest_action(task, np.array(command)) == action


def test_ranges_are_bars_from_right_to_left():
    lines = range_lines(Laser(beams=3), np.array([1.0, np.inf, 0.5]), (0.7, 2.0), rows=9)
    assert lines == [
        " -90 deg   1.00 m class 1 ########",
        "  +0 deg    inf m class 2 " + "#" * 40,
        " +90 deg   0.50 m class 0 ####",
    ]
    many = range_lines(Laser(beams=720), np.ones(720), None, rows=5)
    assert [line[:4] for line in many] == [" -90", " -45", "  +0", " +45", " +90"]


@pytest.fixture
def teleop():
    teleop = Teleop(config(start="fixed"), seed=0)
    yield teleop
    teleop.close()


def test_the_robot_goes_where_it_is_steered(teleop):
    x, _, yaw = teleop.reading.pose[0]
    teleop.command = np.array([0.4, 0.0])
    for _ in range(5):
        teleop.step()
    assert teleop.reading.pose[0, 0] - x == pytest.approx(0.4, abs=0.05)
    assert "as action forward: reward +5" in teleop.lines(24)
    teleop.command = np.array([0.0, 0.5])
    for _ in range(5):
        teleop.step()
    assert teleop.reading.pose[0, 2] - yaw == pytest.approx(0.5, abs=0.1)  # it has to gather speed
    assert next(line for line in teleop.lines(24) if line.startswith("robot")).split()[-2:] == ["+0.50", "rad/s"]


def test_a_crash_is_named_and_starts_again_at_rest(teleop):
    start = teleop.reading.pose[0]
    teleop.command = np.array([0.6, 0.0])
    for _ in range(200):
        teleop.step()
        if not teleop.command.any():
            break
    assert any(line.startswith("CRASH (nearest 0.") for line in teleop.lines(24))
    assert teleop.reading.pose[0] == pytest.approx(start, abs=1e-3)


def test_the_screen_fits_the_terminal(teleop):
    assert len(teleop.lines(24)) == 14
    assert [len(teleop.lines(height)) for height in (1, 5, 9)] == [1, 5, 9]


@pytest.mark.slow
def test_a_terminal_can_be_driven_in():
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "100"}
    environment.pop("DISPLAY", None)
    arguments = [sys.executable, "-m", "tb2rl.play", "--teleop", "--set", "task.start=fixed"]
    playing = subprocess.Popen(arguments, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    try:
        wait_for(ours, b"q ends")
        os.write(ours, b"w\x1bOA")  # a letter, and the arrow up
        wait_for(ours, b"forward")
        os.write(ours, b"q")
        assert playing.wait(timeout=30) == 0
    finally:
        playing.kill()
        playing.wait()
        os.close(ours)


def wait_for(terminal: int, text: bytes) -> None:
    seen = b""
    until = time.monotonic() + 60
    os.set_blocking(terminal, False)
    while text not in seen:
        assert time.monotonic() < until, seen
        time.sleep(0.05)
        try:
            seen += os.read(terminal, 65536)
        except BlockingIOError:
            continue
