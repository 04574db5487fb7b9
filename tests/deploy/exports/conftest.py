"""Observations of a policy, its export run by numpy, sensor data of simulated robots, untrained run folders."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tb2rl.commands.export import export_folder
from tb2rl.deploy.network import network_of
from tb2rl.deploy.portable.network import Network
from tb2rl.envs.encodings import stacked
from tb2rl.envs.seeded_loop import SeededLoop
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import config_of, load


def _from_drives(policy, count: int) -> np.ndarray:
    """Observations (count, ...) from drives in the kinematic simulator with three of four actions by the policy."""
    config, num_envs = config_of(policy), min(count, 250)
    rng, seen = np.random.default_rng(1), []
    space = config.scene.action_space
    space.seed(1)
    with closing(SeededLoop.open(config.scene, "kinematic", num_envs)) as loop:
        loop.seed(1)
        observations = loop.reset_all()
        while len(seen) * num_envs < count:
            seen.append(np.array(observations))
            actions, _ = policy.predict(observations, deterministic=True)
            random = rng.random(num_envs) < 0.25
            actions[random] = np.stack([space.sample() for _ in range(num_envs)])[random]
            observations = loop.step_and_reset(actions).observations
    return np.concatenate(seen)[:count]


@pytest.fixture(scope="session")
def observations_of():
    """A function: observations (count, ...) of a policy, half from drives, half anywhere in the space."""

    def observations(policy, count: int) -> np.ndarray:
        space = policy.observation_space
        space.seed(0)
        return np.concatenate(
            [_from_drives(policy, count // 2), stacked([space.sample() for _ in range(count - count // 2)])]
        )

    return observations


@pytest.fixture(scope="session")
def numpy_network():
    """A function: the network of a policy, run with numpy."""
    return lambda policy: Network([(layer.kind, layer.arrays) for layer in network_of(policy).sequence()])


@pytest.fixture(scope="session")
def loaded():
    """`tb2rl.load`, each policy once."""
    kept: dict[str, object] = {}
    return lambda name: kept[name] if name in kept else kept.setdefault(name, load(name))


@pytest.fixture(scope="session")
def untrained(tmp_path_factory):
    """A function that saves an untrained policy as a run folder."""

    def save(agent, task, settings) -> Path:
        config = resolve(agent, task, settings={"train.n_envs": 2, "task.world": "wall", **settings})
        run = Run.create(tmp_path_factory.mktemp("untrained") / "run", config)
        run.save(make_algorithm(config, Spaces.vectorised(config)), "final/policy")
        return run.folder

    return save


@pytest.fixture(scope="session")
def robot(tmp_path_factory):
    """The exported folder of a policy."""
    folder = tmp_path_factory.mktemp("exported")
    export_folder("zoo:drive-loop-ppo", folder)
    return folder
