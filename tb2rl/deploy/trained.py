"""A policy of tb2rl as drivers ask it: what one robot sensed becomes what it observed in its training."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.deploy.portable.policy_contract import Needs, Sensed, Speeds
from tb2rl.deploy.senses import find_senses
from tb2rl.envs.encodings import rows
from tb2rl.envs.observation_pipeline import ObservationPipeline
from tb2rl.envs.scene import Scene
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.tasks import Actions
from tb2rl.worlds import World

_AROUND = 5.0  # [m] around a robot and its goal that fit on the map that it draws
_NEAR = 0.3  # [m] that counts as at the goal, for tasks that name no `goal_radius` or `goal_tolerance`


class TrainedPolicy:
    """What `tb2rl.load` loads, with the observations and actions of its training; a `tb2rl.deploy.Policy`.

    A task with `map: online` draws its map of what the robot sees; for one with `map: known`, the driver needs a
    plan or a planner. Goals are in the odometry frame, and the odometry is taken for where the robot is.

    Args:
        policy: A policy from `tb2rl.load` or `tb2rl.train`, or what `tb2rl.load` takes.
        config: What it is to do; None: what it was trained to do. A policy that was not trained here needs one.

    Raises:
        InputError: If there is no such policy, or it observes what no robot can sense.
    """

    def __init__(self, policy: Any, config: Config | None = None) -> None:
        if isinstance(policy, str | Path):
            policy = load(policy)
        scene = (config or config_of(policy)).scene
        self.needs = needs_in(scene)
        self._policy, self._scene = getattr(policy, "policy", policy), scene
        self._spec = SimulationSpec(scene.robot, scene.laser, (floor(),))
        self._begin_with = Sensed(np.full(len(self.needs.beams), np.inf), goal=(2.0, 0.0), waypoint=(1.0, 0.0))
        self._warm_up()

    def begin(self) -> None:
        """Forget the last episode."""
        self._observation_pipeline: ObservationPipeline | None = None
        self._memory: Any = None
        self._speed = 0.0

    def act(self, sensed: Sensed) -> Speeds:
        """The greedy command for the next control step."""
        if self._observation_pipeline is None:
            self._observation_pipeline, self._initial_state = self._episode(sensed)
            observations = self._observation_pipeline.reset(self._reading(sensed))
        else:
            self._observation_pipeline.remember(np.array([sensed.command], dtype=float))
            observations = self._observation_pipeline.step(self._reading(sensed))
        remembered = {} if self._memory is None else {"state": self._memory}
        action, self._memory = self._policy.predict(rows(observations, 0), deterministic=True, **remembered)
        v, w = self._scene.actions.commands(self._scene.actions.checked(action))[0].tolist()
        return v, w

    def _warm_up(self) -> None:
        """Compile now what would be compiled in the first steps on the road."""
        self.begin()
        for _ in range(2):
            self.act(self._begin_with)
        self.begin()

    def _episode(self, sensed: Sensed) -> tuple[ObservationPipeline, InitialState]:
        scene, spec = self._scene, self._spec
        if scene.task.maps_online:
            spec = SimulationSpec(scene.robot, scene.laser, (floor(sensed.pose[:2], sensed.goal or sensed.pose[:2]),))
        episode_states = scene.episode_states(spec)
        observation_pipeline = ObservationPipeline(
            scene.encoding, scene.observation_space, scene.task.frame_stack, episode_states=episode_states
        )
        return observation_pipeline, InitialState.default(spec, 1)

    def _reading(self, sensed: Sensed) -> RobotState:
        """What the robot sensed, as a simulation would say it."""
        if sensed.goal is not None:
            self._initial_state.goal[:] = sensed.goal
        pose, twist = np.array([sensed.pose], dtype=float), np.array([sensed.twist], dtype=float)
        faster, self._speed = sensed.twist[0] - self._speed, sensed.twist[0]
        return RobotState(
            pose=pose,
            twist=twist,
            odometry=pose,
            odometry_twist=twist,
            ranges=np.array([sensed.ranges], dtype=float),
            bumped=np.array([sensed.bumped]),
            command=np.array([sensed.command], dtype=float),
            acceleration=np.array([faster / self.needs.period]),
            initial_state=self._initial_state,
            occupancy_map=None if sensed.waypoint is None else _Told(np.array([sensed.waypoint], dtype=float)),
        )


class _Told:
    """A plan that somebody else has made: the point of it that was told."""

    def __init__(self, waypoint: np.ndarray) -> None:
        self._waypoint = waypoint

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        return self._waypoint


def needs_in(scene: Scene) -> Needs:
    """What a policy needs of a robot to do there what it does in a scene.

    Raises:
        InputError: If it observes what no robot can sense.
    """
    task, laser, senses = scene.task, scene.laser, find_senses(scene)
    goal = "plan" if senses.lookahead is not None and not task.maps_online else None
    if goal is None and (task.goal_task or task.maps_online or senses.goal):
        goal = "goal"
    radius = getattr(task, "goal_radius", getattr(task, "goal_tolerance", _NEAR))
    speed, turn_rate = _fastest(scene.actions)
    return Needs(
        beams=laser.angles,
        min_range=laser.min_range,
        max_range=laser.max_range,
        period=task.control_period,
        max_speed=speed,
        max_turn_rate=turn_rate,
        robot=scene.robot.name,
        uses_odometry=senses.odometry or task.maps_online,
        goal=goal,
        goal_radius=radius,
        lookahead=senses.lookahead or 0.0,
    )


def _fastest(actions: Actions) -> Speeds:
    """The largest |v| [m/s] and |w| [rad/s] that actions command."""
    space = actions.space
    if isinstance(space, spaces.Discrete):
        all_of_them = np.arange(space.n)
    else:
        assert isinstance(space, spaces.Box)
        all_of_them = np.array(list(product(*zip(space.low, space.high, strict=True))))
    speed, turn_rate = np.abs(actions.commands(all_of_them)).max(axis=0).tolist()
    return speed, turn_rate


def floor(*places: tuple[float, float]) -> World:
    """A world without anything in it that holds some places, and much around them."""
    x, y = np.array(places or ((0.0, 0.0),)).T
    left, bottom, right, top = (float(side) for side in (x.min(), y.min(), x.max(), y.max()))
    bounds = (left - _AROUND, bottom - _AROUND, right + _AROUND, top + _AROUND)
    return World.from_shapes("floor", start=(left, bottom, 0.0), bounds=bounds)
