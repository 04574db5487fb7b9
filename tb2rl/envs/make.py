"""Environments from names: for Gymnasium's ids, and for `tb2rl.make_env`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from tb2rl.envs.scene import make_scene
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.registry import find_task
from tb2rl.tasks import Task
from tb2rl.values import build


def make_env(
    what: Any = "maze",
    observation: str | None = None,
    render_mode: str | None = None,
    simulation: str = "bullet",
    **settings: Any,
) -> TurtleBot2Env:
    """The environment of a task, or the one that a policy was trained for (to the task's own time limit).

    Args:
        what: A task's name, "module:Class", a `Task` or its class, or a policy from `load` or `train`.
        observation: "discrete" or "raw"; None: the policy's, else "discrete".
        render_mode: None, "rgb_array" or "human", see `TurtleBot2Env`.
        simulation: "bullet" (PyBullet's physics) or "kinematic" (its fast twin).
        settings: Fields of the task to set, for example `world="circuit"`.

    Raises:
        InputError: For an unknown name or setting, or a value that does not fit.
    """
    config = getattr(what, "trained_with", None)
    if config is not None:
        what, observation = config.task, observation or config.observation
    task = changed(what, settings) if isinstance(what, Task) else build(find_task(what), settings, "task")
    return TurtleBot2Env(make_scene(task, observation or "discrete"), render_mode, simulation)


def changed(task: Task, settings: Mapping[str, Any]) -> Task:
    """The task with some of its fields set, all checked again.

    Raises:
        InputError: For an unknown setting, or a value that does not fit.
    """
    return build(type(task), {**{field.name: getattr(task, field.name) for field in fields(task)}, **settings}, "task")


def make_for_gymnasium(task: str, **arguments: Any) -> TurtleBot2Env:
    """What `gymnasium.make` calls; see `make_env`."""
    return make_env(task, **arguments)


make_for_gymnasium.metadata = TurtleBot2Env.metadata  # type: ignore[attr-defined]  # Gymnasium reads the render modes
