"""Keys change the command within what the robot can do; the task says what that is worth and when it is over."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots import Laser
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.tasks.my_turtlebot2_maze import MyTurtleBot2Maze
from tb2rl.viz.keyboard import STILL, Teleop, range_lines, steered

MAX_SPEED, MAX_TURN_RATE = ROBOT.max_speed, ROBOT.max_turn_rate


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
        given = steered(ROBOT, given, key)
    assert given == pytest.approx(command, abs=1e-3)


def test_the_limits_are_those_of_the_robot_that_is_driven():
    slow = replace(ROBOT, max_speed=0.15, max_turn_rate=0.7)
    given = STILL
    for key in "wwaa":
        given = steered(slow, given, key)
    assert given == pytest.approx((0.15, 0.7))


def test_the_nearest_action_is_the_one_that_does_alike():
    task = MyTurtleBot2Maze()
    for command, action in (((0.4, 0.1), 0), ((0.1, 1.5), 1), ((0.0, -0.8), 2), ((-0.2, 0.0), 3)):
        assert task.actions.nearest(np.array(command)) == action


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
def drive(make) -> Iterator[Callable[..., Teleop]]:
    """A function from a task and its settings to a robot to drive there."""
    with ExitStack() as stack:
        yield lambda *task, **settings: stack.enter_context(
            closing(Teleop(make.config(*task, start="fixed", **settings).scene, seed=0))
        )


def drive_on(teleop: Teleop, v: float, w: float, steps: int) -> None:
    """Hold a command v [m/s], w [rad/s] for some steps, or until the robot is stopped."""
    teleop.command = np.array([v, w])
    for _ in range(steps):
        teleop.step()
        if not teleop.command.any():
            return


def test_the_robot_goes_where_it_is_steered(drive):
    teleop = drive()
    x, _, yaw = teleop.robot_state.pose[0]
    drive_on(teleop, 0.4, 0.0, 5)
    assert teleop.robot_state.pose[0, 0] - x == pytest.approx(0.4, abs=0.05)
    assert "as action forward: reward +5" in teleop.lines(24)
    drive_on(teleop, 0.0, 0.5, 5)
    assert teleop.robot_state.pose[0, 2] - yaw == pytest.approx(0.5, abs=0.1)  # it has to gather speed
    assert next(line for line in teleop.lines(24) if line.startswith("robot")).split()[-2:] == ["+0.50", "rad/s"]


def test_keys_steer_the_robot(drive):
    teleop = drive()
    for key in "wwa":
        teleop.steer(key)
    assert "command  v +0.20 m/s   w +0.50 rad/s" in teleop.lines(24)
    teleop.steer(" ")
    assert "command  v +0.00 m/s   w +0.00 rad/s" in teleop.lines(24)


def test_velocities_are_rewarded_as_they_are_driven(drive, cruise):
    teleop = drive(cruise, beams=3, observation="raw")
    drive_on(teleop, 0.4, 0.2, 5)
    (news,) = (line for line in teleop.lines(24) if line.startswith("as action"))
    assert news.startswith("as action 0.40, +0.20: reward +0.8")
    ranges = teleop.lines(24)[-3:]
    assert [line[:8] for line in ranges] == [" -90 deg", "  +0 deg", " +90 deg"]
    assert "class" not in "".join(ranges), "raw ranges have none"


@pytest.mark.parametrize(
    ("task", "settings", "said"),
    [
        ("maze", {}, "CRASH (nearest 0."),
        ("maze", {"collision_range": 0.0}, "CRASH (touched a wall)"),
        ("wall", {"bounds": [-1.0, -3.0, 0.5, 3.0]}, "OUT OF BOUNDS (nearest "),
        ("wall", {"goal": [1.0, 0.0]}, "GOAL (nearest "),
    ],
)
def test_an_ending_is_named_and_starts_again_at_rest(task, settings, said, drive):
    teleop = drive(task, **settings)
    start = teleop.robot_state.pose[0]
    drive_on(teleop, 0.6, 0.0, 200)
    assert any(line.startswith(said) and line.endswith("): a new start") for line in teleop.lines(24))
    assert teleop.robot_state.pose[0] == pytest.approx(start, abs=1e-3)
    assert not teleop.command.any()


def test_the_screen_fits_the_terminal(drive):
    teleop = drive()
    assert len(teleop.lines(24)) == 14
    assert [len(teleop.lines(height)) for height in (1, 5, 9)] == [1, 5, 9]
    assert teleop.lines(24)[0].startswith("loop: arrows or w/a/s/d change the speeds")
