"""Tasks as Gymnasium environments: a control loop with one environment."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Annotated, Any, SupportsFloat

import gymnasium as gym
import numpy as np
from annotated_types import Ge, Lt
from gymnasium.envs.registration import EnvSpec

from tb2rl.core.errors import InputError, unknown
from tb2rl.core.values import Pose, checked
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState, Simulator, default_physics, find_simulator
from tb2rl.simulation.random_streams import GeneratorDraws

_RENDER_MODES = ("rgb_array", "human")


class TurtleBot2Env(gym.Env[Any, Any]):
    """One robot, in one world at a time.

    | | |
    |---|---|
    | action | of the task's `actions`, held for `control_period`: `Discrete` commands, or a `Box` of speeds |
    | observation "discrete" | `MultiDiscrete`: the class of each of the sensors' numbers, the laser's beams first |
    | observation "raw" | `Box`, float32: these numbers as they are; with images a `Dict`, or one image alone |
    | with `frame_stack=4` of the task | the last four of these, see `ObservationPipeline` |
    | reward, termination | the task's; a collision terminates |
    | truncation | after `episode_steps` control steps |

    `info` of a step:

    | key | meaning |
    |---|---|
    | `pose` | true x [m], y [m], yaw [rad], shape (3,) |
    | `distance` | driven since the reset [m] |
    | `min_range` | shortest laser range [m] |
    | `bumped` | whether the base touched a wall or a dynamic obstacle |
    | `is_success` | goal reached; for a task without a goal: the time limit reached |
    | `ended` | why the episode is over: "collision", "collision with a dynamic obstacle", ..., "time limit"; else "" |
    | `failed` | whether it is over and counts as failed |

    Args:
        scene: The task, its robot and world, and how it is observed; see `make_env` for one by names.
        render_mode: None, "rgb_array" (top-down image, no window) or "human" (the simulator's own window).
        simulation: The simulator: a registered name, "module:Class", a `SimulatorType`, or an object that names one by
            `simulator_type`; None: `default_physics`.

    A copy (`copy.deepcopy`, `pickle`) goes its own way from where the original is; one with a window cannot be copied.

    Raises:
        InputError: For an unknown render mode or simulator, or a window that cannot be.
    """

    metadata: dict[str, Any] = {"render_modes": list(_RENDER_MODES), "render_fps": 5}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(self, scene: Scene, render_mode: str | None = None, simulation: Any = None) -> None:
        if render_mode is not None and render_mode not in _RENDER_MODES:
            raise unknown("render_mode", render_mode, _RENDER_MODES)
        kind = default_physics() if simulation is None else find_simulator(simulation)
        self.loop = ControlLoop.open(scene, kind, window=render_mode == "human")
        self.scene, self.task, self.render_mode = self.loop.scene, self.loop.task, render_mode
        modes = [mode for mode in _RENDER_MODES if mode != "human" or kind.has_window]
        self.metadata = {"render_modes": modes, "render_fps": max(1, round(1 / self.task.control_period))}
        self.observation_space, self.action_space = self.scene.observation_space, self.scene.action_space
        self._started = False
        self._gym_spec: EnvSpec | None = None
        self.path: list[np.ndarray] = []  # poses since the reset, for images: only with a render_mode

    @property
    def simulator(self) -> Simulator:
        """The simulator of this one environment."""
        return self.loop.simulator

    @property
    def robot_state(self) -> RobotState | None:
        """The latest; None before the first reset."""
        return self.loop.robot_state if self._started else None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `options={"world": 3, "pose": (x, y, yaw)}` says where, else the task does.

        Each of the two options can be given alone; a world is its index among `scene.spec.worlds`. The option
        `initial_state` goes alone, too: world, pose and goal of one robot, from `Task.initial_state`.

        Raises:
            InputError: If there is no such world, that pose is inside a wall, or `initial_state` is none.
        """
        super().reset(seed=seed)
        observations = self.loop.reset(self._initial_state(options or {}), self.np_random)
        self._started = True
        self.path = [self.loop.robot_state.pose[0]]
        return rows(observations, 0), self._info()

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold an action for a control period.

        Raises:
            InputError: If it is not an action, or nothing was reset yet.
        """
        if not self._started:
            raise InputError("step needs a reset first")
        transition = self.loop.step(self.scene.actions.checked(action))
        if self.render_mode is not None:
            self.path.append(self.loop.robot_state.pose[0])
        info = self._info()
        if transition.finished is not None:
            final = transition.finished.infos
            info |= {"is_success": bool(final["is_success"][0]), "ended": final["ended"][0]}
            info["failed"] = bool(final["failed"][0])
        terminated = bool(transition.terminated[0])
        truncated = bool(self.loop.lengths[0] >= self.task.episode_steps)  # beside `terminated`, as in `TimeLimit`
        return rows(transition.observations, 0), float(transition.reward[0]), terminated, truncated, info

    def _info(self) -> dict[str, Any]:
        robot_state = self.loop.robot_state
        return {
            "pose": robot_state.pose[0],
            "distance": float(self.loop.distances[0]),
            "min_range": float(robot_state.nearest[0]),
            "bumped": bool(robot_state.bumped[0]),
            "is_success": False,
            "ended": "",
            "failed": False,
        }

    def render(self) -> np.ndarray | None:
        """The top-down image, shape (height, width, 3), uint8; None with a window."""
        if self.render_mode != "rgb_array" or self.robot_state is None:
            return None
        from tb2rl.rendering.above import WorldPicture  # drawing is not needed to train

        scene, robot_state = self.scene, self.robot_state
        world = scene.spec.worlds[int(robot_state.initial_state.world[0])]
        picture = WorldPicture(world, scene.robot, scene.laser, robot_state.goal[0] if self.task.goal_task else None)
        obstacles = None if robot_state.dynamic_obstacles is None else robot_state.dynamic_obstacles[0]
        return picture.draw(robot_state.pose[0], robot_state.ranges[0], self.path, obstacles)

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """Colours and depth [m] of the robot's camera, see `RobotState.render_camera`.

        Raises:
            InputError: If the simulator's cameras see no colours, or nothing was reset yet.
        """
        if self.robot_state is None:
            raise InputError("camera needs a reset first")
        colours, depth = self.robot_state.render_camera(width, height)
        if colours is None:
            raise InputError("this simulation's cameras see no colours")
        return colours[0], depth[0]

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episode and later ones depend on, as plain values and arrays."""
        if not self._started:
            raise InputError("state needs a reset first")
        return {**self.loop.state(), "generator": self.np_random.bit_generator.state}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state` as if nothing had happened since."""
        if not self._started:  # the simulator learns the source of its noise
            self.loop.reset(InitialState.default(self.scene.spec, 1), self.np_random)
        self.loop.restore(state)
        self.np_random.bit_generator.state = state["generator"]
        self._started, self.path = True, [self.loop.robot_state.pose[0]]

    @property
    def spec(self) -> EnvSpec | None:
        """The spec from which `gymnasium.make` makes it again, with the task's time limit; see `make_env`."""
        return self._gym_spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.max_episode_steps = self.task.episode_steps
        self._gym_spec = spec

    def close(self) -> None:
        """Release what the simulator holds; a reset opens it again."""
        self.loop.close()
        self._started = False

    def _initial_state(self, options: dict[str, Any]) -> InitialState:
        spec = self.scene.spec
        if (given := options.get("initial_state")) is not None:
            if not isinstance(given, InitialState) or len(given.table) != 1 or len(options) > 1:
                raise InputError("options.initial_state goes alone, and has one row; a pose is options.pose")
            return self.scene.randomized(given, self.np_random)
        if options.get("world") is not None:
            index = checked(Annotated[int, Ge(0), Lt(len(spec.worlds))], options["world"], "options.world")
            spec = spec.within(index)
        if "pose" not in options:
            return self.task.randomized_initial_state(spec, GeneratorDraws(self.np_random))
        x, y, yaw = checked(Pose, options["pose"], "options.pose")
        initial_state = self.task.randomized_initial_state(spec, GeneratorDraws(deepcopy(self.np_random)))
        world = spec.worlds[int(initial_state.world[0])]
        if not world.contains((x, y)):
            raise InputError(f"the start ({x:g}, {y:g}) is outside world {world.name}")
        if world.clearance(x, y) < spec.robot.radius:
            raise InputError(f"the start ({x:g}, {y:g}) is inside a wall of world {world.name}")
        initial_state.pose[:] = x, y, yaw
        return initial_state
