"""A simulator of a user's own: one file with one class, named "module:Class" wherever a simulator has a name."""

import sys
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

import tb2rl

MODULE = '''
import numpy as np

from tb2rl.simulation import InitialState, RobotState


class Unicycles:
    """Robots that obey at once, in worlds without walls."""

    title, is_physics = "a simulator of one's own", True

    def __init__(self, spec, num_envs):
        self.spec, self.num_envs, self.closed = spec, num_envs, False

    def reset(self, initial_state, rng):
        self.initial_state, self.pose = InitialState(initial_state.table.copy()), initial_state.pose.copy()
        self.commands = np.zeros((self.num_envs, 2))
        return self.robot_state(np.arange(self.num_envs))

    def reset_at(self, indices, initial_state, rng=None):
        self.initial_state.table[indices], self.pose[indices] = initial_state.table, initial_state.pose
        self.commands[indices] = 0.0
        return self.robot_state(np.arange(self.num_envs)), self.robot_state(indices)

    def step(self, commands, duration, inactive=None):
        (v, w), yaw = commands.T, self.pose[:, 2]
        self.commands, self.travelled = commands, np.abs(v) * duration
        self.pose += duration * np.column_stack([np.cos(yaw) * v, np.sin(yaw) * v, w])
        return self.robot_state(np.arange(self.num_envs))

    def state(self):
        return {"pose": self.pose.copy(), "commands": self.commands.copy(), "table": self.initial_state.table.copy()}

    def restore(self, state):
        self.initial_state = InitialState(state["table"].copy())
        self.pose, self.commands = state["pose"].copy(), state["commands"].copy()
        return self.robot_state(np.arange(self.num_envs))

    def close(self):
        self.closed = True

    def robot_state(self, indices):
        pose, twist, none = self.pose[indices].copy(), self.commands[indices], np.zeros(len(indices))
        ranges = np.full((len(indices), len(self.spec.laser.angles)), np.inf)
        initial_state = InitialState(self.initial_state.table[indices])
        return RobotState(pose, twist, pose, twist, ranges, none > 0, twist, none, initial_state, self)
'''


@pytest.fixture
def simulation(tmp_path, monkeypatch):
    """The name of a simulator in a file of its own."""
    (tmp_path / "my_simulator.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_simulator:Unicycles"
    sys.modules.pop("my_simulator", None)


def test_one_environment_runs_in_it(simulation, make, drive):
    env = make("maze", simulation=simulation, episode_steps=5)
    _, before = env.reset(seed=0)
    *_, (_, reward, terminated, truncated, info) = drive(env, [0] * 9)
    x, y, yaw = before["pose"]
    assert info["pose"] == pytest.approx([x + 0.5 * np.cos(yaw), y + 0.5 * np.sin(yaw), yaw])
    assert (reward, terminated, truncated, info["distance"]) == (5.0, False, True, pytest.approx(0.5))
    state = env.state()
    again = make("maze", simulation=simulation, episode_steps=5)
    again.restore(state)
    np.testing.assert_array_equal(again.robot_state.pose, env.robot_state.pose)
    again.close()
    assert again.simulator.closed


def test_many_environments_run_in_it(simulation, glide, start_vec_env):
    env, _ = start_vec_env(glide(episode_steps=3), num_envs=4, simulation=simulation)
    for step in range(4):
        _, rewards, dones, infos = env.step(np.ones((4, 2)))
        assert rewards == pytest.approx([0.5] * 4)
        assert dones.all() == (step == 2)
        if step == 2:
            assert [info["distance"] for info in infos] == pytest.approx([0.3] * 4)
    vector_env = gym.make_vec("tb2rl:TurtleBot2Maze-v0", num_envs=3, simulation=simulation)
    vector_env.reset(seed=0)
    assert vector_env.step(np.zeros(3, int))[4]["distance"] == pytest.approx([0.1] * 3)


def test_a_policy_is_evaluated_in_it(simulation):
    straight = SimpleNamespace(predict=lambda observation, **_: (np.array(0), None))
    conditions = {"episodes": 3, "steps": 10, "workers": 1}
    evaluation = tb2rl.evaluate(straight, task="maze", observation="discrete", simulation=simulation, **conditions)
    assert [episode.distance for episode in evaluation.episodes] == pytest.approx([1.0] * 3)
    assert evaluation.summary()["failure_free_rate"] == 1.0
