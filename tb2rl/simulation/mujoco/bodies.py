"""A robot and its dynamic obstacles in a MuJoCo model."""

from copy import copy
from typing import NamedTuple

import numpy as np
from mujoco import MjData, MjModel, mj_setConst

from tb2rl.robots import Robot
from tb2rl.simulation.mujoco.models import quaternion, vary_model
from tb2rl.worlds.world import WALL_HEIGHT

_START_HEIGHT = -1.0e-6  # [m] the wheels sink so far into the floor; at 0 they would have no grip in the first step
_ABSENT = (0.0, 0.0, -100.0)  # [m] position of an obstacle that is absent in an episode


class Models(NamedTuple):
    """Models that differ in their time steps only, so that both can step the same data."""

    coarse: MjModel  # where the robot cannot touch anything
    fine: MjModel  # for the motion near obstacles; `FINE_STEPS` of its time steps are one of the coarse model


class RobotBody:
    """A robot and its dynamic obstacles in a MuJoCo model.

    Attributes:
        models, data: MuJoCo's models and data.
        wheel_rates: View of the target rates of the left and the right wheel's motors [rad/s].
        joints: View of the positions of the joints: x, y, z [m] and yaw [rad] of the base, angles [rad] of the wheels.
        rates: View of their velocities [m/s or rad/s].
        warm_start: View of the accelerations from which the solver starts [m/s^2 or rad/s^2].
    """

    def __init__(self, models: Models) -> None:
        self.load(models)

    def load(self, models: Models) -> None:
        """Move to another world, or become another robot."""
        self.models, self.data = models, MjData(models.coarse)
        self._nominal: Models | None = None  # those of which `models` are varied copies
        self.joints, self.rates, self.warm_start = self.data.qpos, self.data.qvel, self.data.qacc_warmstart
        self.wheel_rates, self._obstacles = self.data.ctrl, range(models.coarse.nmocap)

    def vary(self, nominal: Models, robot: Robot, *ratios: float) -> None:
        """Become a robot with other mass, friction and torque, see `vary_model`, in the world of nominal models."""
        if self._nominal is not nominal:
            self.load(Models(*map(copy, nominal)))
            self._nominal = nominal
        for varied, model in zip(self.models, nominal, strict=True):
            vary_model(varied, model, robot, *ratios)
            mj_setConst(varied, self.data)

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at rest at a pose (3,)."""
        self.joints[:] = pose[0], pose[1], _START_HEIGHT, pose[2], 0.0, 0.0
        self.rates[:], self.warm_start[:] = 0.0, 0.0

    def place_obstacles(self, outlines: np.ndarray) -> None:
        """Put the obstacles at their outlines (obstacles, 6), see `RobotState.dynamic_obstacles`."""
        for obstacle in self._obstacles:
            x, y, cos, sin, length, _ = outlines[obstacle].tolist()
            self.data.mocap_pos[obstacle] = (x, y, WALL_HEIGHT / 2) if length > 0.0 else _ABSENT
            self.data.mocap_quat[obstacle] = quaternion(cos, sin)
