"""Environments that are closed after a test, and tasks with other actions and sensors than the built-in ones."""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from dataclasses import dataclass

import cloudpickle
import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.sensors import Sensor
from tb2rl.tasks import Outcome, Task, Velocities
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # other processes cannot import it


@dataclass(frozen=True)
class Glide(Task):
    """Wander at any speed."""

    world: str = "circuit"
    actions = Velocities(forward=(-0.1, 0.5), turn=(-2.0, 2.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"collision": after.bumped})


class Map(Sensor):
    """An image in which one pixel moves with the robot, brighter the nearer a wall is."""

    name, low, high, shape = "map", 0, 255, (1, 36, 36)

    def read(self, robot_state):
        num_envs = len(robot_state.pose)
        images = np.zeros((num_envs, *self.shape), np.uint8)
        rows, columns = (robot_state.pose[:, :2] % 9.0 * 4.0).astype(int).T
        images[np.arange(num_envs), 0, rows, columns] = 255 / (1.0 + robot_state.nearest)
        return images


@dataclass(frozen=True)
class Beside(Wander):
    """Wander with an image beside the laser."""

    def sensors(self, spec):
        return (*super().sensors(spec), Map())


@dataclass(frozen=True)
class Alone(Wander):
    """Wander by an image alone."""

    def sensors(self, spec):
        return (Map(),)


class Straight:
    """A policy that takes the first action."""

    def predict(self, observation, *, deterministic=False):
        return np.array(0), None


@pytest.fixture
def straight():
    """A `Straight`."""
    return Straight()


@pytest.fixture
def glide():
    """The task `Glide`."""
    return Glide


@pytest.fixture(params=[Alone, Beside])
def image_task(request):
    """A task that observes an image: alone, or beside the laser's ranges."""
    return request.param


@pytest.fixture(params=[(Wander, "discrete"), (ReachGoal, "raw"), (Alone, "raw"), (Beside, "raw")])
def observed(request):
    """A task and how it is observed: classes, numbers, an image, both."""
    return request.param


@pytest.fixture
def make():
    """`make_env`, whose environments are closed after the test."""
    with ExitStack() as stack:
        yield lambda *arguments, **settings: stack.enter_context(closing(make_env(*arguments, **settings)))


@pytest.fixture
def start_vec_env():
    """A function that makes a `TurtleBot2VecEnv` of a task or scene; returns it and its first observations."""

    def start(task, observation="raw", num_envs=5, seed=0, **arguments):
        scene = task if isinstance(task, Scene) else make_scene(task, observation)
        env = TurtleBot2VecEnv(scene, num_envs, **arguments)
        env.seed(seed)
        return env, env.reset()

    return start


@pytest.fixture
def drive():
    """A function from an environment and actions to the answers of `step`, as far as the episode goes."""

    def answers_of(env, actions):
        answers = []
        for action in actions:
            answers.append(env.step(action))
            if answers[-1][2] or answers[-1][3]:
                break
        return answers

    return answers_of
