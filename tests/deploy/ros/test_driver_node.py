"""A driver on a graph of plain Python: when it starts, what it tells the wheels, and what it says."""

from __future__ import annotations

import errno
import math
import os
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl.deploy import Driver, Limits, Needs
from tb2rl.deploy.ros.drive import run
from tb2rl.deploy.ros.messages import BILLION, Bump, Goal, Odometry, Plan, Scan, Velocity
from tb2rl.deploy.ros.pilot import Pilot
from tb2rl.deploy.ros.topics import TURTLEBOT2
from tb2rl.ros import parse

TOPICS = TURTLEBOT2[1]
FORWARD = (0.4, 0.2)
ENDINGS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]


class Told:
    """A policy that does as it was told."""

    def __init__(self, **needs):
        self.needs = Needs(np.linspace(-1.5, 1.5, 7), 0.1, 30.0, 0.2, 0.5, 1.0, "turtlebot2", **needs)
        self.speeds, self.sensed = FORWARD, []

    def begin(self):
        pass

    def act(self, sensed):
        self.sensed.append(sensed)
        return self.speeds


class Robot:
    """A pilot on a fake graph, and the robot's side of its topics; time goes on by its scans, ten a second."""

    def __init__(self, graph, waits=False, dry_run=False, limits=None, **needs):
        self.graph, self.policy = graph, Told(**needs)
        driver = Driver(self.policy, limits, dry_run=dry_run)
        self.pilot = Pilot(driver, self.policy.needs, graph, TOPICS, waits, dry_run)

    def scan(self, count=1, ranges=2.0, odometry=True, behind=0.0):
        for _ in range(count):
            self.graph.time = round(self.graph.time + 0.1, 6)
            stamp = round((self.graph.time - behind) * BILLION)
            if odometry:
                self.hear("odometry", Odometry(stamp, "odom", "base", (1.0, 0.0, 0.0), (0.0, 0.0)))
            ranges_ = np.full(361, ranges)
            self.hear("scan", Scan(stamp, "laser", -math.pi / 2, math.pi / 360, 0.1, 0.1, 30.0, ranges_))

    def hear(self, topic, message):
        self.graph.heard[getattr(TOPICS, topic)](message)

    def look(self, seconds=0.0):
        """What its own thread does, once it woke up."""
        self.graph.time += seconds
        with self.pilot._turn:
            self.pilot._look()

    def call(self, service):
        return self.graph.services[f"~/{service}"]()

    def told(self):
        """What the wheels were told since the last time."""
        end = self.graph.ends[TOPICS.velocity]
        said, end.said = [(each.linear, each.angular) for each in end.said], []
        return said


@pytest.fixture
def robot(fake_graph):
    """A function that makes a `Robot`."""
    return lambda **options: Robot(fake_graph, **options)


def lines(capsys):
    return capsys.readouterr().out.splitlines()


def test_it_starts_by_itself_once_scans_came_that_fit_and_answers_each(robot, capsys):
    it = robot()
    it.scan(4)
    assert it.told() == [(0.0, 0.0)] * 4
    it.scan(6)
    assert it.told() == [FORWARD] * 6
    assert len(it.policy.sensed) == 3, "it decides each 0.2 s"
    assert lines(capsys) == ["driving"]


def test_it_is_told_to_start_and_to_stop(robot, capsys):
    it = robot(waits=True)
    it.scan(20)
    assert set(it.told()) == {(0.0, 0.0)}
    assert it.call("start") == ""
    it.scan()
    assert it.told() == [FORWARD]
    assert it.call("stop") == ""
    assert it.told() == [(0.0, 0.0)], "at once"
    it.scan()
    assert it.told() == [(0.0, 0.0)]
    assert lines(capsys) == ["it stands: not started", "driving", "it stands: told to stop"]


