"""Recorded drives in the kinematic simulator, and bags of other robots."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tb2rl.deploy.bags.messages import BagMessages
from tb2rl.deploy.bags.recorder import open_bag
from tb2rl.deploy.ros.messages import LaserScan, Odometry, Twist
from tb2rl.envs.make import make_env
from tb2rl.envs.scene import Scene
from tb2rl.simulation import RobotState


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode, and the bag that holds it."""

    path: Path
    scene: Scene
    robot_states: list[RobotState]
    commands: np.ndarray
    rewards: list[float]
    distance: float


def _record(path: Path, task: str = "maze", steps: int = 10, **settings: Any) -> RecordedEpisode:
    """Record random actions."""
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
    return RecordedEpisode(path, env.scene, robot_states, np.array(commands), rewards, info["distance"])


class Messages(BagMessages):
    """Makes messages of either ROS from plain values."""

    def __call__(self, kind: str, **fields: Any) -> Any:
        message = self.new(kind)
        for name, value in fields.items():
            setattr(message, name, value)
        return message

    def odometry(self, x: float, v: float = 0.0, w: float = 0.0) -> Any:
        return Odometry(0, "odom", "base", (x, 0.0, 0.0), (v, w)).to_ros(self)

    def twist(self, v: float, w: float) -> Any:
        return Twist(v, w).to_ros(self)

    def scan(self, *ranges: float) -> Any:
        return LaserScan(0, "laser", -1.0, 0.1, 0.1, 0.1, 30.0, np.array(ranges)).to_ros(self)


def _write(path: Path, messages: Iterable[tuple[float, str, Any]], definitions: dict[str, str] | None = None) -> Path:
    """Write messages (time [s], topic, message); `definitions` replaces those of some types."""
    from rosbags import rosbag1, rosbag2

    made, connections = Messages(1 if path.suffix == ".bag" else 2), {}
    if made.ros == 1:
        writer = rosbag1.Writer(path)
    else:
        writer = rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with writer as bag:
        for time, topic, message in messages:
            kind = message.__msgtype__
            if (topic, kind) not in connections:
                definition = {"typestore": made.store}
                if text := (definitions or {}).get(kind):
                    definition = {"msgdef": text, "md5sum" if made.ros == 1 else "rihs01": "0" * 32}
                connections[topic, kind] = bag.add_connection(topic, kind, **definition)
            bag.write(connections[topic, kind], round(time * 1e9), made.serialize(message))
    return path


@pytest.fixture
def record() -> Callable[..., RecordedEpisode]:
    """The function `_record`."""
    return _record


@pytest.fixture(scope="session", params=["drive.bag", "drive"])
def driven(request, tmp_path_factory) -> RecordedEpisode:
    """A drive whose odometry is not the truth, in each format."""
    return _record(tmp_path_factory.mktemp("bag") / request.param, variation="strong", laser_noise=0.01)


@pytest.fixture
def write() -> Callable[..., Path]:
    """The function `_write`."""
    return _write


@pytest.fixture(params=["drive.bag", "drive"])
def bag(request, tmp_path) -> Path:
    """The path of a bag, in each format."""
    return tmp_path / request.param


@pytest.fixture
def messages(bag) -> Messages:
    """Messages for it."""
    return Messages(1 if bag.suffix else 2)
