"""Factories of environments: `make_env`, and the entry points of Gymnasium's ids."""

import sys
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, registry
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from tb2rl.core import InputError, UnknownArgumentError, reference_to
from tb2rl.core.plugins import TASKS
from tb2rl.core.values import build, is_untyped
from tb2rl.envs.scene import Scene, make_scene, with_robot_settings
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.envs.vector_env import TurtleBot2VectorEnv, find_autoreset_mode
from tb2rl.envs.worlds import absolute_worlds
from tb2rl.simulation.simulator import default_physics, find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.task import find_task

ENTRY_POINT, VECTOR_ENTRY_POINT = f"{__name__}:make_for_gymnasium", f"{__name__}:make_vector_for_gymnasium"


def make_env(
    task: Any = "maze",
    observation: str | None = None,
    render_mode: str | None = None,
    simulation: Any = None,
    **settings: Any,
) -> TurtleBot2Env:
    """Make the environment of a task, or the one in which a policy was trained.

    Args:
        task: A task's name, "module:Class", a `Task` or its class, or a policy from `load` or `train`.
        observation: "discrete" or "raw". None: that of the policy, or "discrete" for a task.
        render_mode: None, "rgb_array" or "human", see `TurtleBot2Env`.
        simulation: A simulator's name, "module:Class", or an object such as a `tb2rl.deploy.ros.robot.RosRobot` for
            ROS 2. "bullet" and "mujoco" are physics engines, "kinematic" is thousands of times as fast, and "ros"
            drives a real or simulated robot by ROS 1. None: `default_physics`.
        settings: Fields of the task, such as `world="circuit"`. A world or robot of your own is "module:WORLD".

    Raises:
        InputError: If a name is unknown, or a value is invalid.
        UnknownArgumentError: If a setting is unknown. The error is also a `TypeError`.
    """
    scene = _scene(task, observation, settings)
    env = TurtleBot2Env(scene, render_mode, simulation)
    env.spec = _make_env_spec(scene, render_mode, simulation)  # the setter adds the time limit
    return env


def _scene(task: Any, observation: str | None, settings: Mapping[str, Any]) -> Scene:
    config = getattr(task, "trained_with", None)
    if config is not None:
        task, observation = config.task, observation or config.observation
    task_class = type(task) if isinstance(task, Task) else find_task(task)
    setting_names = [field.name for field in fields(task_class)]
    for name in settings:
        if name not in setting_names and not is_untyped(task_class, name):  # `build` reports untyped settings
            raise UnknownArgumentError("make_env", name, ["observation", "render_mode", "simulation", *setting_names])
    return make_scene(make_task(task, settings), observation or "discrete")


def make_task(task: Any, settings: Mapping[str, Any]) -> Task:
    """Make a task from a name, "module:Class", a class or another task; `settings` overrides its fields.

    Raises:
        InputError: If a name or a setting is unknown, or a value is invalid.
    """
    before, task_class = (task, type(task)) if isinstance(task, Task) else (None, find_task(task))
    current = {field.name: getattr(before, field.name) for field in fields(task_class)} if before else {}
    return build(task_class, {**current, **with_robot_settings(settings, task_class, before)}, "task")


def _make_env_spec(scene: Scene, render_mode: str | None, simulation: Any) -> EnvSpec:
    """The spec from which `gymnasium.make` makes the environment again, in any working directory.

    The spec can be saved as JSON unless the task's class is local to a function or `simulation` is an object.
    """
    task, task_class = scene.task, type(scene.task)
    defaults = {field.name: field.default for field in fields(task_class)}
    # `make_env` itself adds the robot's task settings, so these count as defaults.
    defaults |= {**with_robot_settings({"robot": task.robot}, task_class), "robot": defaults["robot"]}
    settings = {name: value for name, value in asdict(task).items() if getattr(task, name) != defaults[name]}
    if "world" in settings:
        settings["world"] = absolute_worlds(settings["world"])
    if render_mode:
        settings["render_mode"] = render_mode
    kwargs = {"task": _task_reference(task_class)}
    if scene.observation == "raw":
        kwargs["observation"] = "raw"
    ids = [spec.id for spec in registry.values() if spec.entry_point == ENTRY_POINT and spec.kwargs == kwargs]
    return EnvSpec(
        ids[0] if ids else f"{task_class.__name__}-v0",
        entry_point=ENTRY_POINT,
        vector_entry_point=VECTOR_ENTRY_POINT,
        order_enforce=False,  # the environment itself checks the order and the spaces
        disable_env_checker=True,
        kwargs={**kwargs, "simulation": simulation or default_physics().name, **settings},
    )


def _task_reference(task_class: type[Task]) -> str | type[Task]:
    """The name of a built-in task, "module:Class", or the class itself if it cannot be imported by a reference."""
    try:
        reference = reference_to(task_class)
    except InputError:
        return task_class
    return next((name for name, built_in in TASKS.items() if built_in == reference), reference)


def make_for_gymnasium(task: str, **arguments: Any) -> gymnasium.Env:
    """Entry point for `gymnasium.make`, see `make_env`."""
    # Frame 1 is that of `gymnasium.make`. No variable stores the current frame: a frame in its own variables is a
    # reference cycle, which would keep the environment alive.
    arguments = _with_time_limit(arguments, _requested_time_limit(sys._getframe(1).f_locals))
    return make_env(task, **arguments)


make_for_gymnasium.metadata = TurtleBot2Env.metadata  # type: ignore[attr-defined]  # Gymnasium reads the render modes


def make_vector_for_gymnasium(
    task: str,
    num_envs: int = 1,
    simulation: Any = None,
    max_episode_steps: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    **arguments: Any,
) -> VectorEnv:
    """The entry point for `gymnasium.make_vec`.

    The environments share one control loop if the simulator steps many of them in one process. Otherwise a
    `SyncVectorEnv` steps one after the other. `autoreset_mode`: see `TurtleBot2VectorEnv`; `arguments`: see `make_env`.
    """
    mode, simulator_type = find_autoreset_mode(autoreset_mode), find_simulator(simulation or default_physics())
    arguments = _with_time_limit(arguments, max_episode_steps)
    if not (simulator_type.needs_processes or simulator_type.is_external):
        if arguments.pop("render_mode", None) is not None:
            raise InputError("vector environments have no render_mode; make one environment with gymnasium.make")
        scene = _scene(task, arguments.pop("observation", None), arguments)
        return TurtleBot2VectorEnv(scene, num_envs, mode, simulator_type)
    make_one = partial(make_env, task, simulation=simulation, **arguments)
    return SyncVectorEnv([make_one] * num_envs, autoreset_mode=mode)


def _requested_time_limit(caller_locals: Mapping[str, Any]) -> int | None:
    """The time limit in the local variables of `gymnasium.make`.

    Gymnasium passes the limit to its `TimeLimit` wrapper but not to the entry point. The task needs the same limit, so
    that `info["ended"]` can report it.
    """
    limit = caller_locals.get("max_episode_steps")
    return limit if limit is not None else getattr(caller_locals.get("env_spec"), "max_episode_steps", None)


def _with_time_limit(arguments: Mapping[str, Any], max_episode_steps: int | None) -> dict[str, Any]:
    """The arguments with Gymnasium's time limit as `episode_steps`; -1 means no limit from Gymnasium."""
    if max_episode_steps is None or max_episode_steps < 0:
        return dict(arguments)
    return {**arguments, "episode_steps": min(max_episode_steps, arguments.get("episode_steps", max_episode_steps))}
