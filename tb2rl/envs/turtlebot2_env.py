"""Tasks as Gymnasium environments, each with a control loop for one robot."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Annotated, Any, SupportsFloat

import gymnasium as gym
import numpy as np
from annotated_types import Ge, Lt
from gymnasium.envs.registration import EnvSpec

from tb2rl.core.errors import InputError, unknown
from tb2rl.core.plugins import HUMAN_VIEWER, import_object, simulator_names
from tb2rl.core.values import Pose, checked
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.simulation.simulator import default_physics, find_simulator

_RENDER_MODES = ("rgb_array", "human")


class TurtleBot2Env(gym.Env[Any, Any]):
    """One robot, in one world at a time.

    | | |
    |---|---|
    | action | from the task's `actions`, held for `control_period`: `Discrete` commands, or a `Box` of speeds |
    | observation "discrete" | `MultiDiscrete`: the bin of each number from the sensors |
    | observation "raw" | `Box`, float32: the numbers; with images a `Dict`, or a `Box` for a single image |
    | `frame_stack=4` of the task | the last four observations, see `ObservationPipeline` |
    | reward, termination | by the task's `outcome` |
    | truncation | after `episode_steps` control steps |

    `info` of a step:

    | key | meaning |
    |---|---|
    | `pose` | true x [m], y [m], yaw [rad], shape (3,) |
    | `distance` | distance driven since the reset [m] |
    | `min_range` | shortest laser range [m] |
    | `bumped` | whether the base touched a wall or a dynamic obstacle |
    | `is_success` | goal reached; for a task without a goal: the time limit reached |
    | `ended` | reason for the end, such as "collision" or "time limit"; "" while the episode continues |
    | `failed` | whether the episode ended by a failure |

    Args:
        scene: The task, the robot, the worlds and the observation; `make_env` makes it from names.
        render_mode: None, "rgb_array" (top-down image) or "human" (a page in the browser, in real time).
        simulation: The simulator: a registered name, "module:Class", a `SimulatorType`, or an object with a method
            `simulator_type`. None: `default_physics`.

    A copy (`copy.deepcopy`, `pickle`) starts in the state of the original, and is independent afterwards. Its page is
    not copied.

    Raises:
        InputError: If the render mode or the simulator is unknown, or a page cannot be opened.
    """

    metadata: dict[str, Any] = {"render_modes": list(_RENDER_MODES), "render_fps": 5}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(self, scene: Scene, render_mode: str | None = None, simulation: Any = None) -> None:
        if render_mode is not None and render_mode not in _RENDER_MODES:
            raise unknown("render_mode", render_mode, _RENDER_MODES)
        simulator_type = default_physics() if simulation is None else find_simulator(simulation)
        self.loop = ControlLoop.open(scene, simulator_type)
        self.simulator = self.loop.simulator
        self.scene, self.task, self.render_mode = self.loop.scene, self.loop.task, render_mode
        self.metadata = {"render_modes": list(_RENDER_MODES), "render_fps": max(1, round(1 / self.task.control_period))}
        self.observation_space, self.action_space = self.scene.observation_space, self.scene.action_space
        self._gym_spec: EnvSpec | None = None
        self.viewer: Any = import_object(HUMAN_VIEWER)() if render_mode == "human" else None  # shows each state
        self.path: list[np.ndarray] = []  # poses since the reset, for images; only the first one if render_mode is None

    @property
    def robot_state(self) -> RobotState:
        """The latest robot state; raises an `InputError` before the first reset."""
        return self.loop.robot_state

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode at an initial state that the task draws or `options` selects.

        Args:
            seed: Seed of the random numbers.
            options: `world`, an index in `scene.spec.worlds`, and `pose` (x, y, yaw), each optional. Or `initial_state`
                alone, a result of `Task.initial_state` for one environment, from which world, pose and goal are taken.

        Raises:
            InputError: If there is no such world, the pose touches a wall, or `initial_state` is invalid.
        """
        super().reset(seed=seed)
        observations = self.loop.reset(self._initial_state(options or {}), self.np_random)
        self.path = [self.loop.robot_state.pose[0]]
        if self.viewer:
            self.viewer.show(self)
        return take_rows(observations, 0), self._info()

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold an action for a control period.

        Raises:
            InputError: If the action is invalid, or no episode has started.
        """
        transition = self.loop.step(self.scene.actions.checked(action))
        if self.render_mode is not None:
            self.path.append(self.loop.robot_state.pose[0])
        if self.viewer:
            self.viewer.show(self)
        info = self._info()
        if transition.finished is not None:
            info |= {name: transition.finished.infos[name].item() for name in ("is_success", "ended", "failed")}
        reward, terminated = float(transition.reward[0]), bool(transition.terminated[0])
        truncated = bool(self.loop.lengths[0] >= self.task.episode_steps)  # also if terminated, as in `TimeLimit`
        return take_rows(transition.observations, 0), reward, terminated, truncated, info

    def _info(self) -> dict[str, Any]:
        robot_state = self.loop.robot_state
        return {
            "pose": robot_state.pose[0],
            "distance": float(self.loop.distances[0]),
            "min_range": float(robot_state.nearest_range[0]),
            "bumped": bool(robot_state.bumped[0]),
            "is_success": False,
            "ended": "",
            "failed": False,
        }

    def render(self) -> np.ndarray | None:
        """The top-down image, shape (height, width, 3), uint8; None unless render_mode is "rgb_array"."""
        if self.render_mode != "rgb_array" or not self.path:
            return None
        from tb2rl.rendering.above import WorldPicture  # imported here because training draws nothing

        scene, robot_state = self.scene, self.robot_state
        world = scene.spec.worlds[int(robot_state.initial_state.world[0])]
        picture = WorldPicture(world, scene.robot, scene.laser, robot_state.goal[0] if self.task.goal_task else None)
        obstacles = None if robot_state.dynamic_obstacles is None else robot_state.dynamic_obstacles[0]
        return picture.draw(robot_state.pose[0], robot_state.ranges[0], self.path, obstacles)

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """Colour and depth [m] images of the robot's camera, see `RobotState.render_camera`.

        Raises:
            InputError: If the simulator's cameras see no colours, or no episode has started.
        """
        colours, depth = self.robot_state.render_camera(width, height)
        if colours is None:
            names = [name for name in simulator_names() if find_simulator(name).has_colours]
            raise InputError(f"this simulator's cameras see no colours; use simulation={' or '.join(map(repr, names))}")
        return colours[0], depth[0]

    def state(self) -> dict[str, Any]:
        """Everything that future steps and episodes depend on, as plain values and arrays."""
        return {**self.loop.state(), "generator": self.np_random.bit_generator.state}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Return to a `state`; later steps are the same as after the original one."""
        if not self.path:  # only a reset gives the simulator its noise generator
            self.loop.reset(InitialState.default(self.scene.spec, 1), self.np_random)
        self.loop.restore(state)
        self.np_random.bit_generator.state = state["generator"]
        self.path = [self.loop.robot_state.pose[0]]

    @property
    def spec(self) -> EnvSpec | None:
        """The spec from which `gymnasium.make` makes the environment again, with the task's time limit."""
        return self._gym_spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.max_episode_steps = self.task.episode_steps
        self._gym_spec = spec

    def close(self) -> None:
        """Close the page, and release the resources of the simulator; a reset acquires only these again."""
        self.loop.close()
        self.path = []
        if self.viewer:
            self.viewer.close()
            self.viewer = None

    def __getstate__(self) -> dict[str, Any]:  # without the page, which has a thread
        return {**self.__dict__, "viewer": None}

    def _initial_state(self, options: dict[str, Any]) -> InitialState:
        spec = self.scene.spec
        if (initial_state := options.get("initial_state")) is not None:
            if not isinstance(initial_state, InitialState) or len(initial_state.table) != 1 or len(options) > 1:
                raise InputError("options.initial_state must be one row of InitialState, alone; or use options.pose")
            return self.scene.vary_initial_state(initial_state, self.np_random)
        if options.get("world") is not None:
            index = checked(Annotated[int, Ge(0), Lt(len(spec.worlds))], options["world"], "options.world")
            spec = spec.for_world(index)
        if "pose" not in options:
            return self.task.randomized_initial_state(spec, GeneratorSource(self.np_random))
        x, y, yaw = checked(Pose, options["pose"], "options.pose")
        # The draws come from a copy, so that later sensor noise does not depend on them.
        initial_state = self.task.randomized_initial_state(spec, GeneratorSource(deepcopy(self.np_random)))
        world = spec.worlds[int(initial_state.world[0])]
        if not world.contains((x, y)) or world.clearance(x, y) < spec.robot.radius:
            raise InputError(f"the start ({x:g}, {y:g}) touches a wall or is outside of world {world.name}")
        initial_state.pose[:] = x, y, yaw
        return initial_state
