"""Robots that are driven by their wheels in MuJoCo."""

import math
from collections import OrderedDict
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from mujoco import mj_step

from tb2rl.core.errors import InputError
from tb2rl.core.threads import parallel_for
from tb2rl.simulation.arrays.robots import ROBOT, RobotArrays
from tb2rl.simulation.arrays.simulator import ArraySimulator
from tb2rl.simulation.mujoco.bodies import Models, RobotBody
from tb2rl.simulation.mujoco.camera import CameraRenderer
from tb2rl.simulation.mujoco.models import FINE_STEPS, check_robot, make_model, set_time_step
from tb2rl.simulation.mujoco.motion import NEAR_OBSTACLES, ControlStep, begin_step, end_step
from tb2rl.simulation.obstacles.motion import step_obstacles
from tb2rl.simulation.obstacles.outlines import distance_to_nearest
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import ResetGenerators, ResetStates
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec

# [m] a robot whose gap to an obstacle is smaller touches the obstacle; slightly above the gap at which walls begin to
# stop the base. The first touch was in another control step than in the kinematic simulator in 9 of 2 000 drives; with
# 0.5 mm, in 15.
_CONTACT = 0.25e-3
_MAX_MODELS = 256  # number of worlds whose models are kept
_MOTION = ("joints", "rates", "warm_start")  # keys in `state`, and attributes of `RobotBody`
_MAX_MOTION = 1e6  # limit of the numbers in a restored motion


