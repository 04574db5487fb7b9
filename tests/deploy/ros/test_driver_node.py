"""A driver on a fake node: when it starts, its commands, and its printed lines."""

import errno
import math
import re
import signal
import threading
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from tb2rl.deploy import Driver, SpeedLimits
from tb2rl.deploy.bags.messages import BagMessages
from tb2rl.deploy.ros.driver_node import DriverNode, run
from tb2rl.deploy.ros.events import EVENTS, BumperEvent
from tb2rl.deploy.ros.messages import BILLION, Goal, LaserScan, Odometry, Plan, Twist
from tb2rl.deploy.ros.topics import TURTLEBOT2
from tb2rl.envs.parts import robot_facts
from tb2rl.envs.safety import REASONS
from tb2rl.envs.scene import make_scene
from tb2rl.ros import main
from tb2rl.tasks.drive import Drive

pytest.importorskip("rosbags")
TOPICS = TURTLEBOT2[1]
FORWARD, STILL = (0.4, 0.2), (0.0, 0.0)
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]


class Robot:
    """The robot's side of the topics of a driver node; it scans ten times a second."""

    def __init__(self, node, clock, policy):
        self.node, self.clock, self.policy = node, clock, policy

    def scan(self, count=1, odometry=True, age=0.0, distance=2.0):
        for _ in range(count):
            self.node.time = round(self.node.time + 0.1, 6)
            stamp = round((self.node.time - age) * BILLION)
            if odometry:
                self.publish("odometry", Odometry(stamp, "odom", "base", (1.0, 0.0, 0.0), STILL))
            self.publish("scan", LaserScan(stamp, "laser", -1.58, 3.16 / 360, 0.1, 0.1, 30.0, np.full(361, distance)))

    def publish(self, topic, message):
        self.node.receive[getattr(TOPICS, topic)](message)

    def call(self, service):
        return self.node.services[f"~/{service}"]()

    def run(self, seconds):
        """Let the node run for so long without sensor data."""
        ending, until, start = threading.Event(), self.clock.time + seconds, self.clock.time - self.node.time

        def follow():
            self.node.time = round(self.clock.time - start, 6)
            if self.clock.time >= until:
                ending.set()

        self.clock.events.append(follow)
        self.driver_node.run(ending)
        self.clock.events.remove(follow)

    def commands(self):
        """The commands since the last call."""
        commands = self.node.commands(TOPICS.velocity)
        self.node.topics[TOPICS.velocity].messages.clear()
        return commands


@pytest.fixture
def robot(node, clock, scripted_policy, monkeypatch):
    """A function that makes a `Robot` and its driver node."""
    monkeypatch.setattr("tb2rl.deploy.ros.driver_node.WallClock", lambda: clock)
    scene = make_scene(Drive(), "raw")
    facts = robot_facts(scene.task, scene.spec)

    def make(waits=False, dry_run=False, limits=None, safety=False, **needs):
        robot = Robot(node, clock, scripted_policy(**needs))
        robot.policy.safety = facts if safety else None
        robot.driver = Driver(robot.policy, limits, dry_run=dry_run)
        robot.driver_node = DriverNode(robot.driver, node, TOPICS, waits)
        return robot

    return make


def lines(capsys):
    return capsys.readouterr().out.splitlines()


def test_it_starts_by_itself_after_five_scans_and_answers_each(robot, capsys):
    it = robot()
    it.scan(4)
    assert it.commands() == [STILL] * 4
    it.scan(6)
    assert it.commands() == [FORWARD] * 6
    assert [len(episode) for episode in it.policy.episodes] == [3], "it decides each 0.2 s"
    assert lines(capsys) == ["driving"]


def test_services_start_and_stop_it_and_so_does_a_contact(robot, capsys):
    it = robot(waits=True)
    it.scan(20)
    assert set(it.commands()) == {STILL}
    for stop in (lambda: it.call("stop"), lambda: it.publish("bumper", BumperEvent(1, True))):
        assert it.call("start") == ""
        it.scan()
        assert it.commands() == [FORWARD]
        stop()
        assert it.commands() == [STILL], "at once"
        it.scan()
        assert it.commands() == [STILL]
    stands = [f"stopped: {reason}" for reason in ("not started", "told to stop", "the bumper was touched")]
    assert lines(capsys) == [stands[0], "driving", stands[1], "driving", stands[2]]


@pytest.mark.parametrize("name", EVENTS)
def test_an_event_of_the_base_stops_it_until_it_has_ended_and_the_next_start(name, robot, capsys):
    it, event_type = robot(waits=True), EVENTS[name]
    it.scan(5)
    it.call("start")
    it.scan()
    it.commands()
    for part in (0, 1):
        it.publish(name, event_type(part, True))
    assert it.commands()[0] == STILL, "at once"
    it.publish(name, event_type(0, False))
    assert it.call("start") == event_type.why, "the other part still reports it"
    it.publish(name, event_type(1, False))
    it.scan()
    assert set(it.commands()) == {STILL}, "its end does not start the robot"
    assert it.call("start") == ""
    it.scan()
    assert it.commands()[-1] == FORWARD
    printed = ["stopped: not started", "driving", f"stopped: {event_type.why}", f"error: {event_type.why}", "driving"]
    assert lines(capsys) == printed


