"""`drive`, and `--simulation ros`, on real graphs of ROS 1 and ROS 2: policies drive the robot of `simulate`."""

import json
import re
import signal
import time
from contextlib import contextmanager

import pytest

import tb2rl
from tb2rl.deploy.ros.events import EVENTS

pytestmark = pytest.mark.slow
STEPS, REAL_TIME = 300, 8.0  # [control steps], [s]
LOCKSTEP = ["--rate", "0", "--scan-rate", "5", "--lockstep", "60"]
POLICY = {1: "zoo:maze-loop-ppo", 2: "zoo:maze-loop-qlearn"}  # by version of ROS
VELOCITY = {1: "/cmd_vel_mux/input/navi", 2: "/cmd_vel"}
GOALS = {1: "/move_base_simple/goal", 2: "/goal_pose"}
START_X, START_Y = -3.75, -3.75  # [m] of the world `loop`
RECORD = re.compile(r"from .*: ([\d.]+) s, ([\d.]+) m, touched something (\d+) times, nearest range .* m")
LATENCY = re.compile(r"\d+ scans, .* \(of processor time: ([\d.]+) ms, 99 % within ([\d.]+) ms\)")


def sim_time(graph):
    return ["--ros-args", "-p", "use_sim_time:=true"] if graph.version == 2 else []


def drive(graph, *more):
    return graph.start("drive", POLICY[graph.version], *more, *sim_time(graph))


def evaluate(graph, *more):
    arguments = [POLICY[graph.version], "--simulation", "ros", "--ros", str(graph.version), *more, *sim_time(graph)]
    return graph.command("evaluate", *arguments)


def simulate(graph, *more):
    return graph.start("simulate", "--topics", "scan=/scan", *more)


@contextmanager
def watching(graph):
    """A node that knows the time, and notices commands and motion."""
    with graph.probe() as probe:
        probe.subscribe("/clock", "rosgraph_msgs/Clock")
        probe.watch(velocity=VELOCITY[graph.version], odometry="/odom")
        yield probe


def wait_for(process, line, after=0):
    """Wait until a process prints a line, behind so many others."""
    while process.wait_for_line(after) != line:
        after += 1


def mean_speed(lines):
    """The mean speed of the last record [m/s]; none has a contact."""
    records = [RECORD.fullmatch(line).groups() for line in lines if line.startswith("from ")]
    assert {contacts for *_, contacts in records} == {"0"}
    seconds, distance, _ = records[-1]
    return float(distance) / float(seconds)


@pytest.mark.flaky(reruns=1)  # it compares processor time
def test_in_lockstep_it_drives_as_in_an_evaluation_and_is_evaluated_as_here(graph):
    policy = POLICY[graph.version]
    with simulate(graph, *LOCKSTEP, "--set", "task.start=random", "--seed", "5") as simulated:
        with drive(graph) as driven, watching(graph) as probe:
            wait_for(driven, "driving")
            probe.call("/gazebo/reset_world")
            probe.pass_time(seconds=STEPS / 5)
            assert driven.stop() == 0
        assert simulated.stop() == 0
        assert (simulated.errors, driven.errors) == ([], [])
    driven_at = mean_speed(simulated.lines)
    median, most = LATENCY.fullmatch(driven.lines[-1]).groups()
    assert simulated.lines[-1] == "scans that no command answered: 0"
    assert (float(median) <= 3.0, float(most) <= 10.0) == (True, True), driven.lines[-1]
    with simulate(graph, *LOCKSTEP) as simulated:
        with evaluate(graph, "--steps", str(STEPS), "--json", "result.json") as evaluating:
            assert evaluating.wait() == 0, evaluating.errors
        assert simulated.stop() == 0
    result = json.loads((graph.folder / "result.json").read_text())
    assert (result["simulation"], {each["ended"] for each in result["each"]}) == ("ros", {"time limit"})
    expected = tb2rl.evaluate(policy, episodes=4, steps=STEPS, workers=1).summary()["mean_speed"]
    assert [driven_at, result["mean_speed"]] == pytest.approx([expected, expected], rel=0.05)


@pytest.mark.flaky(reruns=1)  # in real time
def test_in_real_time_it_drives_and_stops_at_a_service_a_signal_and_when_either_side_is_killed(graph):
    with simulate(graph) as first, watching(graph) as probe:
        with drive(graph, "--wait") as driven:
            check_services(driven, probe)
            assert driven.stop(signal.SIGTERM) == 0
            assert driven.lines[-2] == "stopped: the node ends"
        with drive(graph) as driven:
            wait_for(driven, "driving")
            probe.call("/gazebo/reset_world")
            took = probe.pass_time(seconds=REAL_TIME)
            probe.call("/gazebo/reset_world")  # ends the record
            assert mean_speed(first.lines) > 0.25, f"{REAL_TIME} s took {took:.1f} s of wall-clock time"
            probe.watched(until="move command", seconds=1.0)
            first.close()
            gone = probe.watched(seconds=2.0)
            assert 0.0 < gone["stop command"] - gone["move command"] < 0.6, "after the robot was killed"
            seen = len(driven.lines)
            with simulate(graph):
                wait_for(driven, "driving", seen - 1)
                probe.watched(until="move command", seconds=1.0)
                driven.close()
                killed = probe.watched(seconds=3.0)
                assert killed["went on"] < 0.9, "simulated seconds after the node was killed"


