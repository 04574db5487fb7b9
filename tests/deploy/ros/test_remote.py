"""A robot with ROS as an environment: on a graph of plain Python, with a robot that drives as it is told."""

from __future__ import annotations

import math
import threading
import time

import av
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.deploy import Limits, Mounting
from tb2rl.deploy.ros.messages import BILLION, Bump, Odometry, Scan
from tb2rl.deploy.ros.remote import PUT_BACK
from tb2rl.deploy.ros.robot import RosRobot, robot_scene
from tb2rl.deploy.ros.topics import TURTLEBOT2
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.viz.film import film

TOPICS = TURTLEBOT2[1]
FORWARD, LEFT, RIGHT = range(3)  # of task maze
ANSWER = 1.0  # [s] of wall-clock time
BEGAN = (3.0, 4.0, 1.2)  # of its odometry


class Rover:
    """A robot that waits for an answer to each scan, but not for long; its clock is that of the graph."""

    def __init__(self, graph):
        self.graph, self.pose, self.ranges = graph, BEGAN, np.full(361, 5.0)
        self.tick = 0.1  # [s] from scan to scan
        self.twist, self.sees, self.counts, self.behind, self.over = (0.0, 0.0), True, True, 0.0, False
        self.patience, self.waits = ANSWER, False
        self._thread = threading.Thread(target=self._drive, daemon=True)

    def start(self):
        self._thread.start()

    def stop(self):
        self.over = True
        self._thread.join()

    @property
    def told(self):
        return [(each.linear, each.angular) for each in self.graph.ends[TOPICS.velocity].said]

    def _drive(self):
        while not self.over:
            told = len(self.told)
            self._tick()
            until = time.monotonic() + self.patience
            while len(self.told) == told and time.monotonic() < until and not self.over:
                self.waits = True
                time.sleep(0.0005)
            self.waits = False

    def _tick(self):
        (x, y, yaw), (v, w) = self.pose, (self.told or [(0.0, 0.0)])[-1]
        self.pose, self.twist = (
            (x + v * self.tick * math.cos(yaw), y + v * self.tick * math.sin(yaw), yaw + w * self.tick),
            (v, w),
        )
        self.graph.time = round(self.graph.time + self.tick, 6)
        stamp = round((self.graph.time - self.behind) * BILLION)
        if self.counts:
            self.graph.heard[TOPICS.odometry](Odometry(stamp, "odom", "base", self.pose, self.twist))
        if self.sees:
            scan = Scan(stamp, "laser", -math.pi / 2, math.pi / 360, self.tick, 0.1, 30.0, self.ranges)
            self.graph.heard[TOPICS.scan](scan)


@pytest.fixture
def rover(fake_graph, monkeypatch):
    """A `Rover`, which begins with the first environment that a test makes."""
    rover = Rover(fake_graph)

    def join(version, name, arguments=()):
        fake_graph.joined = (version, name, tuple(arguments))
        return fake_graph

    listen = fake_graph.listen

    def listen_and_start(topic, kind, heard):
        end = listen(topic, kind, heard)
        if kind is Bump:  # the last that it listens to
            rover.start()
        return end

    monkeypatch.setattr("tb2rl.deploy.ros.robot.join", join)
    monkeypatch.setattr(fake_graph, "listen", listen_and_start)
    yield rover
    rover.stop()


@pytest.fixture
def in_turns(rover, monkeypatch):
    """Neither it nor the environment does anything before the other has answered, however busy the machine is."""
    rover.patience = 60.0
    monkeypatch.setattr("tb2rl.deploy.ros.remote._AGAIN", 60.0)


@pytest.fixture
def env(rover):
    """The environment of task maze on it."""
    env = tb2rl.make_env("maze", simulation="ros")
    yield env
    env.close()


def drive_on(env):
    for _ in range(9):
        env.step(FORWARD)


def wait_for(what):
    until = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < until
        time.sleep(0.005)


def test_an_episode_counts_from_where_it_began_and_lasts_as_the_task_says(in_turns, env, rover):
    observation, info = env.reset()
    assert info["pose"].tolist() == [0.0, 0.0, 0.0]
    assert observation.tolist() == [3] * 7
    wait_for(lambda: rover.waits)  # the first step begins when it is told, not with a scan before
    for _ in range(4):
        *_, info = env.step(FORWARD)
    assert info["pose"] == pytest.approx([4 * 0.2 * 0.5, 0.0, 0.0], abs=0.02)
    assert info["distance"] == pytest.approx(0.4, abs=0.02)
    assert info["min_range"] == pytest.approx(5.0)
    for _ in range(5):
        *_, info = env.step(LEFT)
    assert info["pose"][2] == pytest.approx(1.0, abs=0.02)
    assert rover.graph.joined == (1, "tb2rl_environment", ())


