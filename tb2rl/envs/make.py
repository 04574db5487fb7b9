"""Environments from names: for Gymnasium's ids, and for `tb2rl.make_env`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, registry
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import HumanRendering

from tb2rl.core.errors import InputError, UnknownArgumentError
from tb2rl.core.plugins import TASKS, reference_to
from tb2rl.core.values import build, untyped
from tb2rl.envs.scene import Scene, make_scene, with_robots_settings
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.envs.vector_env import TurtleBot2VectorEnv, find_autoreset_mode
from tb2rl.envs.worlds import absolute_worlds
from tb2rl.simulation import check_display, default_physics, find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task

ENTRY_POINT, VECTOR_ENTRY_POINT = f"{__name__}:make_for_gymnasium", f"{__name__}:make_vector_for_gymnasium"
_ARGUMENTS = ("observation", "render_mode", "simulation")  # of `make_env`, beside the task's settings


def make_env(
    what: Any = "maze",
    observation: str | None = None,
    render_mode: str | None = None,
    simulation: Any = None,
    **settings: Any,
) -> TurtleBot2Env:
    """The environment of a task, or the one that a policy was trained for (to the task's own time limit).

    Args:
        what: A task's name, "module:Class", a `Task` or its class, or a policy from `load` or `train`.
        observation: "discrete" or "raw"; None: the policy's, else "discrete".
        render_mode: None, "rgb_array" or "human", see `TurtleBot2Env`.
        simulation: A simulator's name ("bullet": PyBullet's physics, "kinematic": thousands of times as fast, "ros": a
            robot with ROS 1, yours or Gazebo's), "module:Class", or an object such as a
            `tb2rl.deploy.ros.robot.RosRobot` for ROS 2; None: the first physics.
        settings: Fields of the task to set, for example `world="circuit"`; a world or a robot of one's own by its
            name, "module:WORLD".

    Raises:
        InputError: For an unknown name, or a value that does not fit.
        UnknownArgumentError: For an unknown setting; it is a `TypeError`, too.
    """
    scene = _scene(what, observation, settings)
    env = TurtleBot2Env(scene, render_mode, simulation)
    env.spec = _spec(scene, render_mode, simulation)
    return env


def _scene(what: Any, observation: str | None, settings: Mapping[str, Any]) -> Scene:
    config = getattr(what, "trained_with", None)
    if config is not None:
        what, observation = config.task, observation or config.observation
    kind = type(what) if isinstance(what, Task) else find_task(what)
    known = [field.name for field in fields(kind)]
    for name in settings:
        if name not in known and not untyped(kind, name):  # of which `build` says more
            raise UnknownArgumentError("make_env", name, [*_ARGUMENTS, *known])
    return make_scene(make_task(what, settings), observation or "discrete")


def make_task(what: Any, settings: Mapping[str, Any]) -> Task:
    """A task from its name, "module:Class", its class, or another task some of whose fields are to change.

    Raises:
        InputError: For an unknown name or setting, or a value that does not fit.
    """
    if not isinstance(what, Task):
        kind = find_task(what)
        return build(kind, with_robots_settings(settings, kind), "task")
    now = {field.name: getattr(what, field.name) for field in fields(what)}
    return build(type(what), {**now, **with_robots_settings(settings, type(what), what)}, "task")


def _spec(scene: Scene, render_mode: str | None, simulation: Any) -> EnvSpec:
    """The spec from which `gymnasium.make` makes the environment again, from any folder.

    It is plain, as JSON needs it, unless a function defines the task's class or `simulation` is an object.
    """
    task, kind = scene.task, type(scene.task)
    defaults = {field.name: field.default for field in fields(kind)}
    usual = {**defaults, **with_robots_settings({"robot": task.robot}, kind), "robot": defaults["robot"]}
    settings = {name: value for name, value in asdict(task).items() if getattr(task, name) != usual[name]}
    if "world" in settings:
        settings["world"] = absolute_worlds(settings["world"])
    known = {"task": _task_reference(kind), **({"observation": "raw"} if scene.observation == "raw" else {})}
    ids = [spec.id for spec in registry.values() if spec.entry_point == ENTRY_POINT and spec.kwargs == known]
    return EnvSpec(
        ids[0] if ids else f"{kind.__name__}-v0",
        entry_point=ENTRY_POINT,
        vector_entry_point=VECTOR_ENTRY_POINT,
        order_enforce=False,  # the environment does and checks that itself
        disable_env_checker=True,
        kwargs={
            **known,
            "simulation": simulation or default_physics().name,
            **({"render_mode": render_mode} if render_mode else {}),
            **settings,
        },
    )


def _task_reference(kind: type[Task]) -> str | type[Task]:
    """The name of a task's class, or "module:Class", or where that does not mean it the class itself."""
    try:
        reference = reference_to(kind)
    except InputError:
        return kind
    return next((name for name, built_in in TASKS.items() if built_in == reference), reference)


def make_for_gymnasium(task: str, **arguments: Any) -> gymnasium.Env:
    """The entry point for `gymnasium.make`; see `make_env`. A simulator without a window gets Gymnasium's own."""
    # A local variable of the frame would be a reference cycle, which keeps the environment alive.
    limit = _time_limit_asked(sys._getframe(1).f_locals)
    arguments = _time_limit_named(arguments, limit)
    simulator = find_simulator(arguments.get("simulation") or default_physics())
    if arguments.get("render_mode") != "human" or simulator.has_window:
        return make_env(task, **arguments)
    check_display()
    return HumanRendering(make_env(task, **{**arguments, "render_mode": "rgb_array"}))


make_for_gymnasium.metadata = TurtleBot2Env.metadata  # type: ignore[attr-defined]  # Gymnasium reads the render modes


def make_vector_for_gymnasium(
    task: str,
    num_envs: int = 1,
    observation: str | None = None,
    simulation: Any = None,
    max_episode_steps: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    **arguments: Any,
) -> VectorEnv:
    """The entry point for `gymnasium.make_vec`: one control loop, or where that needs processes one environment after
    the other.

    Other arguments than Gymnasium's and `autoreset_mode`, see `TurtleBot2VectorEnv`, are those of `make_env`.
    """
    mode, simulator = find_autoreset_mode(autoreset_mode), find_simulator(simulation or default_physics())
    arguments = _time_limit_named(arguments, max_episode_steps)
    if not (simulator.in_processes or simulator.is_robot):
        if arguments.pop("render_mode", None) is not None:
            raise InputError("many environments in one are not drawn; make one with gymnasium.make")
        return TurtleBot2VectorEnv(_scene(task, observation, arguments), num_envs, mode, simulator)
    one = partial(make_env, task, observation, simulation=simulation, **arguments)
    return SyncVectorEnv([one] * num_envs, autoreset_mode=mode)


def _time_limit_asked(call: Mapping[str, Any]) -> int | None:
    """The time limit in the local variables of a call of `gymnasium.make`.

    Gymnasium hands it to a wrapper of its own and to no entry point. Only by looking at the call can the task have the
    same limit, and say in `info["ended"]` that it was reached.
    """
    limit = call.get("max_episode_steps")
    return limit if limit is not None else getattr(call.get("env_spec"), "max_episode_steps", None)


def _time_limit_named(arguments: Mapping[str, Any], max_episode_steps: int | None) -> dict[str, Any]:
    """The arguments with Gymnasium's name for the time limit told as ours; -1 means that there is none."""
    if max_episode_steps is None or max_episode_steps < 0:
        return dict(arguments)
    return {**arguments, "episode_steps": min(max_episode_steps, arguments.get("episode_steps", max_episode_steps))}
