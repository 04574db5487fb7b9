"""Environments of a robot with ROS: on a fake node, with a robot that executes its commands."""

import math
from contextlib import ExitStack, closing
from copy import deepcopy

import av
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.deploy import Mounting, SpeedLimits
from tb2rl.deploy.ros.events import EVENTS
from tb2rl.deploy.ros.messages import BILLION, LaserScan, Odometry
from tb2rl.deploy.ros.remote import PROMPT
from tb2rl.deploy.ros.robot import RosRobot, adapt_scene
from tb2rl.deploy.ros.topics import TURTLEBOT2
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.viz.film import FilmOptions, film

TOPICS = TURTLEBOT2[1]
FORWARD, LEFT, RIGHT = range(3)  # of task maze
STILL = (0.0, 0.0)


class Rover:
    """A robot whose time is that of the fake wall clock; or, in lockstep, waits for an answer to each scan."""

    def __init__(self, node, clock):
        self.node, self.clock, self.pose, self.ranges = node, clock, (3.0, 4.0, 1.2), np.full(361, 5.0)
        self.period = 0.1  # [s] from scan to scan
        self.has_scans, self.has_odometry, self.age, self.lockstep = True, True, 0.0, False
        self._answered, self._due = 0, 0.0
        clock.events.append(self._pass_time)

    @property
    def commands(self):
        return self.node.commands(TOPICS.velocity)

    def _pass_time(self):
        if self.lockstep:
            if len(self.commands) > self._answered:
                self._answered = len(self.commands)
                self.node.time = round(self.node.time + self.period, 6)
                self._tick()
            return
        self.node.time = self.clock.time
        if self.clock.time >= self._due:
            self._due = self.clock.time + self.period - 1e-6
            self._tick()

    def _tick(self):
        (x, y, yaw), (v, w) = self.pose, (self.commands or [STILL])[-1]
        x, y = x + v * self.period * math.cos(yaw), y + v * self.period * math.sin(yaw)
        self.pose = x, y, yaw + w * self.period
        stamp = round((self.node.time - self.age) * BILLION)
        if self.has_odometry and TOPICS.odometry in self.node.receive:
            self.node.receive[TOPICS.odometry](Odometry(stamp, "odom", "base", self.pose, (v, w)))
        if self.has_scans and TOPICS.scan in self.node.receive:
            scan = LaserScan(stamp, "laser", -math.pi / 2, math.pi / 360, self.period, 0.1, 30.0, self.ranges)
            self.node.receive[TOPICS.scan](scan)


@pytest.fixture
def rover(node, clock, monkeypatch):
    """A `Rover` on the node that the next environment joins."""
    monkeypatch.setattr("tb2rl.deploy.ros.robot.create_node", lambda *arguments: node)
    monkeypatch.setattr("tb2rl.deploy.ros.remote.WallClock", lambda: clock)
    return Rover(node, clock)


@pytest.fixture
def make(rover):
    """A function that makes the environment of task maze on it."""
    with ExitStack() as stack:
        yield lambda robot="ros", **settings: stack.enter_context(
            closing(tb2rl.make_env("maze", simulation=robot, **settings))
        )


@pytest.fixture
def env(make):
    env = make()
    env.reset()
    return env


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_episode_counts_from_its_start_and_steps_last_as_the_task_says(lockstep, node, rover, make):
    node.sim_time = rover.lockstep = lockstep
    env = make()
    observation, info = env.reset()
    assert (info["pose"].tolist(), observation.tolist()) == ([0.0, 0.0, 0.0], [3] * 7)
    for _ in range(4):
        *_, info = env.step(FORWARD)
    assert info["pose"] == pytest.approx([4 * 0.2 * 0.5, 0.0, 0.0], abs=0.06)
    assert info["min_range"] == pytest.approx(5.0)
    before = info["pose"][2]
    for _ in range(5):
        *_, info = env.step(LEFT)
    assert info["pose"][2] - before == pytest.approx(1.0, abs=0.11)


def test_steps_have_the_right_mean_duration_however_rare_scans_are(env, rover):
    rover.period = 0.15
    began, (x, y, _) = rover.node.time, rover.pose
    for _ in range(30):
        env.step(FORWARD)
    assert rover.node.time - began == pytest.approx(30 * 0.2, abs=0.35)
    assert math.hypot(rover.pose[0] - x, rover.pose[1] - y) == pytest.approx(30 * 0.2 * 0.5, abs=0.2)


@pytest.mark.parametrize("name", EVENTS)
def test_an_event_of_the_base_stops_the_wheels_and_is_a_contact_in_the_robot_state(name, env, rover):
    event_type, receive = EVENTS[name], rover.node.receive[getattr(TOPICS, name)]
    env.step(FORWARD)
    assert rover.commands[-1][0] > 0.0
    receive(event_type(1, True))
    assert rover.commands[-1] == STILL
    assert env.step(FORWARD)[4]["bumped"], "while it lasts"
    receive(event_type(0, True))
    receive(event_type(1, False))
    env.step(LEFT)
    assert env.step(LEFT)[4]["bumped"], "the other part still reports it"
    receive(event_type(0, False))
    assert not env.step(LEFT)[4]["bumped"]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"has_scans": False}, "no scan arrives on /scan$"),
        ({"has_odometry": False}, "no odometry arrives on /odom$"),
        ({"ranges": np.full(361, np.nan)}, "the scan has no valid reading;"),
        ({"age": 0.7}, "the last scan is 0.7 s old"),
    ],
)
def test_without_usable_sensors_it_stands_and_says_why(fault, message, env, rover):
    env.step(FORWARD)
    vars(rover).update(fault)
    began = rover.clock.time
    with pytest.raises(InputError, match=f"^the robot was stopped: .*{message}"):
        [env.step(FORWARD) for _ in range(9)]
    assert rover.clock.time - began < 1.0
    assert rover.commands[-1] == STILL


