"""Adapts a trained policy to `Driver`: converts the driver's sensor data to observations as in the training."""

from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tb2rl.deploy.description import find_needs
from tb2rl.deploy.portable.policy_contract import SensorData, Speeds
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.observation_pipeline import ObservationPipeline
from tb2rl.envs.parts import robot_facts
from tb2rl.runs import Config, config_of, load
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.worlds import World

_MARGIN = 5.0  # [m] of an empty world around the robot and its goal


class TrainedPolicy:
    """A policy with the observations and actions of its training; a `tb2rl.deploy.Policy`.

    With `guide: plan` the policy plans its path itself (`map: online`), or needs `Driver.set_plan` (`map: known`).
    Goals are in the odometry frame, and odometry replaces the true pose.

    Args:
        policy: A policy from `tb2rl.load` or `tb2rl.train`, or an argument of `tb2rl.load`.
        config: The configuration with the task; by default that of the training, if there was one.

    Attributes:
        needs: The requirements of the policy.
        filters: Filters that the driver applies to the commands of `act`.
        safety: Facts about the robot for `Safety`.

    Raises:
        InputError: If there is no such policy, or it observes what no robot can sense.
    """

    def __init__(self, policy: Any, config: Config | None = None) -> None:
        if isinstance(policy, str | Path):
            policy = load(policy)
        self._scene = (config or config_of(policy)).scene
        self.needs, self.filters = find_needs(self._scene), list(deepcopy(self._scene.filters))
        self.safety = robot_facts(self._scene.task, self._scene.spec)
        self._policy = getattr(policy, "policy", policy)
        sensor_data = SensorData(np.full(len(self.needs.beams), np.inf), goal=(2.0, 0.0), waypoint=(1.0, 0.0))
        self.reset()
        for _ in range(2):  # because compilation during the first two steps would delay a drive
            self.act(sensor_data)
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._observation_pipeline: ObservationPipeline | None = None
        self._recurrent_state: Any = None
        self._speed = 0.0

    def act(self, sensor_data: SensorData) -> Speeds:
        """The greedy command of the next control step."""
        if self._observation_pipeline is None:
            self._observation_pipeline = self._new_episode(sensor_data)
            observations = self._observation_pipeline.reset(self._robot_state(sensor_data))
        else:
            robot_state = self._robot_state(sensor_data)
            observations = self._observation_pipeline.step(robot_state, robot_state.command)
        keywords = {} if self._recurrent_state is None else {"state": self._recurrent_state}
        action, self._recurrent_state = self._policy.predict(take_rows(observations, 0), deterministic=True, **keywords)
        return tuple(self._scene.actions.commands(self._scene.actions.checked(action))[0].tolist())

    def _new_episode(self, sensor_data: SensorData) -> ObservationPipeline:
        scene, position = self._scene, sensor_data.pose[:2]
        # The online map has the bounds of this world, which must contain robot and goal; otherwise any world will do.
        points = (position, sensor_data.goal or position) if scene.task.maps_online else ((0.0, 0.0),)
        world = make_empty_world(*points)
        spec = SimulationSpec(scene.robot, scene.laser, (world,))
        self._initial_state = InitialState.default(spec, 1)
        return scene.observation_pipeline(spec)

    def _robot_state(self, sensor_data: SensorData) -> RobotState:
        """The sensor data as the robot state of a simulator."""
        if sensor_data.goal is not None:
            self._initial_state.goal[:] = sensor_data.goal
        measurements = sensor_data.pose, sensor_data.twist, sensor_data.ranges, sensor_data.command
        pose, twist, ranges, command = (np.array([values], dtype=float) for values in measurements)
        acceleration, self._speed = (sensor_data.twist[0] - self._speed) / self.needs.period, sensor_data.twist[0]
        other_fields = np.array([sensor_data.bumped]), command, np.array([acceleration]), self._initial_state
        waypoint_source: Any = None  # in place of the map that `RobotState.lookahead_point` asks
        if sensor_data.waypoint is not None:
            waypoint = np.array([sensor_data.waypoint], dtype=float)
            waypoint_source = SimpleNamespace(lookahead_point=lambda robot_state, lookahead: waypoint)
        # True pose and twist, then those of odometry:
        return RobotState(pose, twist, pose, twist, ranges, *other_fields, occupancy_map=waypoint_source)


def make_empty_world(*points: tuple[float, float]) -> World:
    """Make a world without obstacles around some points x, y [m]."""
    (left, bottom), (right, top) = np.min(points, axis=0).tolist(), np.max(points, axis=0).tolist()
    bounds = (left - _MARGIN, bottom - _MARGIN, right + _MARGIN, top + _MARGIN)
    return World.from_shapes("floor", start=(left, bottom, 0.0), bounds=bounds)
