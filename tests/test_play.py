"""The command `play`: a film without a display, a line for each episode, and one line for arguments that do not fit."""

from __future__ import annotations

import shlex
import signal
import sys
from io import StringIO
from pathlib import Path

import pytest

import tb2rl.play as play
from tb2rl import train
from tb2rl.envs import single
from tb2rl.viz import film


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
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
def test_without_a_display_there_is_a_film_named_after_the_policy(folder, run, capsys):
    play.main([str(run), "--steps", "2", "--episodes", "2", "--seed", "1"])
    out, err = capsys.readouterr()
    first, second, written = out.splitlines()
    assert first.startswith("episode 1: time limit after 2 steps (0.4 s), 0.")
    assert "m/s, return" in second
    assert written == f"wrote mine.mp4 ({(folder / 'mine.mp4').stat().st_size / 1e6:.1f} MB)"
    assert len(list(folder.iterdir())) == 1
    assert err == "", "no bar where there is no terminal"


def test_a_terminal_shows_a_bar(folder, run, monkeypatch, capsys):
    stream = StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    play.main([str(run), "--steps", "2", "--video", "it.gif"])
    assert "filming:" in stream.getvalue()
    assert "0/2" in stream.getvalue()
    assert capsys.readouterr().out.startswith("episode 1: time limit after 2 steps")


def test_an_agent_that_does_not_learn_plays_too(folder, capsys):
    line = "--agent wallfollower --task wall --set task.start=fixed 'task.bounds=[-1, -3, 0.3, 3]' --video it.GIF"
    play.main(shlex.split(line))
    out = capsys.readouterr().out
    assert out.startswith("episode 1: out of bounds after ")
    assert out.count("\n") == 2
    assert [file.name for file in folder.iterdir()] == ["it.GIF"]


@pytest.mark.parametrize("policy", ["RUN", "--agent random"])
def test_the_time_limit_of_the_task_can_be_set(policy, folder, run, capsys):
    play.main(shlex.split(f"{policy} --set task.episode_steps=2 --video it.gif".replace("RUN", str(run))))
    assert capsys.readouterr().out.startswith("episode 1: time limit after 2 steps")


@pytest.mark.parametrize(
    ("output", "simulation"),
    [("--video it.gif", "bullet"), ("--video it.gif", "kinematic"), ("--bag it.bag", "kinematic")],
)
def test_the_simulation_can_be_chosen(output, simulation, folder, capsys, monkeypatch):
    if "bag" in output:
        pytest.importorskip("rosbags")
    opened, simulate = [], single.simulate

    def noted(name, *arguments, **named):
        opened.append(name)
        return simulate(name, *arguments, **named)

    monkeypatch.setattr(single, "simulate", noted)
    play.main(shlex.split(f"--agent random --steps 2 {output} --simulation {simulation}"))
    assert opened == [simulation]
    assert "driven in" not in capsys.readouterr().out


@pytest.mark.parametrize(("name", "bags"), [("it.bag", ["it-1.bag", "it-2.bag"]), ("it", ["it-1", "it-2"])])
def test_each_episode_is_a_bag_of_its_own(name, bags, folder, run, capsys):
    pytest.importorskip("rosbags")
    play.main([str(run), "--steps", "2", "--episodes", "2", "--bag", name])
    *lines, first, second = capsys.readouterr().out.splitlines()
    assert [line.split(" after")[0] for line in lines] == ["episode 1: time limit", "episode 2: time limit"]
    assert [line.split(" (")[0] for line in (first, second)] == [f"wrote {bag}" for bag in bags]
    assert sorted(file.name for file in folder.iterdir()) == bags


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["policy", "--agent", "--teleop"]),
        ("RUN --task wall", ["--task"]),
        ("RUN --set agent.gamma=1", ["task.KEY=VALUE", "agent.gamma"]),
        ("RUN --set task.world=lop", ["did you mean 'loop'", "circuit"]),
        ("RUN --set task.beams=9", ["observation"]),
        ("zoo:missing", ["zoo", "'missing'"]),
        ("--agent qlearn", ["qlearn", "tb2rl.train"]),
        (300 * "x", ["File name too long", 300 * "x"]),
        (f"--agent random --video {300 * 'x'}.mp4", ["File name too long"]),
        ("--agent rando", ["did you mean 'random'"]),
        ("--agent random --task wal", ["did you mean 'wall'"]),
        ("--agent random --task wall --set task.world=loop", ["world loop", "goal", "task.goal"]),
        ("--agent random --episodes 0", ["episodes", "at least 1"]),
        ("--agent random --steps 99999999999", ["episode_steps"]),
        ("--agent random --steps 2 --set task.episode_steps=3", ["--steps", "task.episode_steps"]),
        ("--agent random --set task.episode_steps=0", ["task.episode_steps", "greater than or equal to 1"]),
        ("--agent random --seed -1", ["seed"]),
        ("--agent random --speed 0", ["speed", "0.1"]),
        ("--agent random --camera below", ["camera", "above", "chase"]),
        ("--agent random --video it.avi", [".mp4 or .gif", "it.avi"]),
        ("--agent random --video missing/it.mp4", ["missing/it.mp4", "folder"]),
        ("--agent random --video folder.mp4", ["folder.mp4", "folder"]),
        ("--agent random --bag it.mcap", [".bag", "folder", "it.mcap"]),
        ("--agent random --bag missing/it", ["missing/it", "folder"]),
        ("--agent random --bag folder.bag", ["folder.bag", "exists already"]),
        ("--agent random --bag it --video it.mp4", ["--video", "--bag", "--seed"]),
        ("--agent random --simulation ros", ["--video", "rosbag"]),
        ("--agent random --simulation ros --video it.mp4 --mounting 1,2", ["--mounting", "x,y,yaw", "'1,2'"]),
        ("--agent random --ros 2", ["--ros", "--simulation ros"]),
        ("--teleop --simulation ros", ["--teleop", "ros"]),
        ("--agent random --simulation gazebo", ["--simulation", "kinematic", "gazebo"]),
        ("--teleop --video it.mp4", ["--video", "--teleop"]),
        ("--teleop", ["terminal"]),
    ],
)
def test_play_says_what_is_wrong(line, named, folder, run, capsys):
    (folder / "folder.mp4").mkdir()
    (folder / "folder.bag").mkdir()
    before = sorted(folder.rglob("*"))
    with pytest.raises(SystemExit) as stopped:
        play.main(shlex.split(line.replace("RUN", str(run))))
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1, message
    assert [part for part in named if part not in message] == [], message
    assert sorted(folder.rglob("*")) == before, "it leaves nothing behind"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_it_films_leaves_no_part_of_the_film(name, tmp_path, monkeypatch, capsys):
    number, pictures = getattr(signal, name), iter(range(1000))
    before, add_caption = signal.getsignal(number), film.add_caption

    def interrupted(*arguments):
        if next(pictures) == 3:
            signal.raise_signal(number)
        return add_caption(*arguments)

    monkeypatch.setattr(film, "add_caption", interrupted)
    with pytest.raises(SystemExit) as ended:
        play.main(["--agent", "random", "--steps", "20", "--video", str(tmp_path / "d.mp4")])
    assert ended.value.code == 128 + number
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(number) is before
