"""States that a policy meets and others that it may meet, its export run by numpy, what a robot senses."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing
from textwrap import dedent

import numpy as np
import pytest

from tb2rl.commands.export import export_folder
from tb2rl.deploy.network import in_a_row, network_of
from tb2rl.deploy.portable.network import Network
from tb2rl.deploy.portable.policy_contract import Sensed
from tb2rl.envs.batch import ControlLoop
from tb2rl.envs.encodings import stacked
from tb2rl.runs.loading import config_of, load

MY_FEATURES = """
    from stable_baselines3.common.torch_layers import FlattenExtractor

    class Doubled(FlattenExtractor):
        def forward(self, observations):
            return 2.0 * super().forward(observations)
    """


@pytest.fixture(scope="session", autouse=True)
def my_features(tmp_path_factory) -> Iterator[None]:
    """The module "my_features", with features of a user's own."""
    folder = tmp_path_factory.mktemp("modules")
    (folder / "my_features.py").write_text(dedent(MY_FEATURES))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def _met(policy, count: int) -> np.ndarray:
    """Observations (count, ...) that robots meet in the twin, which do as the policy says three times of four."""
    config, num_envs = config_of(policy), min(count, 250)
    rng, seen = np.random.default_rng(1), []
    space = config.scene.action_space
    space.seed(1)
    with closing(ControlLoop(config.scene, num_envs)) as batch:
        batch.seed(1)
        observations = batch.reset()
        while len(seen) * num_envs < count:
            seen.append(np.array(observations))
            chosen, _ = policy.predict(observations, deterministic=True)
            by_chance = rng.random(num_envs) < 0.25
            chosen[by_chance] = np.stack([space.sample() for _ in range(num_envs)])[by_chance]
            observations = batch.step(chosen).observations
    return np.concatenate(seen)[:count]


def _states(policy, count: int) -> np.ndarray:
    """Half of them met on drives, the others anywhere in the observation space; (count, ...)."""
    space = policy.observation_space
    space.seed(0)
    return np.concatenate([_met(policy, count // 2), stacked([space.sample() for _ in range(count - count // 2)])])


@pytest.fixture
def states():
    """The function `_states`."""
    return _states


def _runner(policy) -> Network:
    """What the numpy program makes of observations."""
    return Network([(layer.kind, layer.arrays) for layer in in_a_row(network_of(policy))])


@pytest.fixture
def runner():
    """The function `_runner`."""
    return _runner


def _sensed(robot_state, robot: int, waypoint=None) -> Sensed:
    """What one robot of a reading senses; with a waypoint by its true pose, as a planner says it."""
    pose = robot_state.odometry if waypoint is None else robot_state.pose
    return Sensed(
        ranges=robot_state.ranges[robot],
        pose=tuple(pose[robot]),
        twist=tuple(robot_state.odometry_twist[robot]),
        bumped=bool(robot_state.bumped[robot]),
        command=tuple(robot_state.command[robot]),
        goal=tuple(robot_state.goal[robot]),
        waypoint=None if waypoint is None else tuple(waypoint[robot]),
    )


@pytest.fixture
def sensed():
    """The function `_sensed`."""
    return _sensed


@pytest.fixture(scope="session")
def loaded():
    """`tb2rl.load`, each policy once."""
    kept: dict[str, object] = {}
    return lambda name: kept[name] if name in kept else kept.setdefault(name, load(name))


@pytest.fixture(scope="session")
def robot(tmp_path_factory):
    """The folder of a policy, for a robot that has numpy and nothing else."""
    folder = tmp_path_factory.mktemp("exported")
    export_folder("zoo:drive-loop-ppo", folder)
    return folder