def test_what_is_serious_keeps_it_standing_and_is_said_once(robot, capsys):
    it = robot(goal="goal")
    it.scan(8)
    assert set(it.told()) == {(0.0, 0.0)}
    assert "it was told none" in it.call("start")
    it.hear("goal", Goal("odom", (4.0, 0.0)))
    it.scan()
    assert it.told() == [FORWARD]
    assert lines(capsys) == [
        "it stands: the policy drives to a goal, and it was told none",
        "the goal is (4.00, 0.00) in 'odom'",
        "driving",
    ]


def test_it_says_that_nothing_comes_and_what_is_worth_minding(robot, capsys, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.pilot._PATIENCE", -1.0)
    it = robot(limits=Limits(speed=0.2))
    it.look()
    it.scan(5)
    assert it.told()[-1] == (0.2, 0.1)
    no_scan, slowed, driving = lines(capsys)
    assert no_scan == "it stands: no scan has come yet"
    assert slowed.startswith("mind: ")
    assert "slowed to 0.2" in slowed
    assert driving == "driving"


def test_it_stands_while_scans_are_missing_and_goes_on_with_them(robot, capsys):
    it = robot()
    it.scan(6)
    it.told()
    it.look(0.31)
    assert it.told() == [FORWARD], "by the last scan"
    it.look(0.2)
    assert it.told() == [(0.0, 0.0)]
    for _ in range(30):
        it.look(0.05)
    assert len(it.told()) == 8, "then somebody else may drive the robot"
    it.scan(odometry=False)
    assert it.told() == [FORWARD]
    assert lines(capsys)[1:] == ["it stands: the last scan is 0.5 s old", "driving"]


def test_it_does_not_drive_by_old_scans(robot, capsys):
    it = robot()
    it.scan(7, behind=0.7)
    assert set(it.told()) == {(0.0, 0.0)}
    assert lines(capsys) == ["it stands: the last scan is 0.7 s old"]


def test_it_says_what_to_do_where_scans_have_the_time_of_a_simulation(robot, fake_graph, capsys):
    it = robot()
    fake_graph.time = 1.8e9
    it.scan(7, odometry=False, behind=1.8e9)
    mind, _ = lines(capsys)
    assert "use_sim_time" in mind


def test_simulated_time_that_stands_still_stops_the_wheels_and_goes_on(robot, fake_graph, capsys, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.pilot._FROZEN", 0.02)
    monkeypatch.setattr("tb2rl.deploy.ros.pilot._UNANSWERED", 0.02)
    fake_graph.simulated = True
    it = robot()
    it.scan(6)
    it.look()
    it.told()
    time.sleep(0.03)
    it.look()
    assert it.told() == [(0.0, 0.0)]
    it.scan()
    assert it.told() == [FORWARD]
    fake_graph.time = 0.0  # it begins again
    it.scan(2)
    assert it.told() == [FORWARD] * 2
    assert lines(capsys) == ["driving", "it stands: simulated time stands still", "driving"]


def test_in_simulated_time_a_scan_may_come_before_its_clock(robot, fake_graph):
    fake_graph.simulated = True
    it = robot()
    for _ in range(10):
        it.scan(odometry=False, behind=-0.2)
    it.told()
    decided = len(it.policy.sensed)
    it.scan(2, odometry=False, behind=-0.2)
    assert len(it.policy.sensed) == decided + 1
    assert it.told() == [FORWARD] * 2


def test_a_touch_ends_the_drive_until_it_is_started_again(robot):
    it = robot()
    it.scan(6)
    it.told()
    it.hear("bumper", Bump(1, True))
    it.hear("bumper", Bump(1, False))
    it.scan(2)
    assert it.told() == [(0.0, 0.0)] * 3
    it.call("start")
    it.scan()
    assert it.told() == [FORWARD]


def test_goals_and_plans_of_another_frame_are_refused_and_early_ones_wait_for_odometry(robot, capsys):
    it = robot(goal="goal")
    it.hear("goal", Goal("map", (4.0, 0.0)))
    it.hear("goal", Goal("map", (5.0, 0.0)))
    it.scan()
    assert lines(capsys) == ["this goal is refused: it is in the frame 'map', and the odometry in 'odom'"]
    it.hear("goal", Goal("odom", (math.nan, 0.0)))
    assert lines(capsys) == ["this goal is refused: it is no place"]
    it = robot(goal="plan")
    it.scan()
    it.hear("plan", Plan("odom", np.empty((0, 2))))
    it.hear("plan", Plan("map", np.zeros((2, 2))))
    assert len(lines(capsys)) == 2


def test_it_follows_a_plan_to_its_end(robot, capsys):
    it = robot(goal="plan", lookahead=1.0)
    it.scan()
    it.hear("plan", Plan("odom", np.array([[1.0, 0.0], [1.0, 3.0]])))
    it.scan(6)
    assert it.told()[-1] == FORWARD
    assert it.policy.sensed[-1].waypoint == pytest.approx((1.0, 1.0))
    it.hear("plan", Plan("odom", np.array([[1.0, 0.0], [1.0, 0.1]])))
    it.scan()
    assert it.told()[-1] == (0.0, 0.0)
    assert lines(capsys)[-1] == "it stands: the goal is reached"


def test_a_dry_run_tells_the_wheels_nothing_and_says_what_it_would_drive(robot, capsys, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.pilot._EACH", 0.0)
    it = robot(dry_run=True)
    it.scan(6)
    it.look()
    it.pilot.close()
    assert it.told() == []
    assert "it would drive 0.40 m/s ahead, 0.20 rad/s to the left" in lines(capsys)


def test_diagnostics_say_how_it_is(robot, fake_graph, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.pilot._EACH", -1.0)
    it = robot(goal="goal")
    it.scan(6)
    it.look()
    it.hear("goal", Goal("odom", (4.0, 0.0)))
    it.scan()
    it.look()
    lost, fine = fake_graph.ends["/diagnostics"].said
    assert (lost.level, lost.sentence) == ("ERROR", "not started")
    assert lost.values["finding 1"] == "the policy drives to a goal, and it was told none"
    assert (fine.level, fine.sentence, fine.values["v [m/s]"]) == ("OK", "driving", "0.400")


def test_at_the_end_the_wheels_are_told_to_stand_several_times(robot, capsys):
    it = robot()
    it.scan(6)
    it.told()
    ending = threading.Event()
    ending.set()
    it.pilot.run(ending)
    it.pilot.close()
    assert len(it.told()) >= 5
    assert lines(capsys)[-1].startswith("6 scans, from scan to command: ")


def test_at_the_end_the_wheels_are_told_to_stand_although_the_terminal_is_closed(robot, monkeypatch):
    it = robot()
    it.scan(6)
    it.told()

    def write_nowhere(line):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("tb2rl.deploy.ros.pilot._tell", write_nowhere)
    it.pilot.close()
    assert it.told() == [(0.0, 0.0)] * 9


@pytest.fixture
def no_signal_kills():
    """Signals that nobody handles end no test; afterwards all is as before."""
    before = {sign: signal.signal(sign, lambda *_: None) for sign in ENDINGS}
    yield
    for sign, handler in before.items():
        signal.signal(sign, handler)


@pytest.mark.parametrize("sign", ENDINGS)
def test_each_signal_that_ends_the_node_stops_the_wheels(sign, fake_graph, no_signal_kills, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.drive.join", lambda *_: fake_graph)
    monkeypatch.setattr("tb2rl.deploy.ros.drive.load", lambda *_: None)
    monkeypatch.setattr("tb2rl.deploy.ros.drive.TrainedPolicy", lambda _: Told())
    monkeypatch.setattr("tb2rl.deploy.ros.drive.th.set_num_threads", lambda _: None)
    monkeypatch.setattr("tb2rl.deploy.ros.pilot.Pilot.run", drive_and_signal(sign, fake_graph, Pilot.run))
    run(parse(["drive", "zoo:maze-loop-ppo"]))
    said = [(each.linear, each.angular) for each in fake_graph.ends[TOPICS.velocity].said]
    assert FORWARD in said
    assert said[-5:] == [(0.0, 0.0)] * 5


def drive_and_signal(sign, graph, go_on):
    """What `Pilot.run` does after it drove for some scans and a signal came; without an end it would go on for ever."""

    def drive(pilot, ending):
        robot = Robot.__new__(Robot)
        robot.graph = graph
        robot.scan(6)
        os.kill(os.getpid(), sign)
        assert ending.wait(5.0), "the signal was not heeded"
        go_on(pilot, ending)

    return drive


def test_a_policy_that_fails_ends_the_node(robot):
    it = robot()
    it.policy.act = lambda sensed: 1 / 0
    it.scan(6)
    with pytest.raises(ZeroDivisionError):
        it.pilot.run(threading.Event())


def odometry_of(position=(1.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0), twist=(0.0, 0.0)):
    """A message of ROS."""
    new = SimpleNamespace
    header = new(stamp=new(sec=1, nanosec=0), frame_id="odom")
    place = new(x=position[0], y=position[1])
    turn = new(**dict(zip("xyzw", quaternion, strict=True)))
    speeds = new(linear=new(x=twist[0]), angular=new(z=twist[1]))
    pose, twist = new(pose=new(position=place, orientation=turn)), new(twist=speeds)
    return new(header=header, child_frame_id="base", pose=pose, twist=twist)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1e200, 1e200), (0.0, 0.0, 0.0, math.nan)])
def test_an_orientation_that_is_no_rotation_is_no_odometry(quaternion, robot, capsys):
    it = robot(goal="goal")
    it.hear("goal", Goal("odom", (4.0, 0.0)))
    it.scan(6)
    assert it.told()[-1] == FORWARD
    for _ in range(6):
        it.hear("odometry", Odometry.from_ros(odometry_of(quaternion=quaternion)))
        it.scan(odometry=False)
    assert it.told()[-1] == (0.0, 0.0)
    *_, mind, stands = lines(capsys)
    assert mind == "mind: odometry is ignored if its orientation is no rotation or a number is not finite"
    assert stands.startswith("it stands: the last odometry is 0.")


@pytest.mark.parametrize("message", [{"position": (1e200, 0.0)}, {"twist": (0.1, math.inf)}])
def test_odometry_of_impossible_numbers_is_not_usable(message):
    assert not Odometry.from_ros(odometry_of(**message)).is_usable


def test_the_yaw_of_a_quaternion_does_not_depend_on_its_length():
    for yaw in np.linspace(-3.1, 3.1, 9).tolist():
        rounded = (0.0, 0.0, 1.05 * math.sin(yaw / 2), 1.05 * math.cos(yaw / 2))
        assert Odometry.from_ros(odometry_of(quaternion=rounded)).pose[2] == pytest.approx(yaw)


def test_an_error_in_a_service_ends_the_node_and_no_thread_of_ros(robot, monkeypatch):
    it = robot(waits=True)
    monkeypatch.setattr(it.pilot._driver, "preflight", lambda: 1 / 0)
    assert it.call("start") == "the node ends: division by zero"
    with pytest.raises(ZeroDivisionError):
        it.pilot.run(threading.Event())


def test_messages_become_values():
    class Stamp:
        sec, nanosec = 3, 5

    class Header:
        stamp, frame_id = Stamp, "/odom"

    class Vector:
        x, y, z, w = 0.0, 0.0, math.sin(0.25), math.cos(0.25)

    class Pose:
        position, orientation = Vector, Vector

    class Stamped:
        header, pose = Header, Pose

    class Path:
        header, poses = Header, [Stamped, Stamped]

    assert Goal.from_ros(Stamped) == Goal("odom", (0.0, 0.0))
    assert Plan.from_ros(Path).points.shape == (2, 2)
    assert Velocity(0.3, 0.1) != Velocity(0.0, 0.0)

    class Twist:
        linear = angular = Vector

    class Odom:
        header, child_frame_id, pose, twist = Header, "base", Stamped, Stamped

    Stamped.twist = Twist
    odometry = Odometry.from_ros(Odom)
    assert (odometry.stamp, odometry.frame) == (3 * BILLION + 5, "odom")
    assert odometry.pose == pytest.approx((0.0, 0.0, 0.5))