def check_services(driven, probe):
    probe.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    wait_for(driven, "stopped: not started")
    until = time.monotonic() + 300.0
    while (answer := probe.call("/tb2rl_driver/start", "std_srvs/Trigger")) == [False, "no scan has arrived yet"]:
        assert time.monotonic() < until, "no scan within 300 s"
    assert answer == [True, ""]
    probe.watched(until="move command")
    assert probe.call("/tb2rl_driver/stop", "std_srvs/Trigger") == [True, ""]
    stopped = probe.watched(seconds=1.0)
    assert stopped["stop command"] > stopped["move command"]
    (status,) = probe.take("/diagnostics")[0]["status"]
    assert (status["name"], status["message"]) == ("tb2rl_driver: policy", "told to stop")


def check_diagnostics(probe, why):
    """Wait until the node reports a reason in its diagnostics, which it does once a second."""
    for _ in range(10):
        (status,) = probe.take("/diagnostics")[0]["status"]
        if status["message"] == why:
            return
    raise AssertionError(status)


def start_when_over(probe, why):
    """Start the driver once an event is over, whose message may be on its way."""
    until, answer = time.monotonic() + 60.0, [False, why]
    while answer == [False, why]:
        assert time.monotonic() < until, why
        answer = probe.call("/tb2rl_driver/start", "std_srvs/Trigger")
    assert answer == [True, ""]


@pytest.mark.flaky(reruns=1)  # in real time
def test_each_event_of_the_base_stops_it_until_it_has_ended_and_it_is_started_again(graph):
    with simulate(graph, "--rate", "2") as _, watching(graph) as probe, drive(graph, "--speed", "0.1") as driven:

        def toggle():
            assert probe.call(f"/tb2rl_simulation/{name}", "std_srvs/Trigger") == [True, ""]

        def push():
            """Another program drives the robot into a wall, because this one does not."""
            until = time.monotonic() + 60.0
            while stopped not in driven.lines:
                assert time.monotonic() < until, driven.lines
                probe.drive(0.6, 0.0, topic=VELOCITY[3 - graph.version])

        probe.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        wait_for(driven, "driving")
        for name, event_type in EVENTS.items():
            probe.watched(until="move command", seconds=0.5)
            seen, stopped = len(driven.lines), f"stopped: {event_type.why}"
            begin, end = (push, lambda: probe.call("/gazebo/reset_world")) if name == "bumper" else (toggle, toggle)
            begin()
            wait_for(driven, stopped, seen)
            after = probe.watched(seconds=0.5)
            assert after["stop command"] > after["move command"]
            check_diagnostics(probe, event_type.why)
            assert probe.call("/tb2rl_driver/start", "std_srvs/Trigger") == [False, event_type.why]
            seen = len(driven.lines)
            end()
            start_when_over(probe, event_type.why)
            wait_for(driven, "driving", seen)
        check_signal(driven, probe, signal.SIGQUIT)


def check_signal(driven, probe, sign):
    """A signal stops a moving robot, and ends the node."""
    probe.watched(until="move command")
    assert driven.stop(sign) == 0
    after = probe.watched(seconds=0.5)
    assert after["stop command"] > after["move command"]
    assert "stopped: the node ends" in driven.lines[-3:]


@pytest.mark.flaky(reruns=1)  # in real time
def test_it_stops_at_its_goal_without_odometry_and_while_simulated_time_stands_still(graph):
    goals = GOALS[graph.version]
    arguments = ["zoo:navigate-goal-ppo", "--topics", "odometry=/relayed", *sim_time(graph)]
    with simulate(graph) as _, watching(graph) as probe, graph.start("drive", *arguments) as driven:
        probe.relay("/odom", "/relayed", "nav_msgs/Odometry")
        probe.send_goal(goals, START_X + 0.8, START_Y)
        wait_for(driven, "driving")
        wait_for(driven, "stopped: the goal is reached")
        for cause, reason, undo in (
            (lambda: None, "the goal is reached", lambda: probe.send_goal(goals, START_X + 6.0, START_Y)),
            (lambda: probe.mute(True), "the last odometry is ", lambda: probe.mute(False)),
            (
                lambda: probe.call("/gazebo/pause_physics"),
                "simulated time is frozen",
                lambda: probe.call("/gazebo/unpause_physics"),
            ),
        ):
            cause()
            until = time.monotonic() + 60.0
            while not driven.lines[-1].startswith(f"stopped: {reason}"):
                assert time.monotonic() < until, driven.lines
                time.sleep(0.02)
            after, seen = probe.watched(seconds=0.5), len(driven.lines)
            assert after["stop command"] > after["move command"], reason
            undo()
            wait_for(driven, "driving", seen)
        check_signal(driven, probe, signal.SIGHUP)


@pytest.mark.flaky(reruns=1)  # in real time
def test_an_evaluation_in_real_time_stops_the_robot_at_a_signal_and_says_that_it_is_lost(graph):
    with simulate(graph) as simulated, watching(graph) as probe:
        with evaluate(graph) as evaluating:
            probe.watched(until="moved", seconds=1.0)
            assert evaluating.stop({1: signal.SIGINT, 2: signal.SIGTERM}[graph.version]) == 130
            assert [line for line in evaluating.errors if "Traceback" in line] == []
            ended = probe.watched(seconds=1.0)
            assert ended["stop command"] > ended["move command"]
        with evaluate(graph) as evaluating:
            probe.watched(until="moved", seconds=1.0)
            simulated.close()
            assert evaluating.wait() == 2
    assert evaluating.errors[-1] == "error: the robot was stopped: no scan arrives on /scan"