def test_what_the_laser_sees_is_what_the_policy_was_trained_with(env, rover):
    rover.ranges = np.linspace(0.8, 3.0, 361)
    observation, _ = env.reset()
    assert observation.tolist() == [1, 2, 2, 3, 3, 3, 3], "right to left"
    rover.ranges = np.full(361, 0.3)
    env.step(FORWARD)
    observation, _, terminated, _, info = env.step(FORWARD)
    assert (observation.tolist(), terminated, info["ended"]) == ([0] * 7, True, "collision")


def test_steps_last_on_average_what_they_should_however_seldom_scans_come(in_turns, env, rover):
    rover.tick = 0.15
    env.reset()
    began, (x, y, _) = rover.graph.time, rover.pose
    for _ in range(30):
        env.step(FORWARD)
    assert rover.graph.time - began == pytest.approx(30 * 0.2, abs=0.35)
    assert math.hypot(rover.pose[0] - x, rover.pose[1] - y) == pytest.approx(30 * 0.2 * 0.5, abs=0.2)


def test_a_touch_stops_the_wheels_and_is_told(env, rover):
    env.reset()
    env.step(FORWARD)
    wait_for(lambda: rover.told[-1][0] > 0.0)
    rover.graph.heard[TOPICS.bumper](Bump(1, True))
    assert rover.told[-1] == (0.0, 0.0)
    assert env.step(FORWARD)[4]["bumped"], "while it is pressed"
    rover.graph.heard[TOPICS.bumper](Bump(1, False))
    assert not env.step(LEFT)[4]["bumped"]


@pytest.mark.parametrize("sense", ["sees", "counts"])
def test_who_senses_nothing_stands_and_says_so(sense, env, rover):
    env.reset()
    env.step(FORWARD)
    setattr(rover, sense, False)
    missing = {"sees": "no scan on /scan", "counts": "no odometry on /odom"}[sense]
    with pytest.raises(InputError, match=f"^the robot stands: {missing}$"):
        drive_on(env)
    assert rover.told[-1] == (0.0, 0.0)


def test_scans_that_show_too_little_are_none(env, rover):
    env.reset()
    rover.ranges = np.full(361, np.nan)
    with pytest.raises(InputError, match="no valid reading at all"):
        drive_on(env)


@pytest.mark.parametrize(
    ("behind", "said"), [(0.7, "the last scan is 0.7 s old"), (1.8e9, "the time of another clock")]
)
def test_old_scans_and_those_of_another_clock_are_none(behind, said, env, rover):
    env.reset()
    rover.behind = behind
    with pytest.raises(InputError, match=said):
        drive_on(env)


