"""Drives in the twin that are recorded, and bags as other robots leave them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tb2rl.deploy.bags.recorded import RecordedEnv
from tb2rl.deploy.bags.recorder import open_bag
from tb2rl.deploy.bags.topics import message_types, rosbags_library
from tb2rl.envs.make import make_env
from tb2rl.simulation import RobotState


@dataclass(frozen=True)
class Recorded:
    """An episode that was recorded, and what happened in it."""

    path: Path
    env: RecordedEnv
    readings: list[RobotState]
    commands: np.ndarray
    rewards: list[float]
    distance: float


def _record(path: Path, task: str = "maze", steps: int = 10, **settings: Any) -> Recorded:
    """Drive at random in the twin."""
    scene = make_env(task, "raw", simulation="kinematic", **settings).scene
    env = RecordedEnv(scene, simulation="kinematic")
    readings, commands, rewards, distance = [], [], [], 0.0
    with open_bag(path, scene) as env.recorder:
        env.reset(seed=3)
        env.action_space.seed(3)
        readings.append(env.robot_state)
        for _ in range(steps):
            action = env.action_space.sample()
            _, reward, terminated, truncated, info = env.step(action)
            readings.append(env.robot_state)
            commands.append(env.scene.actions.commands(env.scene.actions.checked(action))[0])
            rewards.append(float(reward))
            distance = info["distance"]
            if terminated or truncated:
                break
    return Recorded(path, env, readings, np.array(commands), rewards, distance)


class Messages:
    """Makes messages of either ROS from plain values."""

    def __init__(self, first: bool) -> None:
        self.store = _store(first)

    def __call__(self, kind: str, **fields: Any) -> Any:
        made = self.store.types[kind]
        given = {name: fields.get(name, self._usual(kind, name)) for name in self._names(kind)}
        return made(**given)

    def _names(self, kind: str) -> list[str]:
        return [name for name, _ in self.store.fielddefs[kind][1]]

    def _usual(self, kind: str, name: str) -> Any:
        (form, what), *_ = [field for each, field in self.store.fielddefs[kind][1] if each == name]
        if form.name == "NAME":
            return self(what)
        if form.name == "BASE":
            return {"string": "", "bool": False}.get(what[0], 0)
        (_, (number, _)), length = what
        return np.zeros(length, dtype=number)

    def odometry(self, x: float, y: float = 0.0, yaw: float = 0.0, v: float = 0.0, w: float = 0.0) -> Any:
        turned = self("geometry_msgs/msg/Quaternion", z=np.sin(yaw / 2), w=np.cos(yaw / 2))
        pose = self("geometry_msgs/msg/Pose", position=self("geometry_msgs/msg/Point", x=x, y=y), orientation=turned)
        covariance = {"covariance": np.zeros(36)}
        return self(
            "nav_msgs/msg/Odometry",
            pose=self("geometry_msgs/msg/PoseWithCovariance", pose=pose, **covariance),
            twist=self("geometry_msgs/msg/TwistWithCovariance", twist=self.twist(v, w), **covariance),
        )

    def twist(self, v: float, w: float) -> Any:
        linear, angular = self("geometry_msgs/msg/Vector3", x=v), self("geometry_msgs/msg/Vector3", z=w)
        return self("geometry_msgs/msg/Twist", linear=linear, angular=angular)

    def scan(self, *ranges: float) -> Any:
        values = np.array(ranges, dtype=np.float32)
        return self("sensor_msgs/msg/LaserScan", range_min=0.1, range_max=30.0, ranges=values)


def _store(first: bool) -> Any:
    return message_types(rosbags_library(), first)


def _write(path: Path, messages: Iterable[tuple[float, str, Any]], definitions: dict[str, str] | None = None) -> Path:
    """A bag with messages (time [s], topic, message), in which some types can be defined by another text."""
    from rosbags import rosbag1, rosbag2

    first = path.suffix == ".bag"
    store, connections = _store(first), {}
    new = rosbag1.Writer(path) if first else rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with new as bag:
        for time, topic, message in messages:
            kind = message.__msgtype__
            if (topic, kind) not in connections:
                told = {"typestore": store}
                if text := (definitions or {}).get(kind):
                    told = {"msgdef": text, "md5sum" if first else "rihs01": "0" * 32}
                connections[topic, kind] = bag.add_connection(topic, kind, **told)
            serialize = store.serialize_ros1 if first else store.serialize_cdr
            bag.write(connections[topic, kind], round(time * 1e9), serialize(message, kind))
    return path


@pytest.fixture
def record() -> Callable[..., Recorded]:
    """The function `_record`."""
    return _record


@pytest.fixture
def write() -> Callable[..., Path]:
    """The function `_write`."""
    return _write


@pytest.fixture
def messages() -> type[Messages]:
    """The class `Messages`."""
    return Messages


@pytest.fixture(params=["drive.bag", "drive"])
def bag(request, tmp_path) -> Path:
    """Where a bag of each format is to be."""
    return tmp_path / request.param
