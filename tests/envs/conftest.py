"""Environments that are closed after a test, and a task with other actions than the built-in ones."""

import sys
from contextlib import ExitStack, closing
from dataclasses import dataclass

import cloudpickle
import pytest

from tb2rl import make_env
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.tasks import Outcome, Task, Velocities

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # other processes cannot import it
CAMERA = {"camera": {"width": 36, "height": 36}}


@dataclass(frozen=True)
class Glide(Task):
    """Wander at any speed."""

    world: str = "circuit"
    actions = Velocities(forward=(-0.1, 0.5), turn=(-2.0, 2.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"collision": after.bumped})


@pytest.fixture
def glide():
    """The task `Glide`."""
    return Glide


@pytest.fixture(params=[("discrete", []), ("raw", []), ("raw", [CAMERA]), ("raw", ["laser", CAMERA])])
def observed(request):
    """How a task is observed, and its settings: classes, numbers, an image, both."""
    mode, observe = request.param
    return mode, {"observe": observe} if observe else {}


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
