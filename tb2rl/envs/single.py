"""Tasks as Gymnasium environments: glue between a simulation, a task and an encoding, and nothing else."""

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
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState, Simulation, SimulationSpec, simulate
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.simulation.spec import GOAL, POSE, WAY
from tb2rl.tasks import TIME_LIMIT, Ending

_RENDER_MODES = ("rgb_array", "human")


class TurtleBot2Env(gym.Env[Any, Any]):
    """One robot, in one world at a time.

    | | |
    |---|---|
    | action | of the task's `actions`, held for `control_period`: `Discrete` commands, or a `Box` of speeds |
    | observation "discrete" | `MultiDiscrete`: the class of each of the sensors' numbers, the laser's beams first |
    | observation "raw" | `Box`, float32: these numbers as they are; with images a `Dict`, or one image alone |
    | with `frame_stack=4` of the task | the last four of these, see `ObservationPipeline` |
    | reward, termination | the task's; a crash terminates |
    | truncation | after `episode_steps` control steps |

    `info` of a step:

    | key | meaning |
    |---|---|
    | `pose` | true x [m], y [m], yaw [rad], shape (3,) |
    | `distance` | driven since the reset [m] |
    | `min_range` | shortest laser range [m] |
    | `bumped` | whether the base touched a wall, or something that moves |
    | `is_success` | goal reached; for a task without a goal: the time limit reached |
    | `ended` | why the episode is over: "collision", "collision with a dynamic obstacle", ..., "time limit"; else "" |
    | `failed` | whether it is over and counts as failed |

    Args:
        scene: The task, its robot and world, and how it is observed; see `make_env` for one by names.
        render_mode: None, "rgb_array" (seen from above, no window) or "human" (PyBullet's window).
        simulation: "bullet" or "kinematic", or one that is made of the scene's setup.

    A copy (`copy.deepcopy`, `pickle`) goes its own way from where the original is; one with a window cannot be copied.

    Raises:
        InputError: For an unknown render mode or simulation, or a window that cannot be.
    """

    metadata: dict[str, Any] = {"render_modes": list(_RENDER_MODES), "render_fps": 5}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(self, scene: Scene, render_mode: str | None = None, simulation: str | Simulation = "bullet") -> None:
        if render_mode is not None and render_mode not in _RENDER_MODES:
            raise unknown("render_mode", render_mode, _RENDER_MODES)
        self.scene, self.task, self.render_mode = scene, scene.task, render_mode
        modes = [mode for mode in _RENDER_MODES if mode != "human" or simulation == "bullet"]
        self.metadata = {"render_modes": modes, "render_fps": max(1, round(1 / self.task.control_period))}
        self.observation_space, self.action_space = scene.observation_space, scene.action_space
        self._actions, self._command_delay = scene.actions, scene.command_delay()
        self._observation_pipeline = scene.observation_pipeline(self._command_delay)
        self.simulation = self._opened(simulation)
        self.robot_state: RobotState | None = None  # the latest; None before the first reset
        self._spec: EnvSpec | None = None
        self.path: list[np.ndarray] = []  # poses since the reset, for pictures: only with a render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `options={"world": 3, "pose": (x, y, yaw)}` says where, else the task does.

        Either option can be given alone; a world is its index among `scene.setup.worlds`. Alone, too, goes `start`: one
        robot's `InitialState`, from the task's `begin`, for its world, pose and goal.

        Raises:
            InputError: If there is no such world, that pose is inside a wall, or `start` is none.
        """
        super().reset(seed=seed)
        self.robot_state = self.simulation.reset(self._initial_state(options or {}), self.np_random)
        self._steps, self._distance = 0, 0.0
        self.path = [self.robot_state.pose[0]]
        return rows(self._observation_pipeline.begin(self.robot_state), 0), info_of(self.robot_state, 0, 0.0, None)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold an action for a control period.

        Raises:
            InputError: If it is not an action, or nothing was reset yet.
        """
        if self.robot_state is None:
            raise InputError("step needs a reset first")
        actions = self._actions.checked(action)
        before = self.robot_state
        commands = self._command_delay.push(self._actions.commands(actions), before.initial_state.command_latency)
        after = self.simulation.step(commands, self.task.control_period)
        outcome = self.task.outcome(before, actions, after)
        self.robot_state = after
        self._steps += 1
        dx, dy, _ = (after.pose - before.pose)[0].tolist()
        self._distance += (dx * dx + dy * dy) ** 0.5
        if self.render_mode is not None:
            self.path.append(after.pose[0])
        truncated = self._steps >= self.task.episode_steps
        ending = outcome.ending(0, truncated)
        terminated = ending is not None and ending.name != TIME_LIMIT
        info = info_of(after, 0, self._distance, ending)
        return rows(self._observation_pipeline.go_on(after), 0), float(outcome.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The picture of the moment, seen from above, shape (height, width, 3), uint8; None for the window."""
        if self.render_mode != "rgb_array" or self.robot_state is None:
            return None
        from tb2rl.rendering.above import WorldPicture  # drawing is not needed to train

        scene, robot_state = self.scene, self.robot_state
        world = scene.spec.worlds[int(robot_state.initial_state.world[0])]
        picture = WorldPicture(world, scene.robot, scene.laser, robot_state.goal[0] if self.task.goal_task else None)
        dynamic_obstacles = None if robot_state.dynamic_obstacles is None else robot_state.dynamic_obstacles[0]
        return picture.draw(robot_state.pose[0], robot_state.ranges[0], self.path, dynamic_obstacles)

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """Colours and depth [m] that the camera on the robot's front sees, see `BulletSimulation.camera`.

        Raises:
            InputError: If the simulation has no camera.
        """
        if not hasattr(self.simulation, "camera"):
            raise InputError("only simulation 'bullet' has a camera")
        return self.simulation.camera(width, height)

    def state(self) -> dict[str, Any]:
        """All that the rest of the episode and later ones depend on, in plain values and arrays."""
        if self.robot_state is None:
            raise InputError("state needs a reset first")
        return {
            "simulation": self.simulation.state(),
            "reading": self.robot_state.state(),
            "frame_stack": self._observation_pipeline.state(),
            "steps": self._steps,
            "distance": self._distance,
            "generator": self.np_random.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since."""
        if self.robot_state is None:  # the simulation learns where its noise comes from
            self.simulation.reset(InitialState.default(self.scene.spec, 1), self.np_random)
        self.simulation.restore(state["simulation"])
        self.robot_state = RobotState.from_state(state["reading"], self.simulation)
        self._observation_pipeline.restore(state["frame_stack"])
        self._steps, self._distance = int(state["steps"]), float(state["distance"])
        self.np_random.bit_generator.state = state["generator"]
        self.path = [self.robot_state.pose[0]]

    @property
    def spec(self) -> EnvSpec | None:
        """The spec from which `gymnasium.make` makes it again, with the task's time limit; see `make_env`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.max_episode_steps = self.task.episode_steps
        self._spec = spec

    def close(self) -> None:
        """Free what the simulation holds; a reset opens it again."""
        self.simulation.close()
        self.robot_state = None

    def _opened(self, simulation: str | Simulation) -> Simulation:
        if isinstance(simulation, str):
            self.scene.check(simulation)
            return simulate(simulation, self.scene.spec, window=self.render_mode == "human")
        if self.render_mode == "human":
            raise InputError("render_mode 'human' shows PyBullet's window, which this simulation lacks")
        return simulation

    def _initial_state(self, options: dict[str, Any]) -> InitialState:
        spec = self.scene.spec
        if (given := options.get("initial_state")) is not None:
            if not isinstance(given, InitialState) or len(given.table) != 1 or len(options) > 1:
                raise InputError(
                    "options.initial_state goes alone, and is the InitialState of one robot; a pose is options.pose"
                )
            initial_state = self._varied(spec.within(int(given.world[0])))
            for columns in (POSE, GOAL, WAY):
                initial_state.table[:, columns] = given.table[:, columns]
            return initial_state
        if options.get("world") is not None:
            index = checked(Annotated[int, Ge(0), Lt(len(spec.worlds))], options["world"], "options.world")
            spec = spec.within(index)
        if "pose" not in options:
            return self.task.randomized_initial_state(spec, GeneratorDraws(self.np_random))
        x, y, yaw = checked(Pose, options["pose"], "options.pose")
        initial_state = self._varied(spec)
        world = spec.worlds[int(initial_state.world[0])]
        if not world.contains((x, y)):
            raise InputError(f"the start ({x:g}, {y:g}) is outside world {world.name}")
        if world.clearance(x, y) < spec.robot.radius:
            raise InputError(f"the start ({x:g}, {y:g}) is inside a wall of world {world.name}")
        initial_state.pose[:] = x, y, yaw
        return initial_state

    def _varied(self, spec: SimulationSpec) -> InitialState:
        """A start that the task draws and that is then partly overwritten: it takes no number from the noise."""
        return self.task.randomized_initial_state(spec, GeneratorDraws(deepcopy(self.np_random)))


def info_of(robot_state: RobotState, robot: int, distance: float, ending: Ending | None) -> dict[str, Any]:
    """The `info` of one robot, see `TurtleBot2Env`; `ending` is None while its episode goes on."""
    return {
        "pose": robot_state.pose[robot],
        "distance": distance,
        "min_range": float(robot_state.nearest[robot]),
        "bumped": bool(robot_state.bumped[robot]),
        "is_success": ending is not None and ending.success,
        "ended": "" if ending is None else ending.name,
        "failed": ending is not None and ending.failed,
    }
