"""Tasks as Gymnasium environments: glue between a simulation, a task and an observation, and nothing else."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np

from tb2rl.errors import InputError
from tb2rl.observations import prepare
from tb2rl.registry import find_task
from tb2rl.robot import BASE_RADIUS
from tb2rl.settings import Pose, build, checked
from tb2rl.simulation import Reading, simulate
from tb2rl.tasks import Task


class TurtleBot2Env(gym.Env[np.ndarray, np.int64]):
    """One TurtleBot2 in one maze.

    | | |
    |---|---|
    | action | `Discrete`: a row of the task's `commands`, held for `control_period` |
    | observation "discrete" | `MultiDiscrete`: the distance class of each beam, right to left, then the task's senses |
    | observation "raw" | `Box`, float32: the range of each beam [m], right to left, then the task's senses |
    | reward, termination | the task's; a crash terminates |
    | truncation | after `episode_steps` control steps |

    `info` of a step:

    | key | meaning |
    |---|---|
    | `pose` | true x [m], y [m], yaw [rad], shape (3,) |
    | `distance` | driven since the reset [m] |
    | `min_range` | shortest reading [m] |
    | `bumped` | whether the base touched a wall |
    | `is_success` | goal reached; for a task without a goal: the time limit reached without a crash |
    | `ended` | None, or why the episode is over: "crash", "goal", ..., "time limit" |

    Args:
        task: A task's name, "module:Class", a class derived from `Task`, or a `Task` itself.
        observation: "discrete" or "raw".
        render_mode: None, "rgb_array" (seen from above, no window) or "human" (PyBullet's window).
        simulation: "bullet" or "kinematic".
        settings: Fields of the task by name, for example `maze="circuit"`.

    Raises:
        InputError: For an unknown task, maze, observation, simulation or setting, or a value that does not fit.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 5}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self,
        task: str | type[Task] | Task = "maze",
        observation: str = "discrete",
        render_mode: str | None = None,
        simulation: str = "bullet",
        **settings: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"unknown render_mode {render_mode!r}; known: None, 'rgb_array', 'human'")
        given = changed(task, settings) if isinstance(task, Task) else build(find_task(task), settings, "task")
        self.maze, self.task, self._observe, self.laser = prepare(given, observation)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / self.task.control_period))}
        self._commands = self.task.commands
        self.observation_space = self._observe.space
        self.action_space = gym.spaces.Discrete(len(self._commands))
        self.maze.free_space(self.task.start_clearance if self.task.start == "random" else BASE_RADIUS)
        self.simulation = simulate(simulation, self.maze, self.laser, window=render_mode == "human")
        self._reading: Reading | None = None
        self.path: list[np.ndarray] = []  # poses since the reset, for pictures: only with a render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; `options={"pose": (x, y, yaw)}` says where, else the task's `start` does.

        Raises:
            InputError: If that pose is inside a wall.
        """
        super().reset(seed=seed)
        pose = self._start_pose(options or {})
        self._reading = self.simulation.reset(pose, self.np_random)
        self._steps, self._distance = 0, 0.0
        self.path = [self._reading.pose[0]]
        return self._observe(self._reading)[0], info_of(self._reading, 0, 0.0, success=False, ended=None)

    def step(self, action: int | np.int64) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        if self._reading is None:
            raise InputError("step needs a reset first")
        index = self._checked(action)
        before = self._reading
        after = self.simulation.step(self._commands[index : index + 1], self.task.control_period)
        outcome = self.task.judge(before, np.array([index]), after)
        self._reading = after
        self._steps += 1
        dx, dy, _ = (after.pose - before.pose)[0].tolist()
        self._distance += (dx * dx + dy * dy) ** 0.5
        if self.render_mode is not None:
            self.path.append(after.pose[0])
        truncated = self._steps >= self.task.episode_steps
        ended = outcome.ending(0, truncated)
        info = info_of(after, 0, self._distance, outcome.succeeded(0, ended), ended)
        terminated = ended not in (None, "time limit")
        return self._observe(after)[0], float(outcome.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The picture of the moment, seen from above, shape (height, width, 3), uint8; None for the window."""
        if self.render_mode != "rgb_array" or self._reading is None:
            return None
        from tb2rl.render import draw_scene  # drawing is not needed to train

        return draw_scene(self.maze, self.task, self.laser, self._reading, self.path)

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
        if self._reading is None:
            raise InputError("state needs a reset first")
        return {
            "simulation": asdict(self.simulation.state()),
            "reading": asdict(self._reading),
            "steps": self._steps,
            "distance": self._distance,
            "generator": self.np_random.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since."""
        if self._reading is None:  # the simulation learns where its noise comes from
            self.simulation.reset(np.array([self.maze.start]), self.np_random)
        self.simulation.restore(self.simulation.state_type(**state["simulation"]))
        self._reading = Reading(**state["reading"])
        self._steps, self._distance = int(state["steps"]), float(state["distance"])
        self.np_random.bit_generator.state = state["generator"]
        self.path = [self._reading.pose[0]]

    def close(self) -> None:
        self.simulation.close()

    def _checked(self, action: int | np.int64) -> int:
        try:
            index = operator.index(action)
        except TypeError:  # a float, NaN, a longer array
            index = -1
        if not 0 <= index < len(self._commands):
            raise InputError(f"action {action!r} is none of the integers 0 to {len(self._commands) - 1}")
        return index

    def _start_pose(self, options: dict[str, Any]) -> np.ndarray:
        if "pose" in options:
            pose = checked(Pose, options["pose"], "options.pose")
            x0, y0, x1, y1 = self.maze.bounds
            if not (x0 <= pose[0] <= x1 and y0 <= pose[1] <= y1):
                raise InputError(f"the start ({pose[0]:g}, {pose[1]:g}) is outside maze {self.maze.name}")
            if self.maze.clearance(*pose[:2]) < BASE_RADIUS:
                raise InputError(f"the start ({pose[0]:g}, {pose[1]:g}) is inside a wall of maze {self.maze.name}")
            return np.array([pose])
        if self.task.start == "fixed":
            return np.array([self.maze.start])
        return self.maze.random_poses(self.np_random, 1, self.task.start_clearance)


def info_of(reading: Reading, robot: int, distance: float, success: bool, ended: str | None) -> dict[str, Any]:
    """The `info` of one robot, see `TurtleBot2Env`."""
    return {
        "pose": reading.pose[robot],
        "distance": distance,
        "min_range": float(reading.nearest[robot]),
        "bumped": bool(reading.bumped[robot]),
        "is_success": success,
        "ended": ended,
    }


def changed(task: Task, settings: Mapping[str, Any]) -> Task:
    """The task with some of its fields set, all checked again."""
    return build(type(task), {**{field.name: getattr(task, field.name) for field in fields(task)}, **settings}, "task")


def make_env(
    what: Any = "maze", observation: str | None = None, render_mode: str | None = None, **settings: Any
) -> TurtleBot2Env:
    """The environment of a task, or the one that a policy was trained for: in PyBullet, to the task's own time limit.

    Args:
        what: A task's name, "module:Class", a `Task` or its class, or a policy from `load` or `train`.
        observation: "discrete" or "raw"; None: the policy's, else "discrete".
        render_mode: As in `TurtleBot2Env`.
        settings: Fields of the task to set, for example `maze="circuit"`; `simulation` as in `TurtleBot2Env`.
    """
    config = getattr(what, "trained_with", None)
    if config is not None:
        what, observation = config.task_settings, observation or config.observation
    return TurtleBot2Env(what, observation or "discrete", render_mode, **settings)