def test_a_serious_finding_prevents_the_start_and_is_in_the_diagnostics(robot, node, capsys):
    it = robot(goal="goal")
    it.scan(8)
    assert set(it.commands()) == {STILL}
    serious = it.call("start")
    it.run(1.1)
    it.publish("goal", Goal(0, "odom", (4.0, 0.0)))
    it.scan()
    assert it.commands()[-1] == FORWARD
    it.clock.sleep(1.0)
    it.run(0.1)
    lost, fine = node.topics["/diagnostics"].messages
    assert (lost.level, lost.values["finding 1"]) == ("ERROR", serious)
    assert (fine.level, fine.summary, fine.values["v [m/s]"]) == ("OK", "driving", "0.400")
    printed = lines(capsys)
    assert printed.count(f"error: {serious}") == 1
    assert printed[-2:] == ["the goal is (4.00, 0.00) in 'odom'", "driving"]


def test_it_says_when_the_safety_filter_slows_the_robot_down_and_how_often(robot, node, capsys):
    it = robot(safety=True)
    it.scan(10, distance=0.19)
    assert all(v == 0.0 for v, _ in it.commands())
    it.clock.sleep(1.0)
    it.run(0.1)
    assert node.topics["/diagnostics"].messages[-1].values["filters"] == REASONS[1]
    it.driver_node.close()
    printed = lines(capsys)
    assert printed[:2] == [f"slowed: {REASONS[1]}", "driving"]
    assert re.search(r"the safety filter changed \d of \d commands", "\n".join(printed))


def test_missing_scans_and_minor_findings_are_printed(robot, capsys):
    it = robot(limits=SpeedLimits(speed=0.2))
    it.run(3.1)
    it.scan(5)
    assert it.commands()[-1] == (0.2, 0.1)
    slowed = "warning: the policy's 0.5 m/s are limited to 0.2 m/s"
    assert lines(capsys) == ["error: no scan has arrived yet", slowed, "driving"]


def test_it_stands_while_scans_are_missing_and_then_drives_on(robot, capsys):
    it = robot()
    it.scan(6)
    it.commands()
    it.run(0.45)
    assert set(it.commands()) == {FORWARD}, "by the last scan"
    it.run(2.0)
    assert it.commands() == [STILL] * 9, "then other programs may drive the robot"
    it.scan()
    assert it.commands() == [FORWARD]
    assert lines(capsys)[1:] == ["stopped: the last scan is 0.5 s old", "driving"]


def test_it_stands_while_simulated_time_stands_still(robot, node, clock, capsys):
    node.sim_time = True
    it = robot()
    it.scan(6)
    it.driver_node._poll()
    it.commands()
    clock.sleep(0.5)
    it.driver_node._poll()
    assert it.commands() == [STILL]
    node.time = 0.0  # a reset of the simulation
    it.scan(2)
    assert it.commands() == [FORWARD] * 2
    assert lines(capsys) == ["driving", "stopped: simulated time is frozen", "driving"]


def test_in_simulated_time_a_scan_may_arrive_before_its_clock(robot, node):
    node.sim_time = True
    it = robot()
    it.scan(12, odometry=False, age=-0.2)
    assert len(it.policy.episodes[-1]) == 4
    assert it.commands()[-2:] == [FORWARD] * 2


def test_goals_and_plans_in_another_frame_are_refused_and_early_ones_wait_for_odometry(robot, capsys):
    it = robot(goal="goal")
    it.publish("goal", Goal(0, "map", (4.0, 0.0)))
    assert lines(capsys) == []
    it.scan()
    it.publish("goal", Goal(0, "odom", (math.nan, 0.0)))
    frames = "its frame is 'map'; send it in the frame of the odometry, 'odom'"
    numbers = "the goal has a number that is not finite, or too large: nan, 0.0"
    assert lines(capsys) == [f"the goal is ignored: {reason}" for reason in (frames, numbers)]


def test_it_follows_a_plan_to_its_end(robot, capsys):
    it = robot(goal="plan", lookahead=1.0)
    it.scan()
    it.publish("plan", Plan("odom", np.empty((0, 2))))
    it.publish("plan", Plan("odom", np.array([[1.0, 0.0], [1.0, 3.0]])))
    it.scan(6)
    assert it.policy.episodes[-1][-1].waypoint == pytest.approx((1.0, 1.0))
    it.publish("plan", Plan("odom", np.array([[1.0, 0.0], [1.0, 0.1]])))
    it.scan()
    assert lines(capsys)[-2:] == ["driving", "stopped: the goal is reached"]


