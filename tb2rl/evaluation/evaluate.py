"""`tb2rl.evaluate`: one call from a policy, by any name, to its evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.evaluator import EPISODES, SEED, STEPS, Evaluator, random_initial_states
from tb2rl.evaluation.moments import time_limit
from tb2rl.evaluation.spaces import check_observes
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import InitialState, default_simulator, find_simulator
from tb2rl.tasks import Task


def evaluate(
    policy: Policy | str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    task: str | Task | type[Task] | None = None,
    observation: str | None = None,
    simulation: Any = None,
    progress: bool = False,
    **conditions: Any,
) -> Evaluation:
    """Evaluate a policy; the standard evaluation unless the settings or `conditions` say otherwise.

    Generated worlds are test worlds, which no training draws.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`, such as a model of
            Stable-Baselines3 that was trained without tb2rl.
        config: The training whose task to evaluate; None: `task`, else the policy's own training.
        settings: Changes to the task by name, for example {"world": "circuit"}.
        task: A task's name, "module:Class", a `Task` or its class; in place of `config`.
        observation: "discrete" or "raw", with `task`; None: as the policy's observation space says.
        simulation: A simulator's name, "module:Class", or an object such as a `RosRobot`; None: the first physics that
            can run here, or the kinematic simulator where there is none.
        progress: Whether to draw a bar, where there is a terminal.
        conditions: `steps` (time limit [control steps]; default: `episode_steps` of the settings, else 1500), and
            `episodes`, `seed`, `workers` as of `Evaluator`.

    Raises:
        InputError: If there is no such policy, a setting does not fit, or the policy knows other observations or
            actions than the task has.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    steps = time_limit(conditions.pop("steps", None), settings or {}, STEPS)
    seed = conditions.pop("seed", SEED)
    scene = _scene(policy, config, task, observation, settings or {})
    check_observes(policy, scene)
    simulator = default_simulator() if simulation is None else find_simulator(simulation)
    if simulator.is_robot:
        scene = simulator.prepare(scene)
        states = InitialState.default(scene.spec, conditions.pop("episodes", 1))
    else:
        scene = scene.worlds_for("test")
        states = random_initial_states(scene, conditions.pop("episodes", EPISODES), seed)
    with Evaluator(scene, states, steps, seed, simulation=simulator, **conditions) as evaluator:
        return evaluator.run(getattr(policy, "policy", policy), progress)


def _scene(
    policy: Any,
    config: Config | None,
    task: str | Task | type[Task] | None,
    observation: str | None,
    settings: Mapping[str, Any],
) -> Scene:
    """The task of an evaluation, see `evaluate`."""
    if task is None:
        if observation is not None:
            raise InputError("observation= goes with task=; else a policy observes as it was trained to")
        if config is None and not hasattr(policy, "trained_with"):
            name = type(policy).__name__
            raise InputError(f"{name} does not come from tb2rl.load or tb2rl.train: name its task, such as task='maze'")
        return (config or config_of(policy)).with_task(settings).scene
    if config is not None:
        raise InputError("name either a config or a task")
    if observation is None:
        numbers = isinstance(getattr(policy, "observation_space", None), spaces.Box | spaces.Dict)
        observation = "raw" if numbers else "discrete"
    return make_scene(make_task(task, settings), observation)