def test_a_reset_without_sensors_fails_after_ten_seconds(make, rover):
    rover.has_scans = False
    with pytest.raises(InputError, match="no scan arrives on /scan"):
        make().reset()
    assert rover.clock.time == pytest.approx(10.0, abs=0.1)


def test_an_abandoned_robot_stops_drives_on_at_the_next_step_and_stops_when_closed(env, rover):
    env.step(FORWARD)
    assert rover.commands[-1] == (0.5, 0.0)
    rover.clock.sleep(0.8)
    assert rover.commands[-1] == STILL
    env.step(FORWARD)
    assert rover.commands[-1] == (0.5, 0.0)
    env.close()
    assert rover.commands[-5:] == [STILL] * 5
    assert rover.node.over
    env.close()
    with pytest.raises(InputError, match="make another"):
        env.reset()


def test_gazebo_resets_the_robot_or_else_the_user_at_a_terminal_is_asked(env, rover, monkeypatch):
    asked, called = [], []
    monkeypatch.setattr("builtins.input", asked.append)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    env.reset()
    assert asked == [PROMPT]
    rover.node.services["/gazebo/reset_world"] = lambda: called.append(rover.pose)
    env.step(FORWARD)
    assert env.reset()[1]["pose"].tolist() == [0.0, 0.0, 0.0]
    assert (len(called), len(asked)) == (1, 1)


def test_there_are_no_copies_no_states_and_no_images(env):
    for forbidden in (lambda: deepcopy(env), env.state, env.camera):
        with pytest.raises(InputError, match="no copies, saved states or camera images"):
            forbidden()


def test_mounting_and_limits_are_those_of_the_robot(make, rover):
    with pytest.raises(InputError, match="the scan covers 180 degrees"):
        make(RosRobot(mounting=Mounting(yaw=math.pi / 2))).reset()
    observe = ["laser", {"last_action": {"count": 2}}]
    env = make(RosRobot(limits=SpeedLimits(speed=0.25)), observation="raw", observe=observe)
    env.reset()
    for _ in range(2):
        observation, *_ = env.step(FORWARD)
    assert max(rover.commands) == (0.25, 0.0)
    assert env.robot_state.command.tolist() == [[0.25, 0.0]]
    assert observation[-4:] == pytest.approx([0.25 / 0.65, 0.0] * 2)


def wallfollower():
    config = resolve("wallfollower", "maze")
    return make_baseline(config), config


def test_an_evaluation_is_by_odometry_and_laser(rover):
    evaluation = tb2rl.evaluate(*wallfollower(), simulation="ros", episodes=2, steps=4)
    for episode in evaluation.episodes:
        assert episode.length == 4
        assert episode.path[0].tolist() == [0.0, 0.0]
        assert episode.min_clearance == pytest.approx(5.0 - evaluation.scene.robot.radius, abs=1e-3)
    summary = evaluation.summary()
    assert summary["simulation"] == "ros"
    assert 0.0 < summary["mean_speed"] < 0.6
    assert rover.node.over


@pytest.mark.slow
def test_a_film_holds_all_frames(rover, tmp_path):
    policy, config = wallfollower()
    path = film(policy, tmp_path / "drive.mp4", config, options=FilmOptions(steps=10, simulation=RosRobot()))
    with av.open(str(path)) as file:
        assert sum(1 for _ in file.decode(video=0)) > 2.0 * 15


def scene(task, **settings):
    return make_scene(make_task(task, settings), "raw")


def test_worlds_have_no_walls_and_nothing_varies_goals_are_the_users_and_planning_policies_keep_their_map():
    robot = adapt_scene(scene("maze", variation="strong", dynamic_obstacles={"people": 2}))
    assert len(robot.world.boxes) == len(robot.world.posts) == 0
    assert (robot.task.start, robot.task.variation, robot.spec.has_dynamic_obstacles) == ("fixed", "none", False)
    assert adapt_scene(scene("navigate", world="loop"), (2.0, -1.0)).goal_in(0) == (2.0, -1.0)
    plan = scene("navigate", world="wall", guide="plan")
    assert adapt_scene(plan, tuple(plan.world.start[:2])).world.name == "wall"
    online = scene("navigate", world="loop", guide="plan", map="online")
    assert adapt_scene(online, (2.0, 0.0)).world.name == "floor"
    several = scene("navigate", world=["loop", "wall"], guide="plan")
    for refused, goal, message in (
        (scene("navigate", world="loop"), None, "such as --goal"),
        (several, None, "set task.world"),
        (scene("maze"), (1.0, 0.0), "such as navigate"),
    ):
        with pytest.raises(InputError, match=message):
            adapt_scene(refused, goal)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (RosRobot(3), "ros is 3; give 1 or 2"),
        (RosRobot(topics={"lasers": "/scan"}), "unknown key of topics 'lasers'"),
    ],
)
def test_settings_that_do_not_fit_are_refused(robot, message):
    with pytest.raises(InputError, match=message):
        tb2rl.make_env("maze", simulation=robot)