class MujocoSimulator(ArraySimulator):
    """Robots in MuJoCo, each in one of the worlds; see `ArraySimulator`. Laser ranges come from the worlds' geometry.

    Raises:
        InputError: If MuJoCo cannot load the robot.
    """

    wheels_slip = True

    def __init__(self, spec: SimulationSpec, num_envs: int = 1) -> None:
        check_robot(spec.robot)
        self._models: OrderedDict[int, Models] = OrderedDict()  # by world, least recently used first
        self._renderer: CameraRenderer | None = None
        self._time_step = 1.0 / (PHYSICS_RATE * spec.substeps)
        self._bodies: list[RobotBody] = []
        super().__init__(spec, num_envs)
        model = self._bodies[0].models.coarse
        left, right = (int(model.joint(name).qposadr[0]) for name in spec.robot.wheel_joints)
        self._wheel_columns = left, right

    def _place_robots(self, initial_state: InitialState, keys: np.ndarray) -> None:
        super()._place_robots(initial_state, keys)
        self._joints = np.empty((self.num_envs, 6))
        self._bodies = self._bodies or [RobotBody(self._models_of_world(0)) for _ in range(self.num_envs)]
        self._place(np.arange(self.num_envs), initial_state)

    def _place(self, indices: np.ndarray, initial_state: InitialState) -> None:
        """Put robots at rest at their start poses, in their worlds."""
        if (initial_state.records["radius"] != self.spec.robot.radius).any():
            raise InputError("MuJoCo cannot change the robot's radius; use another simulator")
        for i, pose, episode in zip(indices.tolist(), initial_state.pose, initial_state.records, strict=True):
            self._prepare_body(self._bodies[i], episode)
            self._bodies[i].place(pose)
            self._joints[i] = self._bodies[i].joints

    def _prepare_body(self, body: RobotBody, episode: np.void) -> None:
        """Give a body the world and the robot of a record of `InitialState`."""
        models, robot = self._models_of_world(int(episode["world"])), self.spec.robot
        ratios = episode["mass"], episode["friction"], episode["wheel_acceleration"] / robot.wheel_acceleration
        if ratios != (1.0, 1.0, 1.0):
            body.vary(models, robot, *ratios)
        elif body.models is not models:
            body.load(models)

    def _models_of_world(self, world: int) -> Models:
        """Models for the nominal robot in a world."""
        if world not in self._models:
            model = make_model(self.spec, world, self._obstacles.sizes(world))
            self._models[world] = Models(model, copy(model))
            self._set_time_steps(self._models[world])
            if len(self._models) > _MAX_MODELS:
                self._models.popitem(last=False)
        self._models.move_to_end(world)
        return self._models[world]

    def _set_time_steps(self, models: Models) -> None:
        set_time_step(models.coarse, self.spec.robot, self._time_step)
        set_time_step(models.fine, self.spec.robot, self._time_step / FINE_STEPS)

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        self._joints = self._joints.copy()
        self._place(indices, initial_state)
        return super().reset_at(indices, initial_state, rng)

    def step_robots(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotArrays:
        count, robot = self.num_envs, self.spec.robot
        steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
        if (time_step := duration / (steps * self.spec.substeps)) != self._time_step:
            self._time_step = time_step
            for models in {*self._models.values(), *(body.models for body in self._bodies)}:
                self._set_time_steps(models)
        robots = RobotArrays(self._initial_state.records, np.empty(count, ROBOT), np.empty(self._ranges.shape))
        step = ControlStep(
            np.ascontiguousarray(commands, dtype=float),
            *(duration, steps, robot.wheel_radius, robot.wheel_separation, self._wheel_columns, self._joints),
            *(np.empty((count, 2)), np.empty(count, int)),
            *(np.empty((count, 6)), np.empty((count, 6)), np.zeros((count, 2), bool)),
        )
        arguments = robots, step, inactive
        if count > 1:
            parallel_for(self._step_block, count, 0, *arguments)
        else:
            self._step_block(0, 1, *arguments)
        self._joints = step.joints
        return robots

    def _step_block(
        self, first: int, end: int, robots: RobotArrays, step: ControlStep, inactive: np.ndarray | None
    ) -> None:
        """Step the robots from `first` to `end` - 1; a thread's part of a control step."""
        obstacles = self._obstacles.arrays
        begin_step(first, end, self._constants, self._robots, step, obstacles)
        for i in range(first, end):
            body = self._bodies[i]
            if inactive is None or not inactive[i]:
                body.wheel_rates[:] = step.wheel_rates[i]
                if obstacles is not None:
                    body.place_obstacles(self._obstacles.outlines[i])
                free_steps = int(step.free_steps[i])
                if free_steps == NEAR_OBSTACLES:
                    step.touches[i] = self._step_among_obstacles(i, step)
                else:
                    step.touches[i, 0] = self._step_near_walls(i, step.steps, free_steps)
            step.joints[i], step.rates[i] = body.joints, body.rates
        end_step(first, end, self._constants, self._records, robots, step, obstacles)

    def _step_near_walls(self, i: int, steps: int, free_steps: int) -> bool:
        """Step a robot that cannot reach a wall in the `free_steps` first steps; returns whether it touched one."""
        body, touched, reach = self._bodies[i], False, self._reach(i)
        while steps:
            if free_steps:
                mj_step(body.models.coarse, body.data, free_steps * self.spec.substeps)
            else:
                touched = self._step_finely(i) or touched
            steps -= max(free_steps, 1)
            if steps:
                free_steps = int(min(self._gap_to_walls(i) / reach, steps))  # without walls, the gap is infinite
        return touched

    def _step_among_obstacles(self, i: int, step: ControlStep) -> tuple[bool, bool]:
        """Move the dynamic obstacles, and then the robot, in each physics step.

        Returns:
            Whether the robot touched a wall, and whether it touched a dynamic obstacle.
        """
        body, obstacles, wall_hit, obstacle_hit = self._bodies[i], self._obstacles, False, False
        world = self._initial_state.records, self.spec.spatial_index, int(self._initial_state.world[i])
        physics_step = step.duration / step.steps
        for number in range(step.steps):
            motion = *body.joints[:2].tolist(), *body.rates[:2].tolist()
            hit = step_obstacles(i, number, step.steps, physics_step, obstacles.arrays, *world, motion)
            body.place_obstacles(obstacles.outlines[i])
            wall_hit = self._step_finely(i) or wall_hit
            gap = distance_to_nearest(*body.joints[:2].tolist(), obstacles.arrays.obstacles, i) - self.spec.robot.radius
            obstacle_hit = obstacle_hit or hit or gap < _CONTACT
        return wall_hit, obstacle_hit

    def _step_finely(self, i: int) -> bool:
        """Run a physics step near obstacles; returns whether the robot touched a wall, however shortly."""
        body, touched = self._bodies[i], False
        for _ in range(FINE_STEPS):
            mj_step(body.models.fine, body.data, self.spec.substeps)
            touched = touched or self._gap_to_walls(i) < _CONTACT
        return touched

    def _reach(self, i: int) -> float:
        """Distance [m] that a robot cannot exceed in a physics step, unless it rebounds from an obstacle."""
        episode = self._initial_state.records[i]
        return float(episode["max_speed"] * episode["wheel_radius"]) * self._time_step * self.spec.substeps + _CONTACT

    def _gap_to_walls(self, i: int) -> float:
        """Distance between the base of a robot and the nearest wall or post [m]."""
        world = self.spec.worlds[int(self._initial_state.world[i])]
        return world.clearance(*self._bodies[i].joints[:2].tolist()) - self.spec.robot.radius

    def state(self) -> dict[str, Any]:
        motion = {name: np.array([getattr(body, name) for body in self._bodies]) for name in _MOTION}
        return {**super().state(), **motion}

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        if not all((np.abs(state[name]) < _MAX_MOTION).all() for name in _MOTION):
            raise ValueError(f"the motion of a robot must be below {_MAX_MOTION:g}")
        robot_state = super().restore(state)
        for i, body in enumerate(self._bodies):
            body.joints[:], body.rates[:], body.warm_start[:] = (state[name][i] for name in _MOTION)
        self._joints = np.array(state["joints"])
        return robot_state

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Images from the poses of a robot state, see `RobotState.render_camera`."""
        images, outlines = [], robot_state.dynamic_obstacles
        for i, (pose, world) in enumerate(zip(robot_state.pose, robot_state.initial_state.world, strict=True)):
            body = RobotBody(self._models_of_world(int(world)))
            body.place(pose)
            if outlines is not None:
                body.place_obstacles(outlines[i])
            if self._renderer is None or self._renderer.size != (width, height):
                self.close()
                self._renderer = CameraRenderer(body.models.coarse, width, height)
            images.append(self._renderer.render(body.models.coarse, body.data))
        colours, depth = zip(*images, strict=True)
        return np.stack(colours), np.stack(depth)

    def close(self) -> None:
        """Free the memory of the camera's renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        motions = [[np.array(getattr(body, name)) for name in _MOTION] for body in self._bodies]
        return {**vars(self), "_models": OrderedDict(), "_bodies": motions, "_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Compile the models again, because they can be large."""
        vars(self).update(state)
        self._bodies = []
        for episode, motion in zip(self._initial_state.records, state["_bodies"], strict=True):
            body = RobotBody(self._models_of_world(int(episode["world"])))
            self._prepare_body(body, episode)
            body.joints[:], body.rates[:], body.warm_start[:] = motion
            self._bodies.append(body)
