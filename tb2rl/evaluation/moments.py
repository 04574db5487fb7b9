"""One episode, control step by control step: for films, windows and bags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.core.values import Count, checked
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.evaluation.episodes import EpisodeStart, Policy, run_steps
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.random_streams import GeneratorDraws

LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class Moment:
    """One control step of an episode."""

    step: int  # its number, from 1
    before: RobotState  # at its start, one row
    after: RobotState  # at its end, one row
    action: np.ndarray  # of the policy: shape () for a named command, (2,) for velocities
    reward: float
    total: float  # rewards since the reset
    info: Mapping[str, Any]  # of `TurtleBot2Env.step`; its "ended" says whether the episode is over, and why

    @property
    def initial_state(self) -> InitialState:
        """How the episode started, one row."""
        return self.after.initial_state


def roll_out(
    loop: ControlLoop, policy: Policy, seed: int, initial_state: InitialState | None = None
) -> Iterator[Moment]:
    """One episode of the greedy policy, the same as in `TurtleBot2Env` after `reset(seed=seed)`.

    Args:
        loop: With one environment.
        policy: The policy.
        seed: Of the initial state unless it is given, of the noise, and of a policy that draws.
        initial_state: World, pose and goal, one row.

    Raises:
        InputError: If the policy gives an action that does not exist.
    """
    rng = np.random.default_rng(seed)
    if initial_state is None:
        initial_state = loop.task.randomized_initial_state(loop.scene.spec, GeneratorDraws(rng))
    else:
        initial_state = loop.scene.randomized(initial_state, rng)
    return moments_of(loop, policy, EpisodeStart(0, seed, initial_state, rng))


def moments_of(loop: ControlLoop, policy: Policy, start: EpisodeStart) -> Iterator[Moment]:
    """The moments of one episode, see `roll_out`."""
    total = 0.0
    for number, step in enumerate(run_steps(loop, policy, [start]), start=1):
        total += float(step.transition.reward[0])
        info = {name: column[0] for name, column in loop.infos().items()}
        if step.transition.finished is not None:
            info = {name: column[0] for name, column in step.transition.finished.infos.items()}
        yield Moment(number, step.before, step.after, step.actions[0], float(step.transition.reward[0]), total, info)


def time_limit(steps: int | None, settings: Mapping[str, Any], default: int) -> int:
    """The time limit of episodes [control steps].

    Args:
        steps: The limit that the caller asks for; None: none.
        settings: Changes to the task by name; `episode_steps` among them is such a limit, too.
        default: The limit where neither says one.

    Raises:
        InputError: If both say one, or that of the settings is not a number of steps.
    """
    if "episode_steps" not in settings:
        return default if steps is None else steps
    if steps is not None:
        raise InputError("--steps (steps=) and task.episode_steps set the same time limit; give one of them")
    return checked(Count, settings["episode_steps"], "task.episode_steps")
