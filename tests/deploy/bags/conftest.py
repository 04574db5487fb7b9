"""Recorded drives in the kinematic simulator, and bags of other robots."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tb2rl.deploy.bags.messages import BagMessages
from tb2rl.deploy.bags.recorder import open_bag
from tb2rl.deploy.ros.messages import LaserScan, Odometry
from tb2rl.envs.make import make_env


def _record(path: Path, task: str = "maze", steps: int = 10, **settings: Any) -> SimpleNamespace:
    env = make_env(task, "raw", simulation="kinematic", **settings)
    commands, rewards, info = [], [], {}
    with open_bag(path, env.scene) as recorder:
        env.reset(seed=3)
        env.action_space.seed(3)
        robot_states = [env.robot_state]
        recorder.reset(env.robot_state)
        for _ in range(steps):
            action = env.action_space.sample()
            _, reward, _, _, info = env.step(action)
            assert info["ended"] == ""
            robot_states.append(env.robot_state)
            commands.append(env.scene.actions.commands(env.scene.actions.checked(action))[0])
            rewards.append(float(reward))
            recorder.step(commands[-1], rewards[-1], env.robot_state)
    episode = {"robot_states": robot_states, "commands": np.array(commands), "rewards": rewards}
    return SimpleNamespace(path=path, scene=env.scene, distance=info["distance"], **episode)


class Messages(BagMessages):
    """Makes messages of either ROS from plain values."""

    def __call__(self, kind: str, **fields: Any) -> Any:
        message = self.make_message(kind)
        vars(message).update(fields)
        return message

    def odometry(self, x: float, v: float = 0.0, w: float = 0.0) -> Any:
        return Odometry(0, "odom", "base", (x, 0.0, 0.0), (v, w)).to_ros(self)

    def scan(self, *ranges: float) -> Any:
        return LaserScan(0, "laser", -1.0, 0.1, 0.1, 0.1, 30.0, np.array(ranges)).to_ros(self)


@pytest.fixture(scope="session", params=["drive.bag", "drive"])
def driven(request, tmp_path_factory) -> SimpleNamespace:
    """A drive whose odometry is not the truth, in each format."""
    return _record(tmp_path_factory.mktemp("bag") / request.param, variation="strong", laser_noise=0.01)


@pytest.fixture
def record() -> Callable[..., SimpleNamespace]:
    return _record


@pytest.fixture(params=["drive.bag", "drive"])
def bag(request, tmp_path) -> Path:
    """The path of a bag, in each format."""
    return tmp_path / request.param


@pytest.fixture
def messages(bag) -> Messages:
    return Messages(1 if bag.suffix else 2)


@pytest.fixture
def write(bag, messages) -> Callable[..., Path]:
    """A function that writes messages (time [s], topic, message) to it; `definitions` replaces those of some types."""
    from rosbags import rosbag1, rosbag2

    def write(content, definitions=None) -> Path:
        connections = {}
        if messages.ros == 1:
            writer = rosbag1.Writer(bag)
        else:
            writer = rosbag2.Writer(bag, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP)
        with writer as opened:
            for time, topic, message in content:
                kind, definition = message.__msgtype__, {"typestore": messages.store}
                if text := (definitions or {}).get(kind):
                    definition = {"msgdef": text, "md5sum" if messages.ros == 1 else "rihs01": "0" * 32}
                if topic not in connections:
                    connections[topic] = opened.add_connection(topic, kind, **definition)
                opened.write(connections[topic], round(time * 1e9), messages.serialize(message))
        return bag

    return write
