"""A policy with one action, tasks that are special in one way each, and episodes without a drive."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.tasks import Outcome, Task, Velocities
from tb2rl.tasks.wander import Wander


class _Forward:
    """Always takes the first action: forward."""

    def predict(self, observation, *, deterministic=False):
        return np.int64(0), None


@dataclass(frozen=True)
class Cruise(Task):
    """Any velocities within a range."""

    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"bump": after.bumped})


@dataclass(frozen=True)
class Northward(Wander):
    """Every episode starts with yaw pi / 2 and has a random goal."""

    goal_task = True

    def initial_state(self, spec, random):
        states = super().initial_state(spec, random)
        states.pose[:, 2] = math.pi / 2
        states.goal[:] = random.uniform(2)
        return states

    def outcome(self, before, action, after):
        outcome = super().outcome(before, action, after)
        return replace(outcome, succeeded={"goal": np.zeros(len(outcome.reward), dtype=bool)})


def _outcomes(evaluation: Evaluation) -> list[tuple]:
    """Everything that happened, for comparisons to the bit."""
    return [
        (e.start, e.ended, e.failed, e.length, e.distance, e.episode_return, e.path.tolist(), e.actions.tolist())
        for e in evaluation.episodes
    ]


def _episode(ended="time limit", success=True, length=0, distance=1.0, total=0.0, failed=None) -> Episode:
    """An episode that was not driven; a collision counts as failed, other endings as `failed` says."""
    failed = ended == "collision" if failed is None else failed
    path, actions = np.zeros((length + 1, 2), np.float32), np.zeros(length, np.uint8)
    return Episode((0.0, 0.0, 0.0), ended, failed, success, failed, length, distance, total, path, actions)


@pytest.fixture
def forward() -> _Forward:
    return _Forward()


@pytest.fixture
def outcomes():
    return _outcomes


@pytest.fixture
def make_episode():
    return _episode


@pytest.fixture
def cruise() -> type[Task]:
    return Cruise


@pytest.fixture
def northward() -> type[Task]:
    return Northward
