"""The command `play`: a page, films and bags as its arguments say, and one line for arguments that do not fit."""

import shlex
import signal
from unittest.mock import Mock

import pytest

from tb2rl import play
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.simulation.simulator import default_physics
from tb2rl.viz import film
from tb2rl.viz.viewer import page

pytestmark = pytest.mark.usefixtures("workdir")


@pytest.fixture
def drive_live(monkeypatch) -> Mock:
    """Stands in for the page, and has the arguments with which it would be opened."""
    called = Mock()
    monkeypatch.setattr(page, "drive_live", called)
    return called


def test_a_page_shows_the_policy_as_the_options_say(drive_live, trained_run, capsys):
    line = "--viewer --host ::1 --port 9000 --steps 7 --seed 3 --speed 2 --camera chase --simulation kinematic"
    play.main([str(trained_run), *line.split()])
    (selection, seed), view = drive_live.call_args
    assert (selection.label, selection.simulator.name) == (str(trained_run), "kinematic")
    assert (type(selection.policy).__name__, selection.config.task.episode_steps, seed) == ("QLearning", 7, 3)
    assert view == {"speed": 2.0, "follow": True, "is_manual": False, "host": "::1", "port": 9000}
    assert capsys.readouterr().out == "driving in the kinematic simulator\n"


def test_the_user_drives_at_a_task_from_the_start(drive_live):
    play.main(shlex.split("--teleop --task navigate --goal 3,0 --set task.world=loop"))
    (selection, seed), view = drive_live.call_args
    assert (selection.config.task_name, selection.config.task.goal, selection.config.task.start) == (
        "navigate",
        (3.0, 0.0),
        "fixed",
    )
    assert (seed, selection.simulator) == (0, default_physics())
    assert view == {"speed": 1.0, "follow": False, "is_manual": True, "host": None, "port": None}


def test_a_film_is_titled_after_the_policy(workdir, trained_run, capsys, monkeypatch):
    header = Mock(wraps=film.add_header)
    monkeypatch.setattr(film, "add_header", header)
    play.main([str(trained_run), "--steps", "2", "--episodes", "2", "--seed", "1", "--video", "it.mp4"])
    out, err = capsys.readouterr()
    driving, first, second, written = out.splitlines()
    reason = "" if default_physics().name == "bullet" else ", because PyBullet is not installed"
    assert driving == f"driving in {default_physics().title}{reason}"
    assert first.startswith("episode 1: time limit after 2 steps (0.4 s), 0.")
    assert "m/s, return" in second
    assert written == f"wrote it.mp4 ({(workdir / 'it.mp4').stat().st_size / 1e6:.1f} MB)"
    assert header.call_args.args[1] == "run (qlearn), task maze, world loop, turtlebot2"
    assert len(list(workdir.iterdir())) == 1
    assert err == "", "no bar where there is no terminal"


def test_an_agent_that_does_not_learn_plays_too_and_a_terminal_shows_a_bar(workdir, terminal, capsys):
    stream = terminal()
    line = "--agent wallfollower --task wall --set task.start=fixed 'task.bounds=[-1, -3, 0.3, 3]' --video it.GIF"
    play.main(shlex.split(line))
    assert capsys.readouterr().out.splitlines()[1].startswith("episode 1: out of bounds after ")
    assert "filming:" in stream.getvalue()
    assert [file.name for file in workdir.iterdir()] == ["it.GIF"]


def test_the_simulator_can_be_chosen(monkeypatch):
    opened = Mock(wraps=ControlLoop.open)
    monkeypatch.setattr(ControlLoop, "open", opened)
    play.main(shlex.split("--agent random --steps 2 --video it.gif --simulation kinematic"))
    assert opened.call_args.args[1].name == "kinematic"


@pytest.mark.parametrize(("name", "bags"), [("it.bag", ["it-1.bag", "it-2.bag"]), ("it", ["it-1", "it-2"])])
def test_each_episode_is_a_bag_of_its_own(name, bags, workdir, trained_run, capsys):
    pytest.importorskip("rosbags")
    play.main([str(trained_run), "--steps", "2", "--episodes", "2", "--bag", name])
    written = [line.split(" (")[0] for line in capsys.readouterr().out.splitlines()[-2:]]
    assert written == [f"wrote {bag}" for bag in bags]
    assert sorted(file.name for file in workdir.iterdir()) == bags


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["policy", "--agent"]),
        ("--agent random --steps 2 --set task.episode_steps=3", ["--steps", "task.episode_steps"]),
        ("--agent random --speed 0", ["speed", "0.1"]),
        ("--agent random --camera below", ["camera", "above", "chase"]),
        ("--agent random --video it.avi", [".mp4 or .gif", "it.avi"]),
        ("--agent random --video missing/it.mp4", ["missing/it.mp4", "folder"]),
        ("--agent random --bag folder.bag", ["folder.bag"]),
        ("--agent random --host 0.0.0.0 --video it.mp4", ["--host", "--video"]),
        ("--agent random --bag it --video it.mp4", ["--video", "--bag", "--seed"]),
        ("--agent random --simulation ros", ["--video", "rosbag"]),
        ("--agent random --simulation ros --video it.mp4 --mounting 1,2", ["--mounting", "x,y,yaw", "'1,2'"]),
        ("--teleop --video it.mp4", ["--video", "--teleop"]),
        ("--teleop --agent random", ["--agent", "--teleop"]),
        ("--agent random --episodes 2", ["--episodes", "--video or --bag"]),
        ("--agent random --viewer --video it.mp4", ["--viewer", "--video or --bag"]),
        ("--agent random --port 9000 --bag it", ["--port", "--video or --bag"]),
        ("--agent random --port 65536", ["--port", "65535"]),
        ("--agent random --host 203.0.113.1", ["203.0.113.1", "cannot open"]),
    ],
)
def test_play_says_what_is_wrong(line, named, workdir, refused):
    (workdir / "folder.bag").mkdir()
    refused(play.main, line, named)


def test_a_signal_while_it_films_leaves_no_part_of_the_film(workdir, monkeypatch):
    number, frames = signal.SIGTERM, iter(range(1000))
    before, add_caption = signal.getsignal(number), film.add_caption

    def interrupted(*arguments):
        if next(frames) == 3:
            signal.raise_signal(number)
        return add_caption(*arguments)

    monkeypatch.setattr(film, "add_caption", interrupted)
    with pytest.raises(SystemExit) as ended:
        play.main(["--agent", "random", "--steps", "20", "--video", "d.mp4", "--simulation", "kinematic"])
    assert ended.value.code == 128 + number
    assert list(workdir.iterdir()) == []
    assert signal.getsignal(number) is before
