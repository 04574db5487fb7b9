"""A filter of the user's own, as one file, acts wherever commands pass: environments, evaluations and drivers."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from tb2rl import evaluate, make_env, train
from tb2rl.commands.export import export_folder
from tb2rl.core.errors import InputError
from tb2rl.deploy import Driver, Scan, TrainedPolicy
from tb2rl.deploy.portable.driver import DRIVING
from tb2rl.deploy.portable.policy import ExportedPolicy
from tb2rl.envs.filters import Filter, SpeedLimits
from tb2rl.envs.scene import make_scene
from tb2rl.runs.loading import config_of
from tb2rl.tasks.wander import Wander


class SlowStart(Filter):
    """Halves the first two commands of an episode."""

    def reset(self, num_envs):
        self.steps = np.zeros(num_envs, int)

    def reset_at(self, indices):
        self.steps[indices] = 0

    def __call__(self, commands, robot_state):
        self.steps += 1
        return np.where(self.steps[:, None] <= 2, 0.5 * commands, commands)

    def state(self):
        return {"steps": self.steps.copy()}

    def restore(self, state):
        self.steps = state["steps"].copy()


FILTER = '''
import numpy as np

from tb2rl.envs.filters import Filter


class Crawl(Filter):
    """Scales the speed down, the more the nearer the nearest obstacle is."""

    def __init__(self, factor: float = 0.5):
        self.factor = factor

    def __call__(self, commands, robot_state):
        near = np.minimum(np.min(robot_state.ranges, axis=1, keepdims=True), 1.0)
        return commands * np.hstack([self.factor * near, np.ones_like(near)])
'''


@pytest.fixture
def crawl(tmp_path, monkeypatch):
    """The setting `task.filters` with a filter that a file defines."""
    (tmp_path / "crawling.py").write_text(FILTER)
    monkeypatch.syspath_prepend(tmp_path)
    yield [{"crawling:Crawl": {"factor": 0.5}}]
    sys.modules.pop("crawling", None)


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_a_filter_slows_one_environment_and_many(crawl, simulation, make, drive, start_vec_env):
    """The wheels accelerate, so that the speed is measured in the last of some steps."""
    speeds = []
    for filters in ((), tuple(crawl)):
        env = make("maze", simulation=simulation, filters=filters, start="fixed")
        env.reset(seed=0)
        drive(env, [0] * 5)
        many, _ = start_vec_env(Wander(filters=filters, start="fixed"), num_envs=2, simulation=simulation)
        for _ in range(5):
            many.step(np.zeros(2, dtype=int))
        speeds.append(env.robot_state.twist[0, 0])
        np.testing.assert_allclose(many.loop.robot_state.twist[:, 0], speeds[-1], atol=1e-6)
        many.close()
    assert speeds[1] < 0.6 * speeds[0]


def test_the_evaluation_of_a_policy_and_its_drivers_have_the_filter(crawl, tmp_path):
    settings = {"task.filters": crawl, "train.simulation": "kinematic"}
    policy = train("qlearn", "maze", settings=settings, folder=tmp_path / "run", total_timesteps=64, eval_freq=0)
    fastest = config_of(policy).scene.actions.max_speed
    assert evaluate(policy, episodes=2, steps=20, simulation="kinematic").summary()["mean_speed"] <= 0.5 * fastest
    export_folder(tmp_path / "run", tmp_path / "exported")
    for driver in (Driver(TrainedPolicy(policy)), Driver(ExportedPolicy(tmp_path / "exported"))):
        driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 10.0)
        driver.see_scan(Scan(np.full(37, 0.5), -np.pi / 2, np.pi / 36, 0.1, 30.0), 10.0)
        driver.start()
        command = driver.command(10.0)
        assert command.why == DRIVING
        assert command.v <= 0.5 * 0.5 * fastest  # half, times the half metre that is free
        assert command.v or command.w


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        (["slow"], "unknown filter 'slow'"),
        ([{"speed_limits": {"sped": 1.0}}], "did you mean 'speed'"),
        ([{"speed_limits": {"speed": 0.0}}], "task.filters.SpeedLimits"),
        (["tb2rl.tasks.wander:Wander"], "is not a class derived from"),
    ],
)
def test_a_wrong_filter_is_named(filters, message):
    with pytest.raises(InputError, match=message):
        make_env("maze", filters=filters)


def test_each_environment_has_a_filter_of_its_own_that_restarts_with_its_episode(start_vec_env):
    scene = make_scene(Wander(start="fixed", episode_steps=3), "raw")
    scene = replace(scene, filters=(SlowStart(), SpeedLimits(speed=0.4)))
    (env, _), (other, _) = (start_vec_env(scene, num_envs=2) for _ in range(2))
    speeds = []
    for step in range(5):
        env.step(np.zeros(2, int))
        if step:
            other.step(np.zeros(2, int))
            np.testing.assert_array_equal(env.loop.robot_state.command, other.loop.robot_state.command)
        else:
            other.loop.restore(env.loop.state())
        speeds.append(env.loop.robot_state.command[:, 0].max())
    assert speeds == [0.25, 0.25, 0.0, 0.25, 0.25]  # the third step ends the episode, and the next begins at rest


def test_filters_come_before_the_latency_of_commands(make):
    limits = [{"speed_limits": {"speed": 0.1}}, {"speed_limits": {"speed": 0.2}}]
    env = make("maze", simulation="kinematic", start="fixed", filters=limits, variation={"latency": 1})
    env.reset(seed=0)
    commands = []
    for action in (0, 1, 1):
        env.step(action)
        commands.append(env.robot_state.command[0].tolist())
    assert commands == [[0.0, 0.0], [0.1, 0.0], [0.05, 1.0]]
