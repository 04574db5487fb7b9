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
from tb2rl.simulation import Reading, Setup, Simulation, Start, simulate
from tb2rl.simulation.setup import GOAL, POSE, WAY
from tb2rl.simulation.streams import GeneratorDraws
from tb2rl.tasks import TIME_LIMIT, Ending

_RENDER_MODES = ("rgb_array", "human")


class TurtleBot2Env(gym.Env[Any, Any]):
    """One robot, in one world at a time.

    | | |
    |---|---|
    | action | of the task's `actions`, held for `control_period`: `Discrete` commands, or a `Box` of speeds |
    | observation "discrete" | `MultiDiscrete`: the class of each of the sensors' numbers, the laser's beams first |
    | observation "raw" | `Box`, float32: these numbers as they are; with images a `Dict`, or one image alone |
    | with `frames=4` of the task | the last four of these, see `Observer` |
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
    | `ended` | why the episode is over: "crash", "crash with something that moves", ..., "time limit"; else "" |
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
        self._actions, self._commander = scene.actions, scene.commander()
        self._observer = scene.observer(self._commander)
        self.simulation = self._opened(simulation)
        self.reading: Reading | None = None  # the latest; None before the first reset
        self._spec: EnvSpec | None = None
        self.path: list[np.ndarray] = []  # poses since the reset, for pictures: only with a render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `options={"world": 3, "pose": (x, y, yaw)}` says where, else the task does.

        Either option can be given alone; a world is its index among `scene.setup.worlds`. Alone, too, goes `start`: one
        robot's `Start`, from the task's `begin`, for its world, pose and goal.

        Raises:
            InputError: If there is no such world, that pose is inside a wall, or `start` is none.
        """
        super().reset(seed=seed)
        self.reading = self.simulation.reset(self._start(options or {}), self.np_random)
        self._steps, self._distance = 0, 0.0
        self.path = [self.reading.pose[0]]
        return rows(self._observer.begin(self.reading), 0), info_of(self.reading, 0, 0.0, None)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold an action for a control period.

        Raises:
            InputError: If it is not an action, or nothing was reset yet.
        """
        if self.reading is None:
            raise InputError("step needs a reset first")
        actions = self._actions.checked(action)
        before = self.reading
        commands = self._commander.pass_on(self._actions.commands(actions), before.start.command_latency)
        after = self.simulation.step(commands, self.task.control_period)
        outcome = self.task.judge(before, actions, after)
        self.reading = after
        self._steps += 1
        dx, dy, _ = (after.pose - before.pose)[0].tolist()
        self._distance += (dx * dx + dy * dy) ** 0.5
        if self.render_mode is not None:
            self.path.append(after.pose[0])
        truncated = self._steps >= self.task.episode_steps
        ending = outcome.ending(0, truncated)
        terminated = ending is not None and ending.name != TIME_LIMIT
        info = info_of(after, 0, self._distance, ending)
        return rows(self._observer.go_on(after), 0), float(outcome.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The picture of the moment, seen from above, shape (height, width, 3), uint8; None for the window."""
        if self.render_mode != "rgb_array" or self.reading is None:
            return None
        from tb2rl.rendering.above import WorldPicture  # drawing is not needed to train

        scene, reading = self.scene, self.reading
        world = scene.setup.worlds[int(reading.start.world[0])]
        picture = WorldPicture(world, scene.robot, scene.laser, reading.goal[0] if self.task.goal_task else None)
        movers = None if reading.movers is None else reading.movers[0]
        return picture.draw(reading.pose[0], reading.ranges[0], self.path, movers)

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
        if self.reading is None:
            raise InputError("state needs a reset first")
        return {
            "simulation": self.simulation.state(),
            "reading": self.reading.state(),
            "frames": self._observer.state(),
            "steps": self._steps,
            "distance": self._distance,
            "generator": self.np_random.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since."""
        if self.reading is None:  # the simulation learns where its noise comes from
            self.simulation.reset(Start.proposed(self.scene.setup, 1), self.np_random)
        self.simulation.restore(state["simulation"])
        self.reading = Reading.from_state(state["reading"], self.simulation)
        self._observer.restore(state["frames"])
        self._steps, self._distance = int(state["steps"]), float(state["distance"])
        self.np_random.bit_generator.state = state["generator"]
        self.path = [self.reading.pose[0]]

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
        self.reading = None

    def _opened(self, simulation: str | Simulation) -> Simulation:
        if isinstance(simulation, str):
            self.scene.check(simulation)
            return simulate(simulation, self.scene.setup, window=self.render_mode == "human")
        if self.render_mode == "human":
            raise InputError("render_mode 'human' shows PyBullet's window, which this simulation lacks")
        return simulation

    def _start(self, options: dict[str, Any]) -> Start:
        setup = self.scene.setup
        if (given := options.get("start")) is not None:
            if not isinstance(given, Start) or len(given.table) != 1 or len(options) > 1:
                raise InputError("options.start goes alone, and is the Start of one robot; a pose is options.pose")
            start = self._varied(setup.within(int(given.world[0])))
            for columns in (POSE, GOAL, WAY):
                start.table[:, columns] = given.table[:, columns]
            return start
        if options.get("world") is not None:
            index = checked(Annotated[int, Ge(0), Lt(len(setup.worlds))], options["world"], "options.world")
            setup = setup.within(index)
        if "pose" not in options:
            return self.task.begin_varied(setup, GeneratorDraws(self.np_random))
        x, y, yaw = checked(Pose, options["pose"], "options.pose")
        start = self._varied(setup)
        world = setup.worlds[int(start.world[0])]
        if not world.contains((x, y)):
            raise InputError(f"the start ({x:g}, {y:g}) is outside world {world.name}")
        if world.clearance(x, y) < setup.robot.radius:
            raise InputError(f"the start ({x:g}, {y:g}) is inside a wall of world {world.name}")
        start.pose[:] = x, y, yaw
        return start

    def _varied(self, setup: Setup) -> Start:
        """A start that the task draws and that is then partly overwritten: it takes no number from the noise."""
        return self.task.begin_varied(setup, GeneratorDraws(deepcopy(self.np_random)))


def info_of(reading: Reading, robot: int, distance: float, ending: Ending | None) -> dict[str, Any]:
    """The `info` of one robot, see `TurtleBot2Env`; `ending` is None while its episode goes on."""
    return {
        "pose": reading.pose[robot],
        "distance": distance,
        "min_range": float(reading.nearest[robot]),
        "bumped": bool(reading.bumped[robot]),
        "is_success": ending is not None and ending.success,
        "ended": "" if ending is None else ending.name,
        "failed": ending is not None and ending.failed,
    }
