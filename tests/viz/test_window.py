"""The window runs in real time, closes with the last episode or by the user, and says why it does not open."""

import os
import shutil
import subprocess
import sys
import time

import pytest

import tb2rl.play as play
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.window import has_display

STEPS = 10


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a display is an environment variable")
@pytest.mark.parametrize(("display", "expected"), [pytest.param(":0", True, marks=pytest.mark.bullet), ("", False)])
def test_the_environment_names_the_display(display, expected, monkeypatch):
    monkeypatch.setenv("DISPLAY", display)
    assert has_display() == expected


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
@pytest.mark.flaky(reruns=1)
@pytest.mark.parametrize("camera", CAMERAS)
def test_the_window_shows_an_episode_in_real_time(screen, camera, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    screen()
    began = time.monotonic()
    play.main(["--agent", "wallfollower", "--task", "wall", "--steps", str(STEPS), "--camera", camera])
    assert STEPS * 0.2 < time.monotonic() - began < 60, "waited for the window to open and close"
    expected = "driving in PyBullet\nepisode 1: time limit after 10 steps (2.0 s)"
    assert capsys.readouterr().out.startswith(expected)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)
def test_closing_the_window_ends_play_quietly(screen):
    server = screen()
    arguments = [sys.executable, "-m", "tb2rl.play", "--agent", "wallfollower", "--steps", "10", "--episodes", "1000"]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout.readline() == "driving in PyBullet\n"
    assert process.stdout.readline().startswith("episode 1")
    server.terminate()  # closes the window
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
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


@pytest.mark.slow
def test_the_windows_process_imports_no_learners():
    code = "import sys, tb2rl.viz.scene_view; sys.exit(bool({'torch', 'stable_baselines3'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True)
