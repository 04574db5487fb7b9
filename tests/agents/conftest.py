"""Small environments with values that can be computed by hand."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor

from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene


class Drive(gym.Env):
    """Two steps, whatever the action: state 0 to 1 for +5, 1 to 2 for -200, and there the episode ends."""

    def __init__(self, ends: str = "terminated", actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(3), gym.spaces.Discrete(actions)
        self.ends = ends

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = 0
        return self.state, {}

    def step(self, action):
        self.state += 1
        over = self.state == 2
        reward = -200.0 if over else 5.0
        return self.state, reward, over and self.ends == "terminated", over and self.ends == "truncated", {}


class Bandit(gym.Env):
    """Episodes of one step from the only state; action 0 pays 1, action 1 pays 2, and so on."""

    def __init__(self, actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(1), gym.spaces.Discrete(actions)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        return 0, 1.0 + action, True, False, {}


@cache
def navigating(guide, frame_stack):
    """A scene of task `navigate`."""
    return make_scene(make_task("navigate", {"world": "wall", "guide": guide, "frame_stack": frame_stack}), "raw")


class Playground:
    """A floor with posts (x, y, radius [m]) and a robot at x = y = 0, facing ahead, that has a target.

    A waypoint is the target itself, up to 1.5 m away. Walls are posts in a row.
    """

    GOAL_RADIUS = 0.3  # [m]

    def __init__(self, target, posts=(), guide="plan", frame_stack=1):
        self.target, self.posts = np.array(target), np.array(posts, dtype=float).reshape(-1, 3)
        self.scene, self.guide = navigating(guide, frame_stack), guide
        self.angles = self.scene.laser.angles

    def policy(self, kind, **arguments):
        """A policy of this scene."""
        return kind(self.scene.observation_space, self.scene.action_space, **arguments)

    def observe(self, pose=(0.0, 0.0, 0.0), speeds=(0.0, 0.0)):
        """The observation at a pose x, y, yaw with speeds v, w: one frame."""
        x, y, yaw = pose
        east, north = self.target - (x, y)
        far, bearing = np.hypot(east, north), np.arctan2(north, east) - yaw
        direction = np.array([np.cos(bearing), np.sin(bearing)])
        guide = [far, *direction, *np.zeros(25)] if self.guide == "goal" else min(far, 1.5) * direction  # visited
        rest = np.zeros(6 if self.guide == "goal" else 2)
        return np.array([*self._ranges(x, y, yaw), *guide, *speeds, *rest], dtype=np.float32)

    def command(self, kind, speeds=(0.0, 0.0), **arguments):
        """The first command of a policy, v and w."""
        return self.scene.actions.commands(self.policy(kind, **arguments).predict(self.observe(speeds=speeds))[0])

    def drive(self, kind, steps, **arguments):
        """Drive by a policy for some steps of 0.1 s, or until the target.

        Returns:
            The path x, y [m], shape (steps + 1, 2), and the least distance from it to a post [m].
        """
        policy, pose, speeds, path = self.policy(kind, **arguments), np.zeros(3), np.zeros(2), [(0.0, 0.0)]
        for _ in range(steps):
            speeds = self.scene.actions.commands(policy.predict(self.observe(pose, speeds))[0])
            middle = pose[2] + 0.05 * speeds[1]
            pose = pose + 0.1 * np.array([speeds[0] * np.cos(middle), speeds[0] * np.sin(middle), speeds[1]])
            path.append(pose[:2])
            if np.hypot(*(self.target - pose[:2])) < self.GOAL_RADIUS:
                break
        away = np.hypot(*(np.array(path)[:, None] - self.posts[:, :2]).T).T - self.posts[:, 2]
        return np.array(path), away.min(initial=np.inf)

    def _ranges(self, x, y, yaw):
        (east, north), cos, sin = (self.posts[:, :2] - (x, y)).T, np.cos(yaw + self.angles), np.sin(yaw + self.angles)
        along = np.outer(cos, east) + np.outer(sin, north)  # shape (beams, posts)
        aside = np.outer(cos, north) - np.outer(sin, east)
        depth = self.posts[:, 2] ** 2 - aside**2
        hits = np.where((depth > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(depth, 0.0)), 30.0)
        return hits.min(axis=1, initial=30.0)


@pytest.fixture
def playground():
    """The class `Playground`."""
    return Playground


@pytest.fixture
def drive():
    """The class `Drive`."""
    return Drive


@pytest.fixture
def bandit():
    """The class `Bandit`."""
    return Bandit


@pytest.fixture
def frozen_lake():
    """Makes Gymnasium's frozen lake."""
    return lambda slippery=False: Monitor(gym.make("FrozenLake-v1", is_slippery=slippery))


@pytest.fixture
def epsilons():
    """Returns epsilon in each step of a learner."""

    def of(model, steps, **arguments):
        seen = []
        model.learn(steps, callback=lambda local, _: seen.append(local["self"].exploration_rate) or True, **arguments)
        return seen

    return of