def test_a_dry_run_publishes_no_commands_and_prints_them(robot, capsys):
    it = robot(dry_run=True)
    it.scan(6)
    it.clock.sleep(1.0)
    it.run(0.1)
    it.driver_node.close()
    assert it.commands() == []
    assert "dry run: 0.40 m/s ahead, 0.20 rad/s to the left" in lines(capsys)


@pytest.mark.parametrize("terminal", ["open", "closed"])
def test_at_the_end_it_stops_the_wheels_several_times(terminal, robot, monkeypatch, capsys):
    it = robot()
    it.scan(6)
    it.commands()
    if terminal == "closed":
        monkeypatch.setattr("builtins.print", Mock(side_effect=OSError(errno.EIO, "Input/output error")))
    it.driver_node.close()
    assert it.commands() == [STILL] * 9
    assert terminal == "closed" or lines(capsys)[-1].startswith("6 scans, median time from scan to command: ")


@pytest.mark.parametrize("sign", SIGNALS)
def test_each_signal_that_ends_the_node_stops_the_wheels(sign, node, clock, scripted_policy, monkeypatch):
    policy, handlers = scripted_policy(), {}
    replaced = {"create_node": node, "load": None, "TrainedPolicy": policy, "WallClock": clock}
    for name, value in {**replaced, "th.set_num_threads": None}.items():
        monkeypatch.setattr(f"tb2rl.deploy.ros.driver_node.{name}", lambda *_, value=value: value)
    monkeypatch.setattr("signal.signal", handlers.__setitem__)

    def drive_then_signal():
        clock.events.clear()
        Robot(node, clock, policy).scan(6)
        handlers[sign]()

    clock.events.append(drive_then_signal)
    run(main.parse(["drive", "zoo:maze-loop-ppo"]))
    commands = node.commands(TOPICS.velocity)
    assert FORWARD in commands
    assert commands[-5:] == [STILL] * 5


def test_an_error_of_the_policy_or_in_a_service_ends_the_node_and_no_thread_of_ros(robot, monkeypatch):
    it = robot()
    it.policy.act = lambda sensed: 1 / 0
    it.scan(6)
    with pytest.raises(ZeroDivisionError):
        it.driver_node.run(threading.Event())
    it = robot(waits=True)
    monkeypatch.setattr(it.driver, "preflight", lambda: 1 / 0)
    assert it.call("start") == "the node ends: division by zero"
    with pytest.raises(ZeroDivisionError):
        it.driver_node.run(threading.Event())


def odometry_message(turn=(0.0, 0.0, 0.0, 1.0), **fields):
    values = {"pose": (1.0, 0.0, 0.0), "twist": STILL, **fields}
    message = Odometry(3 * BILLION + 5, "odom", "base", **values).to_ros(BagMessages(1))
    rotation = message.pose.pose.orientation
    rotation.x, rotation.y, rotation.z, rotation.w = turn
    return message


@pytest.mark.parametrize("wrong", [{"turn": (0.0, 0.0, 0.0, 0.0)}, {"pose": (1e200, 0.0, 0.0)}])
def test_odometry_with_invalid_numbers_is_ignored(wrong, robot, capsys):
    it = robot(goal="goal")
    it.publish("goal", Goal(0, "odom", (4.0, 0.0)))
    it.scan(6)
    assert it.commands()[-1] == FORWARD
    for _ in range(6):
        it.publish("odometry", Odometry.from_ros(odometry_message(**wrong)))
        it.scan(odometry=False)
    assert it.commands()[-1] == STILL
    *_, warning, stopped = lines(capsys)
    assert warning == "warning: odometry is ignored: its orientation is invalid, or a number is not finite or too large"
    assert stopped.startswith("stopped: the last odometry is 0.")


def test_messages_become_values():
    odometry = Odometry.from_ros(odometry_message(twist=(0.3, 0.1)))
    assert odometry == Odometry(3 * BILLION + 5, "odom", "base", (1.0, 0.0, 0.0), (0.3, 0.1))
    for yaw in (-3.1, 0.7):
        rounded = (0.0, 0.0, 1.05 * math.sin(yaw / 2), 1.05 * math.cos(yaw / 2))
        assert Odometry.from_ros(odometry_message(rounded)).pose[2] == pytest.approx(yaw)
    command = Twist(math.nan, 1.0).to_ros(BagMessages(1))
    assert Twist.from_ros(command) == Twist(0.0, 0.0), "a command that is no number stops the base"
    goal = Goal(0, "/odom", (1.0, 2.0)).to_ros(BagMessages(1))
    assert Goal.from_ros(goal) == Goal(0, "odom", (1.0, 2.0))
    plan = Plan.from_ros(SimpleNamespace(header=goal.header, poses=[goal, goal]))
    assert (plan.frame, plan.points.tolist()) == ("odom", [[1.0, 2.0], [1.0, 2.0]])
