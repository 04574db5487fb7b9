"""`drive`, and `--simulation ros`, on real graphs of ROS 1 and ROS 2: policies drive the robot of `simulate`."""

import json
import re
import signal
import time
from contextlib import contextmanager

import pytest

import tb2rl
from tb2rl.deploy.ros.debian import write_packages
from tb2rl.deploy.ros.events import EVENTS
from tb2rl.envs.safety import REASONS

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


def drive(graph, *more, **options):
    return graph.start("drive", POLICY[graph.version], *more, *sim_time(graph), **options)


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


def wait_for(process, beginning, after=0):
    """Wait until a process prints a line with a beginning, behind so many others."""
    while not process.wait_for_line(after).startswith(beginning):
        after += 1


def trigger(probe, service):
    assert probe.call(service, "std_srvs/Trigger") == [True, ""]


def mean_speed(lines):
    """The mean speed of the last record [m/s]; none has a contact."""
    records = [RECORD.fullmatch(line).groups() for line in lines if line.startswith("from ")]
    assert {contacts for *_, contacts in records} == {"0"}
    seconds, distance, _ = records[-1]
    return float(distance) / float(seconds)


@pytest.mark.flaky(reruns=3)  # it compares processor time
def test_in_lockstep_it_drives_as_in_an_evaluation_and_is_evaluated_as_here(graph):
    policy = POLICY[graph.version]
    with simulate(graph, *LOCKSTEP, "--set", "task.start=random", "--seed", "5") as simulated:
        with drive(graph) as driven, watching(graph) as probe:
            wait_for(driven, "driving")
            probe.call("/gazebo/reset_world")
            probe.pass_time(seconds=STEPS / 5)
            check_signal(driven, probe, signal.SIGINT)
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


@pytest.mark.flaky(reruns=3)  # in real time
def test_in_real_time_it_drives_and_stops_at_a_service_a_signal_and_when_either_side_is_killed(graph):
    with simulate(graph) as first, watching(graph) as probe:
        with drive(graph, "--wait") as driven:
            check_services(driven, probe)
            check_other_programs_drive(probe, graph.version)
            trigger(probe, "/tb2rl_driver/start")
            check_signal(driven, probe, signal.SIGTERM)
        with drive(graph, under=["nohup"]) as driven:
            wait_for(driven, "driving")
            driven.send_signal(signal.SIGHUP)
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
    trigger(probe, "/tb2rl_driver/stop")
    stopped = probe.watched(seconds=1.0)
    assert stopped["stop command"] > stopped["move command"]
    (status,) = probe.take("/diagnostics")[0]["status"]
    assert (status["name"], status["message"]) == ("tb2rl_driver: policy", "told to stop")


def check_other_programs_drive(probe, version):
    """A stopped driver soon publishes nothing any more, and obstructs no other program."""
    probe.subscribe(VELOCITY[version], "geometry_msgs/Twist")
    until = time.monotonic() + 60.0
    while probe.count(VELOCITY[version], seconds=0.5):
        assert time.monotonic() < until, "it still publishes"
    probe.drive(0.0, 0.5, topic=VELOCITY[3 - version])
    probe.watched(until="moved")


def check_diagnostics(probe, why, filters=None):
    """Wait until the node reports a reason in its diagnostics, which it does once a second."""
    for _ in range(30):
        (status,) = probe.take("/diagnostics")[0]["status"]
        values = {each["key"]: each["value"] for each in status["values"]}
        if (status["message"], values.get("filters")) == (why, filters):
            return
    raise AssertionError(status)


def start_when_over(probe, why):
    """Start the driver once an event is over, whose message may be on its way."""
    until, answer = time.monotonic() + 60.0, [False, why]
    while answer == [False, why]:
        assert time.monotonic() < until, why
        answer = probe.call("/tb2rl_driver/start", "std_srvs/Trigger")
    assert answer == [True, ""]


@pytest.mark.flaky(reruns=3)  # in real time
def test_each_event_of_the_base_stops_it_until_it_has_ended_and_it_is_started_again(graph):
    if graph.version == 1:
        write_packages(graph.folder / "messages")  # those of the Kobuki; in ROS 2 std_msgs/Bool takes their place
    with simulate(graph, "--rate", "2") as _, watching(graph) as probe, drive(graph, "--speed", "0.1") as driven:

        def toggle():
            trigger(probe, f"/tb2rl_simulation/{name}")

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
    assert ("warning: the messages of the Kobuki" in "\n".join(driven.lines)) == (graph.version == 2)


def check_signal(driven, probe, sign):
    """A signal stops a moving robot, and ends the node."""
    probe.watched(until="move command")
    assert driven.stop(sign) == 0
    after = probe.watched(seconds=0.5)
    assert after["stop command"] > after["move command"]
    assert "stopped: the node ends" in driven.lines[-3:]


@pytest.mark.flaky(reruns=3)  # in real time
def test_a_dry_run_commands_nothing_and_a_scanner_that_does_not_fit_and_the_safety_filter_stop_it(graph, trained_run):
    with simulate(graph, "--set", "task.world=wall") as simulated, watching(graph) as probe:
        with drive(graph, "--dry-run") as driven:
            assert driven.lines[0].endswith(f" on ROS {graph.version}: scans from /scan, no commands (dry run)")
            wait_for(driven, "dry run: 0.")
            trigger(probe, "/tb2rl_simulation/button")
            wait_for(driven, "stopped: a button was pressed")
            last = probe.watched(seconds=0.5)
            assert (last["move command"], last["stop command"]) == (0.0, 0.0)
        trigger(probe, "/tb2rl_simulation/button")
        with drive(graph, "--mounting", "0.1,0,3.14159") as driven:
            wait_for(driven, "error: the scan covers 180 degrees (90 to 270), ")
            assert probe.watched(seconds=0.5)["move command"] == 0.0
        probe.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        with graph.start("drive", str(trained_run), *sim_time(graph)) as driven:  # it has hardly learned anything
            wait_for(driven, f"slowed: {REASONS[1]}")
            check_diagnostics(probe, "driving", REASONS[1])
            assert driven.stop() == 0
            assert any(re.fullmatch(r"the safety filter changed \d+ of \d+ commands", line) for line in driven.lines)
        assert simulated.stop() == 0
        assert ", touched something 0 times, " in simulated.lines[-1]


@pytest.mark.flaky(reruns=3)  # in real time
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


@pytest.mark.flaky(reruns=3)  # in real time
def test_an_evaluation_in_real_time_ends_at_an_event_of_the_base_a_signal_and_when_the_robot_is_lost(graph):
    with simulate(graph) as simulated, watching(graph) as probe:
        with evaluate(graph, "--json", "contact.json") as evaluating:
            probe.watched(until="moved")
            trigger(probe, "/tb2rl_simulation/cliff")
            assert evaluating.wait() == 0
        (episode,) = json.loads((graph.folder / "contact.json").read_text())["each"]
        assert episode["ended"] == "collision"
        trigger(probe, "/tb2rl_simulation/cliff")
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
