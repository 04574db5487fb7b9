"""Runs a policy of tb2rl for a driver: sensor data becomes the observation of its training."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.deploy.needs import needs_in
from tb2rl.deploy.portable.policy_contract import SensorData, Speeds
from tb2rl.envs.encodings import rows
from tb2rl.envs.observation_pipeline import ObservationPipeline
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.worlds import World

_MARGIN = 5.0  # [m] of the map around a robot and its goal


class TrainedPolicy:
    """A policy with the observations and actions of its training; a `tb2rl.deploy.Policy`.

    A task with `map: online` draws its map itself; for one with `map: known`, the driver needs a plan. Goals are in the
    odometry frame, and the odometry counts as the true pose.

    Args:
        policy: A policy from `tb2rl.load` or `tb2rl.train`, or an argument of `tb2rl.load`.
        config: Its task; None: the task of its training. A policy that was not trained here needs one.

    Attributes:
        needs: Its requirements.
        filters: The filters of its commands.

    Raises:
        InputError: If there is no such policy, or it observes what no robot can sense.
    """

    def __init__(self, policy: Any, config: Config | None = None) -> None:
        if isinstance(policy, str | Path):
            policy = load(policy)
        self._scene = (config or config_of(policy)).scene
        self.needs, self.filters = needs_in(self._scene), list(deepcopy(self._scene.filters))
        self._policy = getattr(policy, "policy", policy)
        self._compile()

    def reset(self) -> None:
        """Start a new episode."""
        self._observation_pipeline: ObservationPipeline | None = None
        self._memory: Any = None  # of a recurrent policy
        self._speed = 0.0

    def act(self, sensed: SensorData) -> Speeds:
        """The greedy command of the next control step."""
        if self._observation_pipeline is None:
            self._observation_pipeline = self._new_episode(sensed)
            observations = self._observation_pipeline.reset(self._robot_state(sensed))
        else:
            self._observation_pipeline.remember(np.array([sensed.command], dtype=float))
            observations = self._observation_pipeline.step(self._robot_state(sensed))
        memory = {} if self._memory is None else {"state": self._memory}
        action, self._memory = self._policy.predict(rows(observations, 0), deterministic=True, **memory)
        v, w = self._scene.actions.commands(self._scene.actions.checked(action))[0].tolist()
        return v, w

    def _compile(self) -> None:
        """Compile now what two steps compile, because compilation would delay the first steps of a drive."""
        sensed = SensorData(np.full(len(self.needs.beams), np.inf), goal=(2.0, 0.0), waypoint=(1.0, 0.0))
        self.reset()
        for _ in range(2):
            self.act(sensed)
        self.reset()

    def _new_episode(self, sensed: SensorData) -> ObservationPipeline:
        scene = self._scene
        place = sensed.pose[:2]
        world = floor(place, sensed.goal or place) if scene.task.maps_online else floor()
        spec = SimulationSpec(scene.robot, scene.laser, (world,))
        self._initial_state = InitialState.default(spec, 1)
        states = scene.episode_states(spec)
        return ObservationPipeline(
            scene.encoding, scene.observation_space, scene.task.frame_stack, episode_states=states
        )

    def _robot_state(self, sensed: SensorData) -> RobotState:
        """The sensor data in the form of the simulators."""
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
            occupancy_map=None if sensed.waypoint is None else _Plan(np.array([sensed.waypoint], dtype=float)),
        )


@dataclass(frozen=True)
class _Plan:
    """A plan from outside, of which one point is known."""

    waypoint: np.ndarray

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        return self.waypoint


def floor(*places: tuple[float, float]) -> World:
    """An empty world around some places."""
    x, y = np.array(places or ((0.0, 0.0),)).T
    left, bottom, right, top = (float(side) for side in (x.min(), y.min(), x.max(), y.max()))
    bounds = (left - _MARGIN, bottom - _MARGIN, right + _MARGIN, top + _MARGIN)
    return World.from_shapes("floor", start=(left, bottom, 0.0), bounds=bounds)
