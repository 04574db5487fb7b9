"""Loaded policies, untrained run folders, and an exported folder."""

from functools import cache
from pathlib import Path

import pytest

from tb2rl.commands.export import export_folder
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load


@pytest.fixture(scope="session")
def loaded():
    """`tb2rl.load`, each policy once."""
    return cache(load)


@pytest.fixture(scope="session")
def untrained(tmp_path_factory):
    """A function that saves an untrained policy as a run folder."""

    def save(agent, task, settings) -> Path:
        config = resolve(agent, task, settings={"train.n_envs": 2, "task.world": "wall", **settings})
        run = Run.create(tmp_path_factory.mktemp("untrained") / "run", config)
        run.save(make_algorithm(config), "final/policy")
        return run.folder

    return save


@pytest.fixture(scope="session")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    export_folder("zoo:drive-loop-ppo", folder)
    return folder
