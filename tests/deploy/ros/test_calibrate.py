"""`ros calibrate`: on a fake node, and on real graphs of ROS 1 and ROS 2, where it drives the robot of `simulate`."""

import math
import shutil
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core import InputError
from tb2rl.deploy.bags.reading import read_drive
from tb2rl.deploy.calibrate import run
from tb2rl.deploy.calibration_drive import CalibrationDrive
from tb2rl.deploy.ros.events import BumperEvent
from tb2rl.deploy.ros.messages import BILLION, LaserScan, Odometry
from tb2rl.deploy.ros.topics import TURTLEBOT2
from tb2rl.ros import main

pytest.importorskip("rosbags")
FREE = 1.1  # [m] around the start of the world `loop`, too
LOCKSTEP = ["--topics", "scan=/scan", "--rate", "0", "--lockstep", "60"]


class Robot:
    """A robot that obeys at once; ROS time runs five times faster than its clock, with a scan every 0.1 s."""

    def __init__(self, node, clock, ros=1):
        self.node, self.topics, self.commands = node, TURTLEBOT2[ros], node.topics[TURTLEBOT2[ros].velocity].messages
        self.pose, self.distance, self.age, self.scans, self.events = (0.0, 0.0, 0.0), 3.0, 0.03, 0, {}
        clock.events.append(self.step)

    def step(self):
        if self.node.over:
            return
        v, w = (self.commands[-1].linear, self.commands[-1].angular) if self.commands else (0.0, 0.0)
        x, y, yaw = self.pose
        self.pose = x + 0.1 * v * math.cos(yaw), y + 0.1 * v * math.sin(yaw), yaw + 0.1 * w
        self.scans, stamp = self.scans + 1, round(0.1 * (self.scans + 1) * BILLION)
        if not self.node.sim_time:  # the message of simulated time arrives after the others
            self.node.time = stamp / BILLION + self.age
        self.publish("odometry", Odometry(stamp, "odom", "base", self.pose, (v, w)))
        ranges = np.full(361, self.distance)
        self.publish("scan", LaserScan(stamp, "laser", -1.58, 3.16 / 360, 0.1, 0.1, 30.0, ranges))
        self.events.pop(self.scans, lambda: None)()
        if self.node.sim_time:
            self.node.time = stamp / BILLION

    def publish(self, topic, message):
        self.node.receive[getattr(self.topics, topic)](message)


@pytest.fixture
def handlers(node, clock, workdir, monkeypatch):
    """The handlers of signals; a command joins the fake node."""
    monkeypatch.setattr("tb2rl.deploy.ros.driver_node.WallClock", lambda: clock)
    monkeypatch.setattr("tb2rl.deploy.calibrate.create_node", lambda *_: node)
    handlers = {}
    monkeypatch.setattr("signal.signal", handlers.__setitem__)
    return handlers


def calibrate(*arguments):
    run(main.parse(["calibrate", *arguments]))


@pytest.mark.parametrize("ros", [1, 2])
def test_it_drives_to_the_end_and_records_everything_with_its_age(ros, node, clock, handlers, monkeypatch, capsys):
    monkeypatch.setattr(CalibrationDrive, "_drive", lambda self: self._line(0.5, 0.5))  # one of its manoeuvres
    robot = Robot(node, clock, ros)
    calibrate("--free", str(FREE), "--ros", str(ros))
    path = {1: Path("drive.bag"), 2: Path("drive")}[ros]
    drive = read_drive(path, {}, scans=True)
    assert len(drive.odometry) == len(drive.scans.times) == robot.scans
    assert np.diff(drive.scans.times) == pytest.approx(0.1)
    assert [drive.odometry[:, 6], drive.scans.ages] == pytest.approx(np.full((2, robot.scans), 0.03), abs=1e-6)
    assert drive.commands[:, 1:].tolist() == [[each.linear, each.angular] for each in robot.commands]
    assert drive.commands[-5:, 1:].tolist() == [[0.0, 0.0]] * 5
    assert drive.topics["cmd_vel"] == TURTLEBOT2[ros].velocity
    assert drive.distance > 0.5
    assert np.hypot(*drive.odometry[:, 1:3].T).max() < FREE
    assert capsys.readouterr().out.endswith(f"Next:\npython -m tb2rl.calibrate {path} -o my_robot.yaml\n")


def test_a_contact_a_signal_an_obstacle_and_a_service_cut_it_short_with_a_readable_bag(node, clock, handlers):
    node.sim_time = True
    reasons = {
        "the bumper was touched": lambda robot: robot.publish("bumper", BumperEvent(1, True)),
        "a signal ended the program": lambda robot: handlers[signal.SIGINT](signal.SIGINT, None),
        "the laser sees an obstacle": lambda robot: setattr(robot, "distance", 0.5),
        "told to stop": lambda robot: node.services["~/stop"](),
    }
    for reason, cause in reasons.items():
        clock.events.clear()
        node.over, node.time = False, 0.0
        robot = Robot(node, clock)
        robot.commands.clear()
        robot.events[50] = lambda cause=cause, robot=robot: cause(robot)
        with pytest.raises(InputError, match=rf"cut short: {reason}.*; short\.bag has the \d+ messages until then"):
            calibrate("--free", str(FREE), "--out", "short.bag")
        drive = read_drive(Path("short.bag"), {}, scans=True)
        assert 50 <= len(drive.scans.times) == robot.scans < 70
        assert set(drive.scans.ages) == {0.0}, "in simulated time, too, a message cannot arrive before its stamp"
        assert drive.commands[-1, 1:].tolist() == [0.0, 0.0]
        assert drive.contacts == (1 if "bumper" in reason else None)