def test_a_robot_that_does_not_answer_is_not_waited_for(env, rover, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.remote._PATIENCE", 0.3)
    rover.sees = False
    with pytest.raises(InputError, match="no scan on /scan"):
        env.reset()


def test_who_is_left_alone_stands(env, rover):
    env.reset()
    env.step(FORWARD)
    assert rover.told[-1] == (0.5, 0.0)
    wait_for(lambda: rover.told[-1] == (0.0, 0.0))
    env.step(FORWARD)
    assert rover.told[-1] == (0.5, 0.0), "and goes on when it is told to"


def test_the_wheels_are_told_to_stand_at_the_end(env, rover):
    env.reset()
    env.step(FORWARD)
    env.close()
    assert rover.told[-5:] == [(0.0, 0.0)] * 5
    assert rover.graph.over
    env.close()
    with pytest.raises(InputError, match="make another"):
        env.reset()


def test_gazebo_puts_it_back(env, rover):
    called = []
    rover.graph.services["/gazebo/reset_world"] = lambda: called.append(rover.pose)
    env.reset()
    for _ in range(3):
        env.step(FORWARD)
    assert env.reset()[1]["pose"].tolist() == [0.0, 0.0, 0.0]
    assert len(called) == 2


def test_without_gazebo_who_sits_at_a_terminal_is_asked(env, rover, monkeypatch):
    asked = []
    monkeypatch.setattr("builtins.input", asked.append)
    env.reset()
    assert asked == []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    env.reset()
    assert asked == [PUT_BACK]


def test_no_copies_no_states_no_images(env, rover):
    from copy import deepcopy

    env.reset()
    for forbidden in (lambda: deepcopy(env), env.state, lambda: env.robot_state.render_camera(8, 8), env.camera):
        with pytest.raises(InputError):
            forbidden()


def test_a_scanner_that_looks_aside_does_not_see_enough(rover, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.remote._PATIENCE", 0.3)
    env = RosRobot(mounting=Mounting(yaw=math.pi / 2)).env(make_scene(make_task("maze", {}), "discrete"))
    with pytest.raises(InputError, match="the scan covers 180 degrees"):
        env.reset()
    env.close()


def test_it_drives_no_faster_than_its_limits(rover):
    env = RosRobot(limits=Limits(speed=0.25)).env(make_scene(make_task("maze", {}), "discrete"))
    env.reset()
    env.step(FORWARD)
    assert max(rover.told) == (0.25, 0.0)
    assert env.robot_state.command.tolist() == [[0.25, 0.0]]
    env.close()


def test_a_policy_sees_that_its_commands_were_slowed_down(rover):
    task = make_task("maze", {"observe": ["laser", {"last_action": {"count": 2}}]})
    env = RosRobot(limits=Limits(speed=0.25)).env(make_scene(task, "raw"))
    env.reset()
    for _ in range(2):
        observation, *_ = env.step(FORWARD)
    assert observation[-4:] == pytest.approx([0.25 / 0.65, 0.0] * 2)
    env.close()


def wallfollower():
    config = resolve("wallfollower", "maze")
    return make_baseline(config), config


def test_an_evaluation_is_by_odometry_and_laser(rover):
    policy, config = wallfollower()
    evaluation = tb2rl.evaluate(policy, config, simulation="ros", episodes=2, steps=4)
    assert [episode.length for episode in evaluation.episodes] == [4, 4]
    for episode in evaluation.episodes:
        assert episode.path[0].tolist() == [0.0, 0.0]
        assert episode.closest == pytest.approx(5.0 - evaluation.scene.robot.radius, abs=1e-3)
    summary = evaluation.summary()
    assert summary["simulation"] == "ros"
    assert 0.0 < summary["mean_speed"] < 0.6
    assert rover.graph.over


def test_a_film_holds_all_of_the_way(rover, tmp_path):
    policy, config = wallfollower()
    rover.ranges = np.full(361, 2.0)
    path = film(policy, tmp_path / "drive.mp4", config, steps=10, simulation=RosRobot())
    with av.open(str(path)) as file:
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(pictures) > 2.0 * 15


def test_the_floor_of_a_robot_knows_no_walls_and_nothing_varies():
    scene = make_scene(make_task("maze", {"variation": "strong", "dynamic_obstacles": {"people": 2}}), "discrete")
    robot = robot_scene(scene)
    assert len(robot.world.boxes) == len(robot.world.posts) == 0
    assert (robot.task.start, robot.task.variation, robot.spec.has_dynamic_obstacles) == ("fixed", "none", False)


def test_goals_are_where_the_user_says_and_maps_those_of_who_plans():
    goal = make_scene(make_task("navigate", {"world": "loop"}), "raw")
    with pytest.raises(InputError, match="such as --goal"):
        robot_scene(goal)
    assert robot_scene(goal, (2.0, -1.0)).goal == (2.0, -1.0)
    plan = make_scene(make_task("navigate", {"world": "circuit", "guide": "plan"}), "raw")
    assert robot_scene(plan, tuple(plan.world.start[:2])).world.name == "circuit"
    many = make_scene(make_task("navigate", {"world": ["loop", "circuit"], "guide": "plan"}), "raw")
    with pytest.raises(InputError, match="name yours"):
        robot_scene(many)
    seen = make_scene(make_task("navigate", {"world": "loop", "guide": "plan", "map": "online"}), "raw")
    assert robot_scene(seen, (2.0, 0.0)).world.name == "floor"
    with pytest.raises(InputError, match="such as navigate"):
        robot_scene(make_scene(make_task("maze", {}), "discrete"), (1.0, 0.0))


def test_what_does_not_fit_is_said():
    scene = make_scene(make_task("maze", {}), "discrete")
    with pytest.raises(InputError, match="ROS 1 and ROS 2, got 3"):
        RosRobot(3).env(scene)
    with pytest.raises(InputError, match="--ros-args is for --ros 2"):
        RosRobot(arguments=("-p", "use_sim_time:=true")).env(scene)
    with pytest.raises(InputError, match="unknown key of topics 'lasers'"):
        RosRobot(topics={"lasers": "/scan"}).env(scene)
    with pytest.raises(InputError, match=r"simulation takes .*'kinematic', 'ros'"):
        tb2rl.evaluate(*wallfollower(), simulation="gazebo")
