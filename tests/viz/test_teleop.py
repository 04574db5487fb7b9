"""Keys change the command within the robot's limits; the task's rewards and endings are shown in the terminal."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots import Laser
from tb2rl.viz.window import Teleop, range_lines, steer_in_terminal


def test_ranges_are_bars_from_right_to_left():
    assert range_lines(Laser(beams=3), np.array([1.0, np.inf, 0.5]), (0.7, 2.0), max_lines=9) == [
        " -90 deg   1.00 m bin 1 ########",
        "  +0 deg    inf m bin 2 " + "#" * 40,
        " +90 deg   0.50 m bin 0 ####",
    ]
    many = range_lines(Laser(beams=720), np.ones(720), None, max_lines=5)
    assert [line[:4] for line in many] == [" -90", " -45", "  +0", " +45", " +90"]


@pytest.fixture
def teleoperate(make) -> Iterator[Callable[..., Teleop]]:
    """A function from a task and its settings to a robot to drive."""
    with ExitStack() as stack:
        yield lambda *task, **settings: stack.enter_context(
            closing(Teleop(make.config(*task, start="fixed", **settings).scene, seed=0))
        )


def drive(teleop: Teleop, v: float, w: float, steps: int) -> None:
    """Hold a command v [m/s], w [rad/s] for some steps, or until the episode ends."""
    teleop.command = np.array([v, w])
    for _ in range(steps):
        teleop.step()
        if not teleop.command.any():
            return


def test_keys_change_the_command_within_the_robots_limits(teleoperate):
    teleop = teleoperate()
    robot = teleop.scene.robot
    fastest = {"w" * 20: (robot.max_speed, 0.0), " " + "d" * 20: (0.0, -robot.max_turn_rate)}
    for keys, command in {"wss": (-0.1, 0.0), " dx": (0.0, -0.5), "wa ": (0.0, 0.0), **fastest}.items():
        for key in keys:
            teleop.press(key)
        assert teleop.command == pytest.approx(command, abs=1e-3)


def test_the_robot_follows_the_command(teleoperate):
    teleop = teleoperate()
    x, _, yaw = teleop.robot_state.pose[0]
    for key in "wwww":
        teleop.press(key)
    drive(teleop, *teleop.command, 5)
    assert teleop.robot_state.pose[0, 0] - x == pytest.approx(0.4, abs=0.05)
    assert {"command  v +0.40 m/s   w +0.00 rad/s", "rewarded as action forward: +5"} <= set(teleop.lines(24))
    drive(teleop, 0.0, 0.5, 5)
    assert teleop.robot_state.pose[0, 2] - yaw == pytest.approx(0.5, abs=0.1)  # less the acceleration
    assert next(line for line in teleop.lines(24) if line.startswith("robot")).split()[-2:] == ["+0.50", "rad/s"]
    assert len(teleop.lines(24)) == 14
    assert [len(teleop.lines(height)) for height in (1, 5, 9)] == [1, 5, 9], "the screen fits the terminal"


def test_velocities_are_rewarded_as_commanded(teleoperate, cruise):
    teleop = teleoperate(cruise, beams=3, observation="raw")
    drive(teleop, 0.4, 0.2, 5)
    *head, _, _, _ = lines = teleop.lines(24)
    (reward,) = [line.split()[-1] for line in head if line.startswith("rewarded as action 0.40, +0.20: ")]
    assert float(reward) == pytest.approx(0.8, abs=0.02)
    ranges = lines[-3:]
    assert [line[:8] for line in ranges] == [" -90 deg", "  +0 deg", " +90 deg"]
    assert "bin" not in "".join(ranges), "raw ranges have none"


POST = {"posts": 1, "radius": 0.3, "path": [[-3.0, -3.751], [-3.0, -3.749]], "speed": 1e-3}


@pytest.mark.parametrize(
    ("task", "settings", "message"),
    [
        ("maze", {}, "COLLISION (nearest 0."),
        (
            "maze",
            {"collision_range": 0.0, "dynamic_obstacles": POST},
            "COLLISION WITH A DYNAMIC OBSTACLE (touched a dynamic obstacle)",
        ),
        ("wall", {"goal": [1.0, 0.0]}, "GOAL (nearest "),
    ],
)
def test_an_ending_is_shown_and_a_new_episode_begins_at_rest(task, settings, message, teleoperate):
    teleop = teleoperate(task, **settings)
    start = teleop.robot_state.pose[0]
    assert (teleop.dynamic_obstacles is None) == ("dynamic_obstacles" not in settings)
    drive(teleop, 0.6, 0.0, 200)
    assert any(line.startswith(message) and line.endswith("): new episode") for line in teleop.lines(24))
    assert teleop.robot_state.pose[0] == pytest.approx(start, abs=1e-3)
    assert not teleop.command.any()


def test_a_system_without_curses_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "curses", None)
    with pytest.raises(InputError, match="curses, which Windows lacks"):
        steer_in_terminal(None, None)


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)
def test_letters_and_arrows_drive_in_a_terminal_and_q_ends():
    """It waits at most a minute for each text, because the process imports torch first."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "100"}
    environment.pop("DISPLAY", None)
    arguments = [sys.executable, "-m", "tb2rl.play", "--teleop", "--task", "wall", "--set", "task.start=fixed"]
    process = subprocess.Popen(arguments, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    try:
        for text, keys in ((b"q ends", b"w\x1bOA"), (b"forward", b"q")):  # a letter and the arrow up; the end
            seen, until = b"", time.monotonic() + 60
            while text not in seen:
                assert select.select([ours], [], [], 60)[0], seen
                assert time.monotonic() < until, seen
                seen += os.read(ours, 65536)
            os.write(ours, keys)
        assert process.wait(timeout=30) == 0
    finally:
        process.kill()
        process.wait()
        os.close(ours)
