"""`python -m tb2rl.ros drive` on real graphs of ROS 1 and ROS 2: policies of the zoo drive the robot of `simulate`.

ALL_STARTS=1 pytest -m slow tests/deploy/ros/test_drive.py    # twenty starts, and minutes in real time
"""

from __future__ import annotations

import os
import re
import signal
import time
from contextlib import contextmanager

import pytest

import tb2rl

pytestmark = pytest.mark.slow
ALL = "ALL_STARTS" in os.environ
STARTS, REAL_TIME = (20, 60.0) if ALL else (2, 8.0)  # [s] of real time
EPISODE = 300.0  # [s] 1 500 steps
VELOCITY = {1: "/cmd_vel_mux/input/navi", 2: "/cmd_vel"}
RECORD = re.compile(r"from .*: ([\d.]+) s, ([\d.]+) m, touched something (\d+) times, nearest range ([\d.]+) m")
ANSWERED = re.compile(r"(\d+) scans, .* \(of processor time: ([\d.]+) ms, 99 % within ([\d.]+) ms\)")


def drive(graph, policy, *more):
    """The node, with the time of the simulation."""
    sim_time = ["--ros-args", "-p", "use_sim_time:=true"] if graph.version == 2 else []
    return graph.start("drive", f"zoo:{policy}", *more, *sim_time)


def simulate(graph, *more):
    return graph.start("simulate", "--topics", "scan=/scan", *more)


@contextmanager
def watching(graph):
    """A node that knows the time, and notices what wheels and robot do."""
    with graph.probe() as probe:
        probe.listen("/clock", "rosgraph_msgs/Clock")
        probe.ask("watch", velocity=VELOCITY[graph.version], odometry="/odom")
        yield probe


def wait_for(process, line, after=0):
    """Until a process says it: how many lines there are then."""
    while process.wait_for_line(after) != line:
        after += 1
    return after + 1


def speeds(lines):
    """Of each record of a drive without a touch [m/s]."""
    records = [RECORD.fullmatch(line).groups() for line in lines if line.startswith("from ")]
    assert [record for record in records if record[2] != "0"] == []
    return [float(distance) / float(seconds) for seconds, distance, *_ in records]


def report(what, **figures):
    print(what, *(f"{name} {figure:.3g}" for name, figure in figures.items()))


@pytest.mark.parametrize("policy", ["maze-loop-ppo", "maze-loop-qlearn"])
def test_in_lockstep_it_drives_as_in_an_evaluation(policy, graph):
    lockstep = ["--rate", "0", "--scan-rate", "5", "--lockstep", "60", "--set", "task.start=random", "--seed", "5"]
    took = []
    with simulate(graph, *lockstep) as simulated, drive(graph, policy) as driven, watching(graph) as probe:
        wait_for(driven, "driving")
        for _ in range(STARTS):
            probe.call("/gazebo/reset_world")
            took.append(probe.ask("pass_time", seconds=EPISODE))
        assert simulated.stop() == 0
        assert driven.stop() == 0
        assert (simulated.errors, driven.errors) == ([], [])
    expected = tb2rl.evaluate(f"zoo:{policy}", episodes=4, workers=1).summary()["mean_speed"]
    found = speeds(simulated.lines)[-STARTS:]
    _, median, most = ANSWERED.fullmatch(driven.lines[-1]).groups()
    report(
        policy,
        mean=sum(found) / STARTS,
        slowest=min(found),
        fastest=max(found),
        evaluated=expected,
        times_real_time=EPISODE / max(took),
    )
    report(driven.lines[-1])
    assert len(found) == STARTS
    assert sum(found) / STARTS == pytest.approx(expected, rel=0.05)
    assert simulated.lines[-1] == "scans that no command answered: 0"
    assert float(median) <= 3.0
    assert float(most) <= 10.0


@pytest.mark.parametrize("policy", ["maze-loop-ppo", "maze-loop-qlearn"] if ALL else ["maze-loop-ppo"])
def test_it_drives_in_real_time(policy, graph):
    with simulate(graph) as simulated, drive(graph, policy) as driven, watching(graph) as probe:
        wait_for(driven, "driving")
        probe.call("/gazebo/reset_world")
        took = probe.ask("pass_time", seconds=REAL_TIME)
        probe.call("/gazebo/reset_world")  # which ends the record
        assert driven.stop(signal.SIGTERM) == 0
        assert simulated.stop() == 0
    speed = speeds(simulated.lines)[-2]
    report(policy, speed=speed, took=took)
    report(driven.lines[-1])
    assert driven.lines[-2] == "it stands: the node ends"
    assert speed > 0.25, "on a machine that may be busy"


def test_who_is_killed_stops_the_robot_and_who_comes_back_goes_on(graph):
    with simulate(graph) as first, drive(graph, "maze-loop-qlearn") as driven, watching(graph) as probe:
        wait_for(driven, "driving")
        probe.ask("watched", until="told to move", seconds=1.0)
        first.close()
        gone = probe.ask("watched", seconds=2.0)
        report("robot killed", told_to_stand_after=gone["told to stand"] - gone["told to move"])
        seen = len(driven.lines)
        with simulate(graph):
            wait_for(driven, "driving", seen - 1)
            probe.ask("watched", until="told to move", seconds=1.0)
            driven.close()
            killed = probe.ask("watched", seconds=3.0)
            report("node killed", stands_after=killed["went on"])
            with drive(graph, "maze-loop-qlearn") as again:
                wait_for(again, "driving")
                probe.ask("watched", until="told to move")
                assert again.stop(signal.SIGHUP) == 0
                ended = probe.ask("watched", seconds=1.0)
    assert 0.0 < gone["told to stand"] - gone["told to move"] < 0.6
    assert killed["went on"] < 0.9
    assert ended["told to stand"] > ended["told to move"]


def test_services_start_and_stop_it(graph):
    with simulate(graph), drive(graph, "maze-loop-qlearn", "--wait") as driven, watching(graph) as probe:
        probe.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        wait_for(driven, "it stands: not started")
        start = {"service": "/tb2rl_driver/start"}
        until = time.monotonic() + 300.0
        while (answer := probe.ask("trigger", **start)) == [False, "no scan has come yet"]:
            assert time.monotonic() < until
        assert answer == [True, ""]
        probe.ask("watched", until="told to move")
        assert probe.ask("trigger", service="/tb2rl_driver/stop") == [True, ""]
        stopped = probe.ask("watched", seconds=1.0)
        assert stopped["told to stand"] > stopped["told to move"]
        (status,) = probe.take("/diagnostics")[0]["status"]
        assert (status["name"], status["message"]) == ("tb2rl_driver: policy", "told to stop")


def test_a_dry_run_moves_nothing(graph):
    with simulate(graph) as simulated, drive(graph, "maze-loop-qlearn", "--dry-run") as driven:
        number = wait_for(driven, "dry run")
        assert driven.wait_for_line(number).startswith("it would drive 0.")
        assert driven.stop() == 0
        assert simulated.stop() == 0
    assert speeds(simulated.lines) == [0.0]
