"""Evaluations in the fast twin: all episodes at once, so that a training can look often and at thousands of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th

from tb2rl.envs.batch import ControlLoop, Step
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluation import Episode, Evaluation, smallest_type
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.rollout import Policy


class TwinEvaluator:
    """One robot for each episode, in one batch that stands ready to evaluate policies.

    Args:
        scene: Where and what to do; its time limit is replaced, and it begins at random poses.
        episodes: How many, each from a start pose of its own.
        steps: Control steps at most in an episode.
        seed: Of the start poses and of all noise.

    Raises:
        InputError: If the twin cannot simulate the scene.
    """

    def __init__(self, scene: Scene, episodes: int, steps: int, seed: int) -> None:
        self.scene, self.seed = scene.changed(episode_steps=steps), seed
        self._batch = ControlLoop(scene.changed(start="random", episode_steps=steps), episodes)
        self._batch.reset()  # says here, and not after a part of the training, what cannot be observed

    def run(self, policy: Policy, progress: bool = False) -> Evaluation:
        """Drive all episodes with the greedy policy.

        Args:
            policy: What drives; it predicts for all robots at once.
            progress: Whether to draw a bar, where there is a terminal.
        """
        steps = self.scene.task.episode_steps
        with (
            th.random.fork_rng(devices=[]),  # a policy that draws, draws the same whatever happened before
            progress_bar(None, "evaluating", "step", total=steps, shown=progress) as bar,
        ):
            th.manual_seed(self.seed)
            self._batch.seed(self.seed)
            observations = self._batch.reset()
            record = _Record(self._batch)
            remembered: dict[str, Any] = {}  # by a recurrent policy; others do not know the argument
            while not record.complete:
                actions, memory = policy.predict(observations, deterministic=True, **remembered)
                remembered = {} if memory is None else {"state": memory}
                step = self._batch.step(actions)
                observations = step.observations
                record.note(actions, step)
                bar.update()
        return Evaluation(record.episodes(), self.scene, self.seed, "kinematic")

    def close(self) -> None:
        """Free what the simulation holds."""
        self._batch.close()

    def __enter__(self) -> TwinEvaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Record:
    """What each robot does until its first episode is over; later ones, of a robot that began anew, do not count."""

    def __init__(self, batch: ControlLoop) -> None:
        self._batch, num_envs = batch, batch.num_envs
        initial_state = batch.robot_state.initial_state
        self._starts, self._worlds = batch.robot_state.pose.copy(), initial_state.world.astype(int).tolist()
        goals = batch.scene.task.goal_task
        self._goals = [tuple(goal) for goal in initial_state.goal.tolist()] if goals else [None] * num_envs
        self._places = [self._starts[:, :2].astype(np.float32)]
        self._actions: list[np.ndarray] = []
        self._touched = np.zeros(num_envs, dtype=bool)
        self._over = np.zeros(num_envs, dtype=bool)
        self._ends: list[dict[str, Any]] = [{}] * num_envs

    @property
    def complete(self) -> bool:
        """Whether every robot has ended an episode."""
        return bool(self._over.all())

    def note(self, actions: np.ndarray, step: Step) -> None:
        """Remember a step of all robots."""
        robot_state, finished = self._batch.robot_state, step.finished
        places, touched = robot_state.pose[:, :2].astype(np.float32), robot_state.bumped.copy()
        if finished is not None:  # the reading shows where these robots began anew
            places[finished.indices], touched[finished.indices] = (
                finished.infos["pose"][:, :2],
                finished.infos["bumped"],
            )
        self._places.append(places)
        self._actions.append(np.asarray(actions).astype(smallest_type(self._batch.scene.action_space)))
        self._touched |= touched & ~self._over
        if finished is not None:
            for i in np.flatnonzero(~self._over[finished.indices]):
                end = {name: finished.infos[name][i] for name in ("ended", "failed", "is_success", "distance")}
                self._ends[finished.indices[i]] = {**end, "length": finished.lengths[i], "return": finished.returns[i]}
            self._over[finished.indices] = True

    def episodes(self) -> list[Episode]:
        """The episodes, one for each robot."""
        paths, actions = np.stack(self._places, axis=1), np.stack(self._actions, axis=1)
        return [
            Episode(
                start=tuple(self._starts[robot].tolist()),
                ended=end["ended"],
                failed=bool(end["failed"]),
                success=bool(end["is_success"]),
                touched=bool(self._touched[robot]),
                length=int(end["length"]),
                distance=float(end["distance"]),
                episode_return=float(end["return"]),
                path=paths[robot, : end["length"] + 1],
                actions=actions[robot, : end["length"]],
                world=self._worlds[robot],
                goal=self._goals[robot],
            )
            for robot, end in enumerate(self._ends)
        ]