def test_it_asks_for_the_free_space_and_does_not_drive_without_an_answer(node, clock, handlers, monkeypatch, refused):
    refused(main, "calibrate", ["room", "--free"])  # no terminal
    refused(main, "calibrate --free 0.5", ["at least 0.9", "0.5"])
    refused(main, "calibrate --free nan", ["--free"])
    refused(main, "calibrate --free 1.5 --robot turtle", ["unknown robot", "turtlebot2"])
    refused(main, "calibrate --free 1.5 --out drive.mcap", ["NAME.bag"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: "yes")
    refused(main, "calibrate", ["number of metres"])
    assert not node.receive, "it has not joined ROS"
    monkeypatch.setattr("builtins.input", lambda question: "2.0")
    Robot(node, clock).events[10] = lambda: handlers[signal.SIGTERM](signal.SIGTERM, None)
    with pytest.raises(InputError, match="cut short"):
        calibrate()


def test_a_dry_run_writes_no_bag_and_an_error_of_the_bag_ends_the_drive(node, clock, handlers, workdir, monkeypatch):
    Path("drive.bag").write_text("older")
    robot = Robot(node, clock)
    robot.events[50] = lambda: handlers[signal.SIGINT](signal.SIGINT, None)
    with pytest.raises(InputError, match=r"cut short: a signal ended the program$"):
        calibrate("--free", str(FREE), "--dry-run")
    assert (robot.commands, Path("drive.bag").read_text()) == ([], "older")

    def fail(*_):
        raise OSError(28, "No space left on device")

    node.over = False
    clock.events.clear()
    Robot(node, clock).events[50] = lambda: monkeypatch.setattr("tb2rl.deploy.bags.writing.BagWriter.write", fail)
    with pytest.raises(InputError, match=r"cannot write drive.bag: No space left"):
        calibrate("--free", str(FREE))
    assert [path.name for path in workdir.iterdir()] == ["drive.bag"]


@pytest.mark.slow
@pytest.mark.flaky(reruns=3)  # the robot may reach an obstacle before the button is pressed
def test_in_lockstep_it_drives_to_its_end_or_something_cuts_it_short(graph):
    suffix = ".bag" if graph.version == 1 else ""
    for pattern in ("short*", "narrow*", "drive*"):  # of an earlier attempt, whose folder this is
        for path in graph.folder.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def calibrate(name, free=FREE):
        sim_time = ["--ros-args", "-p", "use_sim_time:=true"] if graph.version == 2 else []
        return graph.start("calibrate", "--out", f"{name}{suffix}", "--free", str(free), *sim_time)

    with graph.start("simulate", *LOCKSTEP) as simulated, graph.probe() as probe:
        trigger = partial(probe.call, kind="std_srvs/Trigger")
        for number, (cause, reason) in enumerate(
            (
                (lambda cut: cut.send_signal(signal.SIGINT), "a signal ended the program"),
                (lambda cut: trigger("/tb2rl_driver/stop"), "told to stop"),
                (lambda cut: trigger("/tb2rl_simulation/button"), "a button was pressed"),
            )
        ):
            with calibrate("short" if number == 0 else f"short{number}") as cut:
                while "driving" not in cut.lines:
                    cut.wait_for_line(len(cut.lines))
                cause(cut)
                assert cut.wait() == 2
                assert cut.errors[-1].startswith(f"error: the drive was cut short: {reason}")
        trigger("/tb2rl_simulation/button")
        with calibrate("narrow", free=2.0) as cut:
            assert cut.wait() == 2
            assert "cut short: the laser sees an obstacle" in cut.errors[-1]
        with calibrate("drive") as driven:
            assert driven.wait() == 0, driven.errors
        assert simulated.stop() == 0
    assert simulated.lines[-1] == "scans that no command answered: 0"
    assert driven.lines[-1] == f"python -m tb2rl.calibrate drive{suffix} -o my_robot.yaml"
    short, drive = (read_drive(graph.folder / f"{name}{suffix}", {}, scans=True) for name in ("short", "drive"))
    assert 5 < len(short.scans.times) < len(drive.scans.times)
    assert 100.0 < drive.seconds < 200.0
    assert drive.distance > 5.0
    for stamps in (drive.scans.times, drive.odometry[:, 0] - drive.odometry[:, 6]):
        steps = np.diff(stamps)
        assert steps[steps > 1e-6] == pytest.approx(0.1), "no message is missing"
    assert len(drive.commands) >= len(drive.scans.times)
